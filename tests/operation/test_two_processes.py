"""Host and array as two processes that share sockets and nothing else."""

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from programs import served_array, small_camera, start

import fiberloom as fl
from fiberloom.store import Store
from fiberloom.store.run import STOPPED
from fiberloom.targets import random_targets, write_targets

N = 7
PATIENCE_S = 120
"""What comes by itself may take so long on a machine with other work."""

HOST = """
import json, sys
import fiberloom as fl

plane = fl.FocalPlane.of("sdssv", n=7)
field = fl.Field.open(plane, sys.argv[1], sys.argv[2], calibration="maps.npz")
seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1, out="outside")
twin = [name for name in sys.modules if name.startswith("fiberloom.twin")]
print(json.dumps({"summary": seen.summary(), "twin": twin}, default=str))
"""


@pytest.fixture(scope="module")
def near(tmp_path_factory):
    """Targets a few seconds away, maps, and what an observation in one process measures."""
    folder = tmp_path_factory.mktemp("near")
    plane = fl.FocalPlane.of("sdssv", n=N)
    xy_mm = plane.forward(*(plane.park_deg + np.array([20.0, -20.0])).T, "BOSS")
    (folder / "targets.csv").write_text(
        "target_id,x_mm,y_mm,fibre\n" + "".join(f"T{i},{x},{y},BOSS\n" for i, (x, y) in enumerate(xy_mm))
    )
    targets = fl.read_targets(folder / "targets.csv")
    field = fl.Field.twin(plane)
    field.run.calibrate().save(folder / "maps.npz")
    return folder, field.run.observe(targets, corrections=1, out=folder / "inside").summary()


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """Targets half a minute away, maps, and an instrument with a small camera."""
    folder = tmp_path_factory.mktemp("two")
    plane = fl.FocalPlane.of(str(small_camera(folder)), n=N)
    write_targets(random_targets(plane, 20 * N, 1), folder / "targets.csv")
    fl.Field.twin(plane).run.calibrate().save(folder / "maps.npz")
    return folder


@pytest.mark.slow
def test_the_host_sees_what_one_process_sees_and_loads_no_twin(near):
    folder, inside = near
    with served_array(N) as addresses:
        done = subprocess.run(
            [sys.executable, "-c", HOST, *addresses], cwd=folder, capture_output=True, text=True, timeout=300
        )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["twin"] == []
    seen = told["summary"]
    assert seen["n_within_requirement"] == seen["n_assigned"] == inside["n_assigned"] > 0
    ours, theirs = (np.array([move["measured_rms_um"] for move in s["moves"]]) for s in (seen, inside))
    # the blind miss is that of the gears; a correction's is the camera's noise, other draws of few fibres
    np.testing.assert_allclose(ours[0], theirs[0], rtol=0.05)
    assert ours[1] < 2.0 * theirs[1]


def small_array(desk):
    return served_array(N, instrument=desk / "small.toml")


def observing(desk, tmp_path, bus, camera):
    """`fiberloom observe` at the array, in a process of its own."""
    words = ["observe", desk / "targets.csv", "--positioners", N, "--instrument", desk / "small.toml"]
    words += ["--bus", bus, "--camera", f"{camera}&exposure=0.5"]
    words += ["--calibration", desk / "maps.npz", "--out", tmp_path, "--store", tmp_path / "arrays.sqlite"]
    return start(*words)


def in_motion(host):
    """Waits until the host has begun the blind move, and for some seconds more."""
    said = []
    while "blind\n" not in said:
        said.append(host.stderr.readline())
        assert said[-1], said
    time.sleep(3.0)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_host_that_is_told_to_end_leaves_the_array_at_rest(desk, tmp_path, number):
    with small_array(desk) as (bus, camera):
        with observing(desk, tmp_path, bus, camera) as host:
            in_motion(host)
            host.send_signal(number)
            _, rest = host.communicate(timeout=PATIENCE_S)
        assert host.returncode == 130, rest
        assert f"stopped by the operator; {N} positioners at rest" in rest
        before = at_rest(bus)
    with Store.open(tmp_path / "store.sqlite") as store:
        (run,) = store.runs()
        assert run.status == "interrupted"
        rows = store.measurements(run.id)
        left = np.column_stack([rows[f"wire_{axis}_deg"] for axis in ("alpha", "beta")])
        left = left[rows["kind"] == STOPPED]
    np.testing.assert_allclose(left, before, atol=0.1)  # cogging pulls a rotor at rest


