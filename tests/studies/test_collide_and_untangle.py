"""A real collision on the twin, and the way out of it, carried out by the firmware."""

import asyncio

import pytest

from fiberloom.bus.client import Client
from fiberloom.calibration.transmission.sweep import SweepSettings, calibrate_transmission
from fiberloom.instruments import generate, load_instrument
from fiberloom.studies.untangling import collide_and_untangle
from fiberloom.twin import bench_hardware, draw_units

N = 13


@pytest.fixture(scope="module")
def field():
    plane = generate(load_instrument("sdssv"), 0, n_positioners=N)
    bench = bench_hardware(plane, draw_units(plane, 0), 0)

    async def maps():
        client = Client(bench.transport)
        await client.discover()
        return (await calibrate_transmission(client, bench.camera, plane, SweepSettings(40), seed=0)).maps

    return plane, asyncio.run(maps())


@pytest.mark.parametrize(("kind", "seed"), [("two arms", 0), ("knot", 1), ("fiducial", 0)])
def test_after_a_collision_all_get_home_and_nothing_touches_anew(field, kind, seed):
    plane, maps = field
    seen = asyncio.run(collide_and_untangle(plane, maps, seed, kind))
    assert len(seen.touches) >= (2 if kind == "knot" else 1)
    assert (seen.touches[0].other is None) == (kind == "fiducial")
    assert seen.collisions >= 1  # the firmware has seen it
    assert seen.free
    assert seen.new_touches == ()
    assert seen.at_goal == seen.positioners == N
    assert len(seen.found) == 1
    retreats = [stage for stage in seen.found[0].stages if stage.separates]
    assert retreats
    assert all(stage.uncertainty_deg == 0.2 for stage in retreats)


def test_one_that_is_dead_after_the_collision_stays_and_is_gone_round(field):
    plane, maps = field
    seen = asyncio.run(collide_and_untangle(plane, maps, 0, "immobile"))
    assert seen.touches
    assert seen.free
    assert seen.new_touches == ()
    (found,) = seen.found
    assert seen.at_goal == N - 1 - len(found.refused)
