"""MEGARA on the twin: blind fields by its own motors and frames; what is wrong is flagged."""

import asyncio

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.connect import twin_source
from fiberloom.errors import InputError
from fiberloom.targets.generate import random_targets
from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.steppers.array import CountPath, StepperArray

PLANE = fl.FocalPlane.of("megara", seed=0, n=30)
TARGETS = random_targets(PLANE, 75, seed=1)


def observed(faults="", folder=None):
    """Summary of a field, and its source."""
    field = fl.Field.twin(PLANE, seed=0, camera="noise", faults=faults)
    seen = field.run.observe(TARGETS, out=folder)
    return seen.summary(), field.source


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A field of healthy units."""
    return observed(folder=tmp_path_factory.mktemp("whole") / "run")


def test_a_blind_field_meets_the_requirement_in_truth(whole):
    summary, source = whole
    last = summary["moves"][-1]
    assert len(summary["moves"]) == 1
    assert summary["n_within_requirement"] == summary["n_assigned"] >= 25
    # switches of 0.02 deg at some 8 and 6 mm are 3.4 um, half a step of beta 0.3 um; the bench knows arms
    assert 2.0 < last["true_rms_um"] < 7.0
    assert summary["contacts_true"] == summary["collisions_verified"] == 0
    assert source.bus.array.contacts() == 0


def test_the_bench_finds_zeros_and_gears(whole):
    """In between the knots: what is left are arms of the table, and the bench's camera and switches."""
    _, source = whole
    rng, n = np.random.default_rng(3), len(PLANE)
    goal = np.column_stack([rng.uniform(-350.0, -10.0, n), rng.uniform(-110.0, -70.0, n)])
    rising = np.full((n, 2), -1.0)
    counts = source.known.counts(goal, rising)
    true = source.units.output_deg(counts.astype(float), rising, np.zeros((n, 2)) + _switches(source))
    miss_um = 1e3 * np.hypot(*(_places(source, true) - PLANE.forward(*goal.T)).T)
    blind = source.units.output_deg(
        source.known.steps.of_angles(goal).astype(float), rising, _switches(source)
    )
    plain_um = 1e3 * np.hypot(*(_places(source, blind) - PLANE.forward(*goal.T)).T)
    assert np.sqrt(np.mean(miss_um**2)) < 20.0
    assert np.sqrt(np.mean(plain_um**2)) > 3.0 * np.sqrt(np.mean(miss_um**2))


def test_the_bench_tells_the_play_by_the_direction_of_the_last_motion(whole):
    """Both ways to the same angles: 0.05 deg of play would show, steps are 0.002 and 0.012 deg."""
    _, source = whole
    goal = np.tile([-100.0, -90.0], (len(PLANE), 1))
    ends = []
    for sign in (1.0, -1.0):
        rising = np.full((len(PLANE), 2), sign)
        counts = source.known.counts(goal, rising)
        ends.append(source.units.output_deg(counts.astype(float), rising, _switches(source)))
    assert np.abs(ends[0] - ends[1]).mean(axis=0).max() < 0.015


def test_the_bench_comes_to_every_knot_in_either_direction(whole):
    """To the ends of the range too. The play is the mean of 30 units, in three sweeps."""
    _, source = whole
    known, n = source.known, len(PLANE)
    for k in range(known.knots_deg.shape[1]):
        counts = known.steps.of_angles(np.tile(known.knots_deg[:, k], (n, 1))).astype(float)
        rising, falling = (
            source.units.output_deg(counts, np.full((n, 2), sign), _switches(source)) for sign in (1.0, -1.0)
        )
        found = known.error_deg[:, :, 0, k] - known.error_deg[:, :, 1, k]
        np.testing.assert_allclose(found.mean(axis=0), (rising - falling).mean(axis=0), atol=0.01)


def _switches(source):
    return np.column_stack([one.offset_deg for one in source.units.switches])


def _places(source, angles_deg):
    return source.true_plane.forward(*angles_deg.T)


def test_lost_steps_dead_and_exchanged_units_are_flagged_and_the_rest_goes_on(tmp_path):
    summary, source = observed("slipping=1,dead=1,swapped=1", tmp_path / "run")
    broken = {fault.positioner_id for fault in source.faults}
    flagged = set(summary["faults"]["dead"])
    assert broken <= flagged
    assert len(flagged) == 4  # and the one with which it is exchanged
    with_target = summary["n_assigned"] - summary["n_within_requirement"]
    assert with_target <= 4
    assert summary["contacts_true"] == 0


def test_a_gateway_without_power_is_flagged_and_the_rest_goes_on(tmp_path):
    """It goes while the first arms unfold: arms of that group stand anywhere on their way."""
    summary, source = observed("busoff=1@75", tmp_path / "run")
    silent = {one.positioner_id for one in source.schedule}
    assert set(summary["faults"]["disconnected"]) == silent
    lost = len(silent) + len(summary["faults"].get("blocked", []))
    assert summary["n_within_requirement"] >= summary["n_assigned"] - lost
    assert len(summary["moves"]) == 2
    assert summary["contacts_true"] == 0


