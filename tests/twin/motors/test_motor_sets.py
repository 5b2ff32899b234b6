"""Motors from catalogues: what the data sheets say, and that the firmware gets on with each."""

import numpy as np
import pytest

from fiberloom.bus.identifier import encode
from fiberloom.bus.protocol import Command
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.studies.legal_moves import legal_moves
from fiberloom.twin import Fault, Twin, draw_units
from fiberloom.twin.draw import _nominal, firmware_truth, put_in
from fiberloom.twin.motors.sets import MOTOR_SETS, with_motor
from fiberloom.units import AXES, COUNTS_PER_DEG

GO_TO = Command(30)
SETS = [("alpha", "10mm"), ("alpha", "13mm"), ("beta", "6mm")]


def plane_of(n=8, **motors):
    """SDSS-V with other motors."""
    twin = {axis: {"motor": name} for axis, name in motors.items()}
    instrument = load_instrument("sdssv").model_copy(update={"twin": twin})
    return generate(instrument, seed=2, n_positioners=n)


def nominal(axis, name):
    """Plant of the unit that nothing was drawn for."""
    return _nominal(plane_of(1, **{axis: name}), AXES.index(axis))


@pytest.mark.parametrize(
    ("axis", "name", "terminal_Ohm", "k_M_mNm_A", "k_M2_uNms", "uNm_V", "drag_over_inertia"),
    [
        # ohms between two terminals and torque per ampere of the data sheets; the rest is arithmetic
        ("alpha", "paper", 319 / 1.5, 10.31, 0.50, 42, 229),
        ("alpha", "10mm", 8.17, 1.42, 0.25, 150, 229),
        ("alpha", "13mm", 5.74, 4.05, 2.86, 611, 229),
        ("beta", "paper", 3190 / 1.5, 10.31, 0.05, 4.2, 229),
        ("beta", "6mm", 26 / 1.5, 1.5, 0.13, 75, 400),
    ],
)
def test_a_set_is_its_data_sheet(axis, name, terminal_Ohm, k_M_mNm_A, k_M2_uNms, uNm_V, drag_over_inertia):
    plant = nominal(axis, name)
    told = firmware_truth(plant)
    # the same copper loss: I^2 R_t of a block current I is (T/k_M)^2 R_t, ours T^2/K_M^2
    assert 1.5 * plant["flux_linkage"] ** 2 / plant["coil_resistance"] * 1e6 == pytest.approx(
        k_M_mNm_A**2 / terminal_Ohm, rel=0.01
    )
    assert k_M_mNm_A**2 / terminal_Ohm == pytest.approx(k_M2_uNms, rel=0.04)
    # sqrt(3)/2 of the supply reaches a coil: Eq. 18
    assert told["torque_per_volt"] * 1e6 == pytest.approx(
        np.sqrt(0.75) * k_M_mNm_A / terminal_Ohm * 1e3, rel=0.01
    )
    assert told["torque_per_volt"] * 1e6 == pytest.approx(uNm_V, rel=0.02)
    assert told["drag"] / told["inertia"] == pytest.approx(drag_over_inertia, rel=0.02)


def test_the_large_one_is_the_paper_s_with_larger_torques():
    """Fig. 14 cannot tell them apart: every torque and the inertia 4.7 times."""
    small, large = firmware_truth(nominal("alpha", "paper")), firmware_truth(nominal("alpha", "13mm"))
    for name in ("inertia", "drag", "coulomb", "spring_torque", "spring_rate", "cogging_torque"):
        assert large[name] / small[name] == pytest.approx(4.7, rel=0.01), name


def test_the_paper_s_set_is_the_default_to_the_bit():
    plain, said = (draw_units(plane, 3) for plane in (plane_of(), plane_of(alpha="paper", beta="paper")))
    assert plain.plant.tobytes() == said.plant.tobytes()
    assert plain.firmware.tobytes() == said.firmware.tobytes()
    assert not any(key.startswith("motor of") for key in put_in(plane_of()))


