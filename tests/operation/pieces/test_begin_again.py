"""The begin check is done again by the last image only where all say that they are where they were."""

import asyncio

import numpy as np
import pytest

from fiberloom.bus.client import Client
from fiberloom.calibration.transmission.maps import identity
from fiberloom.instruments import FocalPlane
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.safety.begin import Standing
from fiberloom.studies.paper.no_record import NoRecord
from fiberloom.twin import draw_units
from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.hardware import field_hardware

PLANE = FocalPlane.of("sdssv", n=7)
ROW = 3
NUMBER = int(PLANE.positioner_id[ROW])


def test_one_that_was_silent_and_moved_is_looked_for_in_another_image():
    hardware = field_hardware(PLANE, draw_units(PLANE, 0), 0, camera="image")
    twin = hardware.truth

    async def cut_off_on_its_way():
        client = Client(hardware.transport)
        await client.discover()
        assert (await client.goto([NUMBER], 60.0, 120.0)).ok.all()
        await client.sleep(2.0)
        for kind in ("deaf", "mute"):
            twin.inject(Fault(kind, NUMBER))
        motion = FieldMotion(PLANE, identity(PLANE.positioner_id), hardware, NoRecord())
        await motion.connect()
        assert motion.state.beginning.standing[ROW] is Standing.SILENT
        for kind in ("deaf", "mute"):
            twin.clear(Fault(kind, NUMBER))
        await client.sleep(0.5)
        await motion.begin_again(by_last_image=True)
        return motion

    motion = asyncio.run(cut_off_on_its_way())
    assert hardware.camera.source.exposures == 2
    assert motion.state.beginning.standing[ROW] is Standing.RIGHT
    np.testing.assert_allclose(motion.state.here_deg[ROW], twin.truth()[ROW], atol=0.5)


@pytest.mark.parametrize("told", [False, True])
def test_where_nobody_has_moved_the_last_image_serves_again(told):
    hardware = field_hardware(PLANE, draw_units(PLANE, 0), 0, camera="image")
    turn_deg = 360.0 / PLANE.instrument.axes[0].gear

    async def told_another_turn():
        motion = FieldMotion(PLANE, identity(PLANE.positioner_id), hardware, NoRecord())
        await motion.connect()
        first = motion.image
        if told:  # a turn of beta, and back: what it reports is read anew
            for off_deg in (turn_deg, -turn_deg):
                at_deg = motion.state.wire_deg[[ROW]] + [0.0, off_deg]
                assert (await motion.client.set_position([NUMBER], *at_deg.T)).ok.all()
                await motion.read_positions(np.array([NUMBER]))
        await motion.begin_again(by_last_image=True)
        return motion, first

    motion, first = asyncio.run(told_another_turn())
    assert hardware.camera.source.exposures == 1
    np.testing.assert_array_equal(motion.image.xy_mm, first.xy_mm)
    assert all(standing is Standing.RIGHT for standing in motion.state.beginning.standing)