@pytest.mark.parametrize(("faults", "moves"), [("deaf=1", 1), ("deaf=1,busoff=1@75", 2)])
def test_one_that_is_silent_at_the_begin_may_be_anywhere(faults, moves, tmp_path):
    """Nothing tells where it stands: no arm comes within its whole reach, move after move."""
    summary, source = observed(faults, tmp_path / "run")
    assert len(summary["moves"]) == moves
    (silent,) = (fault.positioner_id for fault in source.faults if fault.kind == "deaf")
    row = PLANE.index_of(silent)
    assert summary["faults"]["dead"] == [silent]
    assert summary["faults"]["blocked"]
    numbers = [number for those in summary["faults"].values() for number in those]
    flagged = np.isin(PLANE.positioner_id, numbers)
    off_mm = np.hypot(*(source.bus.array.fibre_xy() - PLANE.centres_mm[row]).T)
    assert (~flagged).sum() >= 18
    assert off_mm[~flagged].min() > PLANE.body_reach_mm[row]


def test_a_second_field_folds_first(tmp_path):
    field = fl.Field.twin(PLANE, seed=0, camera="noise")

    async def two():
        await field.observe(TARGETS, out=tmp_path / "a")
        return await field.observe(random_targets(PLANE, 75, seed=2), out=tmp_path / "b")

    summary = asyncio.run(two()).summary()
    assert summary["n_within_requirement"] == summary["n_assigned"]
    assert summary["contacts_true"] == 0


def test_arms_that_are_driven_into_each_other_are_counted():
    """Without plan and verifier: two neighbours stretched towards each other."""
    field = fl.FocalPlane.of("megara", seed=0, n=7)
    near = int(np.argsort(np.hypot(*(field.centres_mm - field.centres_mm[0]).T))[1])
    plane = field.select([0, near])
    array = StepperArray(plane, seed=0)
    to_other = np.rad2deg(np.arctan2(*(plane.centres_mm[1] - plane.centres_mm[0])[::-1]))
    goal = np.array([[to_other, 0.0], [to_other - 180.0, 0.0]])
    goal[:, 0] = -((-goal[:, 0]) % 360.0)
    counts = array.units.steps.of_angles(goal)
    path = CountPath(np.arange(2), np.array([[0.0, 0.0], [60.0, 60.0]]), np.stack([0 * counts, counts]) * 1.0)
    now = [0.0]
    array.clock = lambda: now[0]
    array.go(path)
    now[0] = 61.0
    assert np.abs(array.truth() - goal).max() < 2.0
    assert array.contacts() == 1


def test_an_arm_that_is_driven_into_the_exclusion_area_is_counted():
    """Stretched towards the frame of the fibre bundle: 9 to 11 mm away, and 11.7 mm long."""
    field = fl.FocalPlane.of("megara", seed=0, n=30)
    (area,) = field.instrument.bodies.keep_outs
    apart = area.distance_mm(field.centres_mm)
    assert apart.min() > 9.0
    plane = field.select([int(np.argmin(apart))])
    for turn, contacts in ((0.0, 1), (180.0, 0)):
        array = StepperArray(plane, seed=0)
        inwards = np.rad2deg(np.arctan2(*-plane.centres_mm[0, ::-1])) + turn
        goal = np.array([[-((-inwards) % 360.0), 0.0]])
        counts = array.units.steps.of_angles(goal)
        folded = array.units.steps.of_angles(np.array([[goal[0, 0], -180.0]]))
        array.go(CountPath(np.arange(1), np.array([[0.0], [60.0]]), np.stack([0 * counts, folded]) * 1.0))
        array.clock = lambda: 61.0
        assert array.contacts() == 0  # folded it turns freely
        array.go(CountPath(np.arange(1), np.array([[0.0], [60.0]]), np.stack([folded, counts]) * 1.0))
        assert array.contacts() == contacts


def test_a_weak_motor_is_found_at_its_switch():
    array, now = StepperArray(PLANE, seed=0, contacts=False), [0.0]
    array.clock = lambda: now[0]
    array.inject(Fault("slipping", int(PLANE.positioner_id[4])))
    every, counts = np.arange(len(PLANE)), np.tile([16000, 0], (len(PLANE), 1))
    array.go(
        CountPath(
            every, np.array([[0.0], [10.0]]) + np.zeros(len(PLANE)), np.stack([0 * counts, counts]) * 1.0
        )
    )
    now[0] = 11.0
    _, found, slip = array.seek(every, 0, 3000.0)
    assert found.all()
    assert 0.02 * 16000 <= slip[4] <= 0.2 * 16000
    assert np.abs(np.delete(slip, 4)).max() == 0


def test_a_table_without_the_twins_sizes_is_refused_in_one_line():
    instrument = PLANE.instrument.model_copy(update={"twin": {"steppers": {"body_radius_mm": -1.0}}})
    plane = fl.FocalPlane.of("megara", seed=0, n=3)
    object.__setattr__(plane, "instrument", instrument)
    with pytest.raises(InputError, match=r"megara: twin\.steppers\.body_radius_mm: "):
        StepperArray(plane)


def test_faults_that_steppers_do_not_have_are_refused():
    with pytest.raises(InputError, match="stuck_hall"):
        twin_source(PLANE, 0, "noise", "stuck_hall=1")


def test_a_field_of_the_real_tables(shared_megara, tmp_path):
    """92 robots of the public table, eight more that are disabled and stand folded."""
    plane = fl.FocalPlane.read(shared_megara, "megara")
    seen = fl.Field.twin(plane, seed=0, camera="noise").run.observe(
        random_targets(plane, 200, seed=0), out=tmp_path / "run"
    )
    summary = seen.summary()
    assert summary["n_assigned"] >= 80
    assert summary["n_within_requirement"] == summary["n_assigned"]
    assert summary["moves"][0]["true_rms_um"] < 25.0
    assert summary["contacts_true"] == 0