# `fiberloom stop`, where the gateway has one connection and a motion may have it


def stopping(bus, tmp_path):
    """What `fiberloom stop` says, and its exit code."""
    with start(
        "stop", "--bus", bus, "--store", tmp_path / "arrays.sqlite", "--json", stdout=subprocess.PIPE
    ) as stop:
        told, rest = stop.communicate(timeout=PATIENCE_S)
    assert told, rest
    return stop.returncode, json.loads(told)


@pytest.mark.slow
def test_stop_asks_the_command_that_moves_the_array_and_an_idle_array_itself(desk, tmp_path):
    with small_array(desk) as (bus, camera):
        with observing(desk, tmp_path, bus, camera) as host:
            in_motion(host)
            code, told = stopping(bus, tmp_path)
            _, rest = host.communicate(timeout=PATIENCE_S)
        assert (code, told["stopped"], told["by"]) == (0, True, "owner")
        assert "has stopped it: stopped by" in told["text"]
        assert host.returncode == 130
        assert f"{N} positioners at rest" in rest
        before = at_rest(bus)
        assert on_their_way(before)
        code, told = stopping(bus, tmp_path)
        assert (code, told["by"]) == (0, "own connection")
        np.testing.assert_allclose(at_rest(bus), before, atol=0.1)


@pytest.mark.slow
def test_stop_reaches_an_array_whose_command_was_killed(desk, tmp_path):
    """No command is left to be asked; the positioners go on, and the gateway is free."""
    with small_array(desk) as (bus, camera):
        with observing(desk, tmp_path, bus, camera) as host:
            in_motion(host)
            host.kill()
        earlier, later = positions(bus)
        assert np.abs(later - earlier).max() > 0.5  # they go on
        code, told = stopping(bus, tmp_path)
        assert (code, told["stopped"], told["by"]) == (0, True, "own connection")
        assert f"{N} positioners have answered" in told["text"]
        assert on_their_way(at_rest(bus))


@pytest.mark.slow
def test_a_command_that_hangs_is_named_and_ends_as_soon_as_it_lives(desk, tmp_path):
    """It holds the one connection, so nothing else can reach the positioners."""
    with small_array(desk) as (bus, camera):
        with observing(desk, tmp_path, bus, camera) as host:
            in_motion(host)
            host.send_signal(signal.SIGSTOP)
            code, told = stopping(bus, tmp_path)
            host.send_signal(signal.SIGCONT)
            _, rest = host.communicate(timeout=PATIENCE_S)
        assert (code, told["stopped"]) == (1, False)
        assert "does not answer" in told["text"]
        assert str(host.pid) in told["text"]
        assert host.returncode in (1, 130), rest
        assert f"{N} positioners at rest" in rest
        at_rest(bus)


def on_their_way(where_deg):
    """They have left the fold. The blind move takes half a minute, and it was stopped after some seconds."""
    park = fl.FocalPlane.of("sdssv", n=N).park_deg
    return np.abs(where_deg - park).max() > 5.0


def at_rest(bus):
    """Wire positions (N, 2) in deg of positioners that have stopped."""
    before, after = positions(bus)
    assert np.abs(before - after).max() < 0.02
    return before


def positions(bus):
    """Wire positions (N, 2) in deg, twice, a second apart."""
    from fiberloom.blocking import finish
    from fiberloom.bus.client import Client
    from fiberloom.bus.spec import BusSpec

    async def asked():
        client = Client(await BusSpec.parse(bus).open())
        try:
            await client.discover()
            looks = [await client.positions_deg()]
            await client.sleep(1.0)
            looks.append(await client.positions_deg())
            assert all(answered.all() for _, answered in looks)
            return [wire_deg for wire_deg, _ in looks]
        finally:
            await client.close()

    return finish(asked())
