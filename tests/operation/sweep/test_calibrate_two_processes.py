"""An array in another process: swept, with a stop in the middle, observed with its maps, and the same as the
one of its seed here."""

import json
import signal
import subprocess
import time

import numpy as np
import pytest
from programs import served_array, start

import fiberloom as fl
from fiberloom.blocking import finish
from fiberloom.bus.client import Client
from fiberloom.bus.spec import BusSpec
from fiberloom.calibration.transmission.maps import load
from fiberloom.metrology.sources.spec import CameraSpec, open_camera
from fiberloom.operation.sweep.kept import KEPT
from fiberloom.store.arrays import ArrayBook
from fiberloom.store.database import Store
from fiberloom.targets import random_targets, write_targets
from fiberloom.twin.source import TwinSource

N, SEED, POINTS = 3, 3, 8
STOPPED_AFTER = 5
EXPOSURE_S = 2
"""In place of 5 s, for some 45 images."""


def told(*words):
    """What a command prints as JSON, and its exit code."""
    with start(*words, "--json", stdout=subprocess.PIPE) as command:
        out, err = command.communicate(timeout=3600)  # 33 images, whatever else the machine does
    assert command.returncode in (0, 1), err
    return json.loads(out), command.returncode


def stopped(folder, *words):
    """Ends a command by SIGTERM once it has measured some points of a sweep; its exit code."""
    with start(*words, "--json", stdout=subprocess.PIPE) as command:
        while command.poll() is None and (not (folder / KEPT).exists() or points(folder) < STOPPED_AFTER):
            time.sleep(0.2)
        command.send_signal(signal.SIGTERM)
        _, err = command.communicate(timeout=300)
    return command.returncode, err


def points(folder):
    """How many points of a sweep are kept."""
    with np.load(folder / KEPT) as file:
        return int(file["head0"][3])


@pytest.mark.long
def test_maps_of_an_array_in_another_process_are_those_of_its_units(tmp_path):
    plane = fl.FocalPlane.of("sdssv", n=N, seed=SEED)
    bench = fl.Field.twin(plane, seed=SEED, camera="noise").run.sweep(POINTS).maps
    write_targets(random_targets(plane, 20 * N, 1), tmp_path / "targets.csv")
    blind_um = {}
    with served_array(N, SEED) as (bus, camera):
        camera = f"{camera}&exposure={EXPOSURE_S}"
        known = ["--positioners", N, "--seed", SEED, "--bus", bus, "--camera", camera]
        known += ["--store", tmp_path / "arrays.sqlite"]
        words = ["calibrate", "transmission", "--points", POINTS, "--out", tmp_path / "cal"]
        code, err = stopped(tmp_path / "cal", *words, *known)
        assert code == 130, err
        before = points(tmp_path / "cal")
        assert STOPPED_AFTER <= before < 2 * POINTS
        found, code = told(*words, *known)
        assert (code, found["calibrated"], found["refused"]) == (0, N, {})
        with Store.open(tmp_path / "cal" / "store.sqlite") as store:
            kinds = [store.moves(run.id)["kind"].tolist() for run in store.runs()]
        assert [kinds[0].count("sweep, alpha up"), sum(k.count("sweep, alpha up") for k in kinds)] == [
            min(before, POINTS),
            POINTS,
        ]
        book = ArrayBook(Store.open(tmp_path / "arrays.sqlite"), bus)
        assert (book.state().state, book.state().owned) == ("parked", False)
        for name, maps in (("linear", []), ("swept", ["--calibration", found["maps"]])):
            observe = ["observe", tmp_path / "targets.csv", "--moves", 1, "--pages", "none", *maps]
            seen, _ = told(*observe, "--out", tmp_path / name, *known)
            blind_um[name] = seen["moves"][0]["measured_rms_um"]
    off_deg = load(found["maps"]).output_deg - bench.output_deg
    rest_deg = off_deg - off_deg.mean(axis=(2, 3), keepdims=True)
    assert np.sqrt((rest_deg**2).mean()) < 0.006  # of images: 0.67 um over 14 mm and more, twice
    assert np.abs(off_deg).max() < 0.05
    assert np.sqrt(((bench.output_deg - bench.wire_deg) ** 2).mean()) > 0.1
    assert blind_um["swept"] < 0.6 * blind_um["linear"], blind_um


@pytest.mark.slow
def test_twin_and_observe_with_one_seed_are_one_array():
    """The same wire positions put the same fibres to the same places; those of another seed elsewhere."""
    plane = fl.FocalPlane.of("sdssv", n=N, seed=SEED)
    with served_array(N, SEED) as (bus, camera):
        outside_mm = finish(
            sent(lambda: BusSpec.parse(bus).open(), plane, lambda at: seen_by(camera, plane, at))
        )
    ours, other = (here_mm(plane, seed) for seed in (SEED, SEED + 1))
    assert np.hypot(*(outside_mm - ours).T).max() < 0.005
    assert np.hypot(*(outside_mm - other).T).max() > 0.03


def here_mm(plane, seed):
    """Where the fibres of a twin of this process are, sent to the same wire positions."""
    hardware = TwinSource(plane, seed, "noise", "").hardware

    async def opened():
        return hardware.transport

    return finish(sent(opened, plane, lambda at: hardware.camera.measure(at).xy_mm))


async def sent(open_bus, plane, look):
    """Fibres (N, 2) in mm as seen by `look`, after one motion of all to one wire position."""
    client = Client(await open_bus())
    try:
        assert sorted(await client.discover()) == sorted(plane.positioner_id.tolist())
        begun = await client.goto(None, 130.0, 95.0)
        assert begun.ok.all()
        assert (await client.wait_until_done(timeout_s=120.0)).ok.all()
        return look(plane.forward(np.full(len(plane), 130.0), np.full(len(plane), 95.0)))
    finally:
        await client.close()


def seen_by(camera, plane, expected_mm):
    image = open_camera(CameraSpec.parse(camera), plane).measure(expected_mm)
    assert image.seen.all()
    return image.xy_mm
