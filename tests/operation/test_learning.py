"""Observations that learn, and the survey of a focal plane, on the physics twin."""

import dataclasses
import json
import signal
import time

import numpy as np
import pytest
from programs import start

from fiberloom.cli.calibrate.focal_plane import FocalPlaneOptions, focal_plane
from fiberloom.cli.observe import CameraKind, ObservationOptions
from fiberloom.cli.observe import observe as run_observe
from fiberloom.instruments import generate, load_instrument
from fiberloom.store import Store
from fiberloom.store.calibrations import digest_of
from fiberloom.store.generations import go_back, learnt_generations
from fiberloom.targets import random_targets, write_targets

N, SEED = 12, 4  # the field of test_observe.py: its transmission is calibrated once for both


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    folder = tmp_path_factory.mktemp("learning")
    plane = generate(load_instrument("sdssv"), SEED, n_positioners=N)
    whole = random_targets(generate(load_instrument("sdssv"), SEED), 3000, SEED)
    near = np.flatnonzero(np.hypot(whole.x_mm, whole.y_mm) < 70.0)
    write_targets(whole.select(near), folder / "targets.csv")
    return plane, folder


def observe(field, name, **asked):
    plane, folder = field
    options = ObservationOptions(
        targets=folder / "targets.csv", out=folder / name, seed=SEED, moves=2, positioners=len(plane),
        camera=CameraKind.noise, as_json=True, **asked,
    )  # fmt: skip
    run_observe(options)
    return json.loads((folder / name / "summary.json").read_text())


def surveyed(options):
    focal_plane(options)
    return json.loads((options.out / "focal_plane.json").read_text())


def test_the_second_observation_knows_what_the_first_has_seen(field):
    store = str(field[1] / "learnt.sqlite")
    first = observe(field, "a", adapt=True, learnt=store)
    second = observe(field, "b", adapt=True, learnt=store)
    assert first["learnt"] == {"store": store, "generation": 1, "moves": 2 * N, "refused": 0}
    # the same targets: each measurement was made where it is needed now
    assert second["moves"][0]["true_rms_um"] < 0.25 * first["moves"][0]["true_rms_um"]
    assert [g["moves_learnt"] for g in learnt_generations(store, None)] == [2, 4]
    back = go_back(store, 0, None)
    assert (back["generation"], back["positioners"]) == (3, N)
    third = observe(field, "c", learnt=store)
    with Store.open(field[1] / "b" / "store.sqlite") as kept:
        assert kept.calibrated(1) == {"learnt": N, "transmission": N}
    assert third["moves"][0]["true_rms_um"] == pytest.approx(first["moves"][0]["true_rms_um"], rel=1e-3)
    assert "learnt" not in third  # reads what was learnt, and learns nothing
    go_back(store, 2, [int(field[0].positioner_id[0])])
    assert learnt_generations(store, int(field[0].positioner_id[0]))[-1]["moves_learnt"] == 4


def test_faults_teach_nothing(field):
    store = str(field[1] / "faulty.sqlite")
    summary = observe(field, "faulty", adapt=True, learnt=store, faults="dark=1,lying=1")
    bad = summary["faults"]["dark"] + summary["faults"]["lying"]
    for positioner in bad:
        assert learnt_generations(store, positioner) == []
    assert summary["learnt"]["moves"] <= 2 * (N - 2)


def test_the_survey_finds_the_arms_and_observe_uses_them(field):
    plane, folder = field
    options = FocalPlaneOptions(
        out=folder / "arms", seed=SEED, positioners=len(plane), configurations=8, faults="dark=1,lying=1",
        as_json=True,
    )  # fmt: skip
    summary = surveyed(options)
    assert summary["calibrated"] == N - 2
    assert len(summary["refused"]) == 2
    last = summary["convergence"][-1]
    print("\n8 configurations:", last)
    assert max(last["error_um"].values()) < 1.5
    # errors are what the fit says they are: ten positioners, four numbers each
    for name, error in last["error_um"].items():
        assert error < 2.0 * last["standard_error_um"][name]
    stamp = json.loads((folder / "arms" / "focal_plane.json").read_text())
    assert {"version", "seed", "instrument", "config_hash", "utc"} <= set(stamp)
    # the store alone gives the same arms (and the folded place as a ninth configuration)
    again = dataclasses.replace(options, out=folder / "again", measured=folder / "arms" / "store.sqlite")
    kept = surveyed(again)
    assert kept["refused"].keys() == summary["refused"].keys()
    for name, error in kept["convergence"][-1]["error_um"].items():
        assert error == pytest.approx(last["error_um"][name], abs=0.3)
    seen = observe(field, "with arms", arms=folder / "arms" / "arms.ecsv")
    assert seen["n_within_requirement"] >= N - 2
    with Store.open(folder / "arms" / "store.sqlite") as store:
        assert store.runs()[-1].status == "finished"
        (run,) = store.runs()
        assert run.n_measurements == 10 * N  # the start, eight, and everybody folds
        assert store.calibrated(run.id) == {"focal-plane": N - 2}
        assert set(store.calibrations(run.id)["hash"]) == {digest_of(folder / "arms" / "arms.ecsv")}
    with Store.open(folder / "again" / "store.sqlite") as store:
        assert store.calibrated(1) == {"focal-plane": N - 2}
    with Store.open(folder / "with arms" / "store.sqlite") as store:
        assert store.calibrated(1) == {"focal-plane": N, "transmission": N}


@pytest.mark.slow
def test_ctrl_c_keeps_what_was_learnt(field, tmp_path):
    learnt = tmp_path / "learnt.sqlite"
    words = ["observe", str(field[1] / "targets.csv"), "--positioners", str(N), "--seed", str(SEED)]
    words += ["--moves", "5000", "--adapt", "--learnt", str(learnt), "--out", str(tmp_path / "out")]
    process = start(*words)
    try:
        end = time.monotonic() + 240.0
        while not (learnt.exists() and learnt_generations(str(learnt), None)):
            assert process.poll() is None, process.stderr.read()
            assert time.monotonic() < end
            time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        _, stderr = process.communicate(timeout=150)
    finally:
        process.kill()
        process.wait()
        process.stderr.close()
    assert process.returncode == 130, stderr
    (kept,) = learnt_generations(str(learnt), None)
    assert kept["positioners"] == N
    assert kept["moves_learnt"] >= 1