def test_another_motor_leaves_what_else_is_drawn():
    plain, other = draw_units(plane_of(), 3), draw_units(plane_of(alpha="13mm"), 3)
    assert plain.plant[:, 1].tobytes() == other.plant[:, 1].tobytes()
    assert plain.gear.tobytes() == other.gear.tobytes()
    ratio = other.plant["coil_resistance"][:, 0] / plain.plant["coil_resistance"][:, 0]
    np.testing.assert_allclose(ratio, 8.6 / 319, rtol=1e-12)
    assert "maxon EC 13" in put_in(plane_of(alpha="13mm"))["motor of alpha"]


@pytest.mark.parametrize(
    ("axis", "name"), [("alpha", "12mm"), ("beta", "13mm"), ("alpha", "6mm"), ("beta", 3)]
)
def test_a_set_that_an_axis_does_not_have_is_refused_with_those_that_it_has(axis, name):
    known = {"alpha": "paper, 10mm, 13mm", "beta": "paper, 6mm"}[axis]
    with pytest.raises(InputError, match=f'twin.{axis}.motor = "{name}": {axis} has the sets {known}'):
        draw_units(plane_of(1, **{axis: name}), 0)


def test_numbers_of_the_table_come_after_the_motor():
    twin = {"alpha": {"supply": 5.0, "motor": "13mm"}}
    plane = generate(load_instrument("sdssv").model_copy(update={"twin": twin}), seed=2, n_positioners=1)
    assert draw_units(plane, 0).plant["supply"][0, 0] == pytest.approx(5.0, rel=0.02)


def test_the_paper_s_record_is_not_changed():
    paper = nominal("alpha", "paper")
    before = paper.tobytes()
    with_motor(paper, 0, "13mm", "here")
    assert paper.tobytes() == before
    assert all(motor.source for motor in MOTOR_SETS.values())


@pytest.mark.parametrize(("axis", "name"), SETS)
def test_moves_end_and_none_is_taken_for_a_collision(axis, name):
    trial = legal_moves(plane_of(16, **{axis: name}), moves=6, seed=5, threads=1)
    assert trial.collisions == []
    assert trial.lost == []
    assert trial.moves == 96


def went(plane, blocked):
    """Ticks (N, 2) from the start of a move of 8 deg of both axes until its phases were off."""
    twin = Twin(plane, draw_units(plane, 4), seed=4, threads=1, neighbours=False, start_deg=(100.0, 90.0))
    scopes = [[twin.scope(row, axis) for axis in (0, 1)] for row in range(len(plane))]
    goal = [round(deg * COUNTS_PER_DEG).to_bytes(4, "little", signed=True) for deg in (108.0, 98.0)]
    twin.send([(encode(int(p), GO_TO), b"".join(goal)) for p in plane.positioner_id])
    twin.run(0.5)
    for p in plane.positioner_id if blocked else []:
        for axis in AXES:
            twin.inject(Fault("blocked", int(p), axis))
    replies = twin.run(2.0)
    off = np.array([[np.flatnonzero(s.take()["voltage"])[-1] + 1 for s in pair] for pair in scopes])
    return off, twin, replies


@pytest.mark.parametrize(("axis", "name"), [("alpha", "paper"), *SETS])
def test_a_blocked_rotor_is_found_as_soon_as_the_paper_s(axis, name):
    """At 2000 rpm within the paper's 16 ms; an ordinary move ends within a motor degree."""
    plane = plane_of(6, **{axis: name})
    off, _, replies = went(plane, blocked=True)
    k = AXES.index(axis)
    # 2000 ticks a second, blocked 0.5 s after the start
    assert (off[:, k] / 2000.0 - 0.5).max() < 0.016
    assert len({r.id for r in replies}) >= 6  # each says so, frame 18
    off, twin, replies = went(plane, blocked=False)
    assert replies == []
    assert (off[:, k] / 2000.0).min() > 0.8
    # the linear ratio, from where each stood: backlash and non-linearity are a few tenths
    way = twin.truth()[:, k] - (100.0, 90.0)[k]
    np.testing.assert_allclose(way, 8.0, atol=1.0)
