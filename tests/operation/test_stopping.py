"""When the correction loop ends: the rule alone, and the whole loop on the twin."""

import asyncio
from dataclasses import replace

import numpy as np
import pytest

from fiberloom.assignment import assign
from fiberloom.bus.client import Client
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.calibration.transmission.sweep import SweepSettings, calibrate_transmission
from fiberloom.instruments import generate, load_instrument
from fiberloom.operation.correction import whole_steps
from fiberloom.operation.loop import Loop, LoopSettings
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.stopping import StopRule
from fiberloom.studies.paper.no_record import NoRecord
from fiberloom.targets import random_targets
from fiberloom.twin import bench_hardware, draw_units, field_hardware

N, SEED = 7, 3


def test_a_percentile_ends_the_loop_at_its_limit():
    rule = StopRule("percentile", 90.0, 30.0)
    nine_near = np.append(np.full(9, 10.0), 1000.0)
    assert not rule.satisfied(nine_near)  # between the ninth and the tenth: 109 um
    assert rule.satisfied(np.append(nine_near, 10.0))
    assert rule.satisfied(np.full(5, 30.0))
    assert not rule.satisfied(np.full(5, 30.0001))
    assert not rule.arrived(np.full(5, 1.0)).any()


def test_a_positioner_within_the_limit_has_arrived_and_one_not_seen_has_not():
    rule = StopRule("positioner", 100.0, 5.0)
    assert rule.arrived(np.array([4.9, 5.0, 5.1, np.nan])).tolist() == [True, True, False, False]
    assert rule.satisfied(np.array([]))
    assert not rule.satisfied(np.array([5.1]))


def test_a_fixed_rule_never_ends_early():
    assert not StopRule().satisfied(np.zeros(3))
    assert not StopRule().satisfied(np.array([]))


def test_presets_have_the_rules_of_their_instruments():
    rules = {name: StopRule.of(load_instrument(name).operation) for name in ("sdssv", "pfs", "desi")}
    assert rules["sdssv"] == StopRule("percentile", 100.0, 5.0)
    assert rules["pfs"] == StopRule("positioner", 100.0, 2.5)
    assert rules["desi"] == StopRule("positioner", 100.0, 5.0)
    operation = load_instrument("sdssv").operation.model_copy(update={"stop_below_um": None})
    assert StopRule.of(operation).below_um == operation.requirement_um == 5.0
    assert LoopSettings.of(operation).moves == 3
    assert LoopSettings.of(operation, 5) == LoopSettings(moves=5)


def test_steps_are_whole_and_less_than_half_a_one_is_none():
    here = np.array([[10.0, 20.0], [10.0, 20.0]])
    wanted = here + np.array([[0.034, 0.034], [-0.12, 0.001]])
    got = whole_steps(here, wanted, np.array([0.07, 0.0]))
    np.testing.assert_allclose(got[:, 0], [10.0, 9.86], atol=1e-12)
    assert (got[:, 1] == wanted[:, 1]).all()


@pytest.fixture(scope="module")
def field():
    plane = generate(load_instrument("sdssv"), SEED, n_positioners=N)
    units = draw_units(plane, SEED)
    bench = bench_hardware(plane, units, SEED)
    client = Client(bench.transport)

    async def maps() -> TransmissionMaps:
        await client.discover()
        return (await calibrate_transmission(client, bench.camera, plane, SweepSettings(40), seed=SEED)).maps

    return plane, units, asyncio.run(maps())


def observed(field, moves=None, step_deg=0.0, **operation):
    """A finished loop by these rules of the instrument."""
    plane, units, maps = field
    instrument = plane.instrument
    rules = instrument.operation.model_copy(update=operation)
    axes = {n: getattr(instrument, n).model_copy(update={"step_deg": step_deg}) for n in ("alpha", "beta")}
    instrument = instrument.model_copy(update={"operation": rules, **axes})
    host = plane.__class__(**{**vars(plane), "instrument": instrument})
    targets = random_targets(plane, 40 * N, SEED)
    hardware = field_hardware(plane, units, SEED)
    settings = LoopSettings.of(rules, moves, seed=SEED)
    motion = FieldMotion(host, maps, hardware, NoRecord())
    loop = Loop(motion, assign(host, targets, seed=SEED), settings)

    async def whole():
        await motion.connect()
        await loop.run()

    asyncio.run(whole())
    return loop


def within(loop, move):
    return np.nanmax(loop.moves[move].measured_error_um)


def test_the_telescopes_limit_ends_after_the_blind_move_and_the_requirement_after_a_correction(field):
    blind = observed(field, stop_below_um=30.0)
    assert len(blind.moves) == 1
    assert "within the limit of 30 um" in blind.stopped
    near = observed(field, corrections_max=6)
    assert 1 < len(near.moves) < 7
    assert np.nanmax(near.moves[-1].measured_error_um) <= 5.0
    assert np.nanmax(near.moves[-2].measured_error_um) > 5.0
    never = observed(field, stop_below_um=1e-6)
    assert len(never.moves) == 3
    assert never.stopped.startswith("all 3 moves made, 100 %")


def test_moves_asked_for_are_made_exactly(field):
    assert len(observed(field, moves=2).moves) == 2
    loop = observed(field, moves=4)
    assert [len(loop.moves), loop.stopped] == [4, "all 4 moves made"]


def test_moves_that_did_not_come_to_their_end_are_told(field):
    loop = observed(field, moves=2)
    loop.motion.moves[1] = replace(loop.moves[1], interrupted=True)
    assert loop._why_stopped() == "all 2 moves made, 1 of 2 cut short"


def test_a_positioner_within_the_limit_is_not_moved_again(field):
    blind_um = observed(field, moves=1).moves[0].measured_error_um
    limit_um = float(np.nanmedian(blind_um))
    loop = observed(field, stop_rule="positioner", stop_below_um=limit_um)
    near = blind_um <= limit_um
    moved = (loop.moves[1].commanded_deg != loop.moves[0].wire_deg).any(axis=1)
    sent = {r.positioner_id for r in loop.moves[1].plan.robots if r.moves}
    assert sent == set(loop.plane.positioner_id[~near].tolist())
    assert moved[~near].all()
    assert loop.stopped.startswith("0 fibres")


def test_a_correction_is_made_of_whole_steps(field):
    step_deg = 0.02
    loop = observed(field, moves=2, step_deg=step_deg)
    change = loop.moves[1].commanded_deg - loop.maps.to_output(loop.moves[0].wire_deg)
    steps = change / step_deg
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)
    assert np.abs(np.rint(steps)).max() >= 1
    # so coarse that nothing is worth a step: no trajectory is sent
    coarse = observed(field, moves=2, step_deg=1.0)
    assert not any(robot.moves for robot in coarse.moves[1].plan.robots)
