"""The whole loop on the twin: assignment, plan, bus, firmware, physics, camera, corrections."""

import json

import numpy as np
import pytest
from astropy.table import Table

from fiberloom.cli.observe import CameraKind, Correction, ObservationOptions
from fiberloom.cli.observe import observe as run_observe
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.planning import read_plans, verify
from fiberloom.targets import random_targets, write_targets

N = 12
SEED = 4


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    """A small focal plane and targets for it."""
    folder = tmp_path_factory.mktemp("field")
    plane = generate(load_instrument("sdssv"), SEED, n_positioners=N)
    whole = random_targets(generate(load_instrument("sdssv"), SEED), 3000, SEED)
    near = np.flatnonzero(np.hypot(whole.x_mm, whole.y_mm) < 70.0)
    write_targets(whole.select(near), folder / "targets.csv")
    return plane, folder


def observe(field, name, **asked):
    plane, folder = field
    out = folder / name
    asked = {"camera": CameraKind.noise, "moves": 3} | asked
    options = ObservationOptions(
        targets=folder / "targets.csv", out=out, seed=SEED, positioners=len(plane), as_json=True, **asked
    )
    run_observe(options)
    return json.loads((out / "summary.json").read_text()), out


@pytest.fixture(scope="module")
def plain(field):
    return observe(field, "plain", compare_linear=True)


def test_every_fibre_comes_within_the_requirement(plain):
    summary, _ = plain
    assert summary["n_assigned"] == summary["n_valid"] == summary["n_within_requirement"] == N
    assert summary["collisions_verified"] == 0
    blind, _, last, linear = summary["moves"]
    assert [move["move"] for move in summary["moves"]] == [1, 2, 3, 4]
    # blind: the map's interpolation; the linear ratio: the whole non-linearity (tuned, docs/twin.md)
    assert 4.0 < blind["true_rms_um"] < 20.0
    assert linear["true_rms_um"] > 2.0 * blind["true_rms_um"]
    # two images of 0.67 um: 0.53 um if nothing else erred
    assert last["true_rms_um"] < 1.0


def test_the_science_fibre_is_on_its_target_and_the_camera_saw_the_other(plain):
    _, out = plain
    rows = Table.read(out / "fibres.ecsv")
    last = rows[(rows["move"] == 3) & (rows["status"] == "on_target")]
    assert len(last) == N
    miss_mm = np.hypot(last["x_true_mm"] - last["x_target_mm"], last["y_true_mm"] - last["y_target_mm"])
    np.testing.assert_allclose(1e3 * miss_mm, last["error_um"], atol=1e-6)
    # the metrology fibre lies 0.65 to 0.75 mm from the science fibres
    apart = np.hypot(last["x_measured_mm"] - last["x_true_mm"], last["y_measured_mm"] - last["y_true_mm"])
    assert (apart > 0.5).all()


def test_the_ideal_angles_put_the_fibre_on_the_target(field, plain):
    plane, _ = field
    rows = Table.read(plain[1] / "fibres.ecsv")
    for row in rows[(rows["move"] == 1) & (rows["target_id"] != "")]:
        index = [int(plane.index_of(row["positioner_id"]))]
        xy = plane.forward([row["alpha_deg"]], [row["beta_deg"]], str(row["fibre"]), index)[0]
        np.testing.assert_allclose(xy, [row["x_target_mm"], row["y_target_mm"]], atol=1e-6)


def test_what_was_sent_passes_the_verifier_again(field, plain):
    plane, _ = field
    for sent in read_plans(plain[1] / "trajectories.json", plane):
        assert verify(plane, sent).ok


def test_the_same_seed_gives_the_same_bytes(field, plain):
    _, out = observe(field, "again", compare_linear=True)
    first, again = (Table.read(folder / "fibres.ecsv") for folder in (plain[1], out))
    for name in first.colnames:
        assert (np.asarray(first[name]) == np.asarray(again[name])).all() or np.array_equal(
            first[name], again[name], equal_nan=True
        )
    plans = [json.loads((f / "trajectories.json").read_text())["plans"] for f in (plain[1], out)]
    assert plans[0] == plans[1]


def test_the_plain_update_converges_too(field):
    summary, _ = observe(field, "eq25", correction=Correction.plain, moves=4)
    assert summary["moves"][-1]["true_rms_um"] < 1.3  # the camera's 0.67 um, and more by chance


@pytest.mark.parametrize("kind", ["dark", "dead", "lying", "mute"])
def test_a_fault_is_flagged_and_the_rest_goes_on(field, kind):
    summary, out = observe(field, kind, faults=f"{kind}=1")
    flagged = {"dark": "dark", "dead": "dead", "lying": "lying", "mute": "dead"}[kind]
    assert [len(v) for k, v in summary["faults"].items() if k == flagged] == [1]
    others = N - 1 - len(summary["faults"].get("blocked", []))
    assert summary["n_within_requirement"] == summary["n_valid"] >= others - 1
    (faulty,) = summary["faults"][flagged]
    rows = Table.read(out / "fibres.ecsv")
    rows = rows[rows["positioner_id"] == faulty]
    assert rows["status"][-1] == flagged
    if kind == "dark":
        assert np.isnan(np.asarray(rows["x_measured_mm"], dtype=float)).all()


@pytest.mark.slow
def test_with_images_the_loop_ends_as_near_and_shows_what_it_saw(field):
    summary, out = observe(field, "images", camera=CameraKind.image, moves=2)
    assert summary["n_within_requirement"] == summary["n_valid"] == N
    # one image of 0.8 um (photons 0.75, transform 0.27) after a correction: as with the noise camera
    assert summary["moves"][-1]["true_rms_um"] < 1.8
    assert summary["put_in"]["camera"].startswith("photons")
    names = sorted(p.name for p in (out / "exposures").iterdir())
    # after the second move
    assert names == [f"exposure-02-{what}.png" for what in ("distortion", "image", "residuals")]


def test_a_camera_without_images_has_none_to_keep(field):
    with pytest.raises(InputError, match="--save-images"):
        observe(field, "none", save_images=True)


def test_swaps_observe_as_many_of_each_priority_on_shorter_ways(field, plain):
    """The twin is folded at first: ways count from there."""
    summary, out = observe(field, "swap", swap=True, strict=True)
    before, after = (Table.read(folder / "fibres.ecsv") for folder in (plain[1], out))
    targets = {row["target_id"]: row["priority"] for row in Table.read(field[1] / "targets.csv")}
    served = [
        sorted(targets[name] for name in rows[rows["move"] == 1]["target_id"] if name)
        for rows in (before, after)
    ]
    assert served[0] == served[1]
    assert summary["n_within_requirement"] == N
    plans = [read_plans(folder / "trajectories.json", field[0])[0] for folder in (plain[1], out)]
    ways = [
        np.abs(np.array([robot.points_deg[-1] - robot.points_deg[0] for robot in made.robots])).max(axis=1)
        for made in plans
    ]
    assert (ways[1] ** 4).sum() < (ways[0] ** 4).sum()
