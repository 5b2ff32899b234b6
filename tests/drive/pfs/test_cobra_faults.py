"""Faults of cobras through whole observations: each is named, the others come to their targets."""

import asyncio
import sys
from pathlib import Path

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.connect import open_hardware
from fiberloom.drive.piezo import write_summary_maps
from fiberloom.errors import InputError
from fiberloom.health.status import FibreStatus
from fiberloom.targets.generate import random_targets
from fiberloom.twin.camera.noise_camera import NoiseCamera
from fiberloom.twin.cobras.served import ServedCobras
from fiberloom.twin.cobras.source import CobraSource
from fiberloom.twin.server.address import Address

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from support.cobras import cut_in_second_run, pfs_plane

N = 114
PLANE = pfs_plane(N)
REQUIREMENT_UM = 5.0


def observed(tmp_path, prepare=lambda source: None, faults=""):
    """The source and the moves of an observation of two modules, four boards."""
    source = CobraSource(PLANE, 3, "noise", faults, calibrated=False)
    prepare(source)
    field = fl.Field(PLANE, source, 3)
    targets = random_targets(PLANE, 6 * N, seed=3)
    seen = asyncio.run(field.observe(targets, 7, out=tmp_path))
    return source, seen


def near(source, seen, rows):
    """Share of those `rows` with a target that are truly within the requirement."""
    has = seen.assignment.target >= 0
    goal = PLANE.forward(*seen.assignment.goal_deg.T)
    off_um = 1e3 * np.hypot(*(source.array.fibre_xy() - goal).T)
    return np.mean(off_um[has & rows] < REQUIREMENT_UM)


def test_stuck_cobras_are_named_by_moves_that_do_nothing(tmp_path):
    source, seen = observed(tmp_path, faults="dead=4")
    status, stuck = np.array(seen.moves[-1].status), source.array.stuck
    # one whose target is hardly away from home cannot be told from one that need not move
    goal, home = PLANE.forward(*seen.assignment.goal_deg.T), PLANE.forward(*source.array.truth().T)
    told = stuck & (np.hypot(*(goal - home).T) > 1.0)
    assert told.sum() >= 3
    assert np.all(status[told] == FibreStatus.DEAD)
    assert not np.any(status[~stuck] == FibreStatus.DEAD)
    assert near(source, seen, ~stuck) > 0.85
    assert source.array.contacts() == 0


def test_half_of_the_boards_without_power_are_flagged_and_the_rest_goes_on(tmp_path):
    def cut(source):
        source.boards.boards.unpowered |= {3, 4}

    source, seen = observed(tmp_path, cut)
    status = np.array(seen.moves[-1].status)
    dark = PLANE.positioner_id > 57
    assert np.all(np.isin(status[dark], [FibreStatus.DEAD, FibreStatus.DISCONNECTED]))
    assert np.all(source.array.angle_deg[dark] == 0.0)
    assert near(source, seen, ~dark & ~source.array.stuck) > 0.85


def test_a_connection_that_drops_in_a_run_costs_a_move(tmp_path):
    runs = []
    source, seen = observed(tmp_path, lambda one: runs.append(cut_in_second_run(one)))
    assert len(runs[0]) >= 8
    assert source.hardware.drive.client.reconnected >= 1
    assert near(source, seen, ~source.array.stuck) > 0.8
    assert source.array.contacts() == 0


def test_served_cobras_are_homed_and_moved_over_tcp(tmp_path):
    """The same array by its address: maps from a file, no truth, fibres behind dots unseen."""
    plane, file = pfs_plane(7), tmp_path / "maps.npz"
    twin = CobraSource(plane, 0, "noise", calibrated=False)
    write_summary_maps(file, twin.known_maps, plane.positioner_id)
    twin.array.motors.angle_deg[:] = 20.0
    twin.array._way_deg[:] = 20.0

    async def go():
        served = ServedCobras(twin.array, Address("127.0.0.1", 14731), speed=400.0)
        await served.open()
        source = open_hardware(plane, "fpga://127.0.0.1:14731", NoiseCamera(twin.array, 1.4, 0))
        with pytest.raises(InputError, match="motor maps of its cobras by --calibration"):
            await source.open()
        source.know(file)
        hardware = await source.open()
        await hardware.drive.connect()
        report, look = served.report(), served.look()
        await hardware.drive.close()
        served.close()
        return hardware, report, look

    hardware, report, look = asyncio.run(go())
    assert hardware.truth is None
    assert hardware.drive.ids == list(range(1, 8))
    assert report["runs"] == 6
    home = ~twin.array.stuck
    assert np.all(twin.array.angle_deg[home] == 0.0)
    assert np.isnan(look.lit_mm[:, 0]).tolist() == twin.array.dark.tolist()
