"""Kronig 2020, Fig. 18 and 19, from photons and pixels end to end."""

import asyncio
from dataclasses import replace

import numpy as np
import pytest

from fiberloom.bus import Client
from fiberloom.calibration import SweepSettings, calibrate_transmission
from fiberloom.instruments import generate
from fiberloom.operation.correction import CorrectionLoop
from fiberloom.twin import BenchCamera, Twin, TwinTransport, draw_units, static_fibre_um
from fiberloom.twin.camera.models import camera_model


def rms(xy):
    return float(np.sqrt(np.mean(np.sum(np.square(xy), axis=-1))))


@pytest.mark.parametrize(
    ("name", "images", "paper_um"), [("workspace", 800, 0.669), ("close-up", 150, 0.101)]
)
def test_figure_18_repeatability_of_a_fibre_that_stands(name, images, paper_um):
    xy, stated = static_fibre_um(name, images, seed=1)
    # 800 and 150 images: 2 and 4 % of scatter, three times that
    tolerance = 3.0 / np.sqrt(4 * images)
    assert rms(xy) == pytest.approx(paper_um, rel=tolerance + 0.02)
    assert rms(xy) == pytest.approx(stated, rel=tolerance + 0.02)


def test_light_is_what_limits_it():
    """Four times the images, half the scatter: nothing else is put in."""
    model = camera_model("workspace")
    once = rms(static_fibre_um(model, 300, seed=2)[0])
    four = rms(static_fibre_um(replace(model, average=4), 300, seed=2)[0])
    # two ratios of 600 numbers each: 4 %
    assert four / once == pytest.approx(0.5, rel=0.12)


@pytest.mark.slow
def test_figure_19_a_bench_that_sees_through_images(sdssv):
    """Blind by a coarse map, then Eq. 25: settles at the camera's noise, sqrt(2) of it as measured."""
    plane = generate(sdssv, 3, n_positioners=3)
    twin = Twin(plane, draw_units(plane, 3), seed=3, neighbours=False)
    client, camera = Client(TwinTransport(twin)), BenchCamera(twin, "workspace", seed=3)
    ids = plane.positioner_id.tolist()
    measured, true = asyncio.run(_visit(plane, twin, client, camera, ids))
    assert 3.0 < measured[0] < 60.0
    # 3 units, 6 targets and 3 moves: 54 distances, 10 %
    assert np.mean(measured[2:]) == pytest.approx(np.sqrt(2) * 0.69, rel=0.3)
    assert np.mean(true[2:]) == pytest.approx(0.72, rel=0.3)


async def _visit(plane, twin, client, camera, ids):
    await client.discover()
    maps = (await calibrate_transmission(client, camera, plane, SweepSettings(60), seed=3)).maps
    await client.set_precise_moves(ids, on=True)
    rng = np.random.default_rng(5)
    measured, true = np.zeros((6, 5, 3)), np.zeros((6, 5, 3))
    everybody = np.ones(3, dtype=bool)
    for target in range(6):
        goal = rng.uniform([20.0, 25.0], [340.0, 155.0], (3, 2))
        loop, command = CorrectionLoop(plane, goal, filtered=False), goal
        for move in range(5):
            wire = maps.to_wire(command)
            await client.goto(ids, wire[:, 0], wire[:, 1])
            await client.wait_until_done(ids, 120.0, stop_on_collision=False)
            seen = camera.measure()
            assert seen.seen.all()
            measured[target, move] = 1e3 * np.hypot(*(seen.xy_mm - loop.target_mm).T)
            true[target, move] = 1e3 * np.hypot(*(twin.fibre_xy() - loop.target_mm).T)
            here, _ = await client.positions_deg(ids)
            command = loop.update(maps.to_output(here), seen.xy_mm, everybody)
    return np.sqrt(np.mean(measured**2, axis=(0, 2))), np.sqrt(np.mean(true**2, axis=(0, 2)))
