"""Files that were damaged are read or refused in one line; and what once was neither."""

import gzip
import json
import sqlite3
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import valid_files
from readers import READERS, fuzz
from valid_files import IDS, PLANE

import fiberloom as fl
from fiberloom.calibration.focal_plane.arms_file import load_arms
from fiberloom.errors import InputError
from fiberloom.files import parse_toml
from fiberloom.instruments import load_instrument, read_layout, write_layout
from fiberloom.metrology import read_spots
from fiberloom.planning import Plan, read_configuration, read_plans, verify
from fiberloom.planning.trajectories import Trajectory
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.store.learnt import LearntHistory
from fiberloom.tables import read_table
from fiberloom.targets import read_targets

EACH = 12
KEPT = {
    "targets.fits": (1, 6, 20),
    "targets.csv": (10, 35, 64),
    "targets.par": (105, 214, 3019),
    "site.toml": (555,),
    "spots.csv": (32, 46, 49),
}
"""Numbers of mutated files that went wrong once."""


@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_is_read_or_refused_in_one_line(name, tmp_path):
    for numbers in (range(EACH), *(range(n, n + 1) for n in KEPT.get(name, ()))):
        assert set(fuzz(name, numbers, tmp_path)) <= {"read", "refused"}


def refusal(call, path, *words):
    """The complaint, which is one line that names the file."""
    with pytest.raises(InputError) as refused:
        call(path)
    text = str(refused.value)
    assert "\n" not in text
    assert len(text) < 800
    assert str(path) in text
    for word in words:
        assert word in text
    return text


# files without end


def test_a_header_with_endless_axes_is_refused_at_once(tmp_path):
    path = tmp_path / "a.fits"
    valid_files.image(path)
    content = path.read_bytes()
    card = b"NAXIS   =                    2"
    assert card in content
    path.write_bytes(content.replace(card, b"NAXIS   =             99999999"))
    refusal(fl.centroid, path, "NAXIS = 99999999")
    table = tmp_path / "t.fits"
    valid_files.targets_table(table)
    start, _, rest = table.read_bytes().partition(b"XTENSION")
    table.write_bytes(start + b"XTENSION" + rest.replace(card, b"NAXIS   =             99999999"))
    refusal(read_targets, table, "NAXIS = 99999999")


@pytest.mark.parametrize("name", ["a.par.gz", "a.fits.gz"])
def test_a_small_file_that_is_large_unpacked_is_refused(tmp_path, name):
    path = tmp_path / name
    with gzip.open(path, "wb", compresslevel=1) as file:
        for _ in range(300):
            file.write(bytes(1 << 20))
    assert path.stat().st_size < 2_000_000
    refusal(read_targets, path, "is larger than 256 MB when it is unpacked")


def test_an_archive_that_is_large_unpacked_is_refused(tmp_path):
    path = tmp_path / "maps.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        file.writestr("wire_deg.npy", bytes(300 << 20))
    refusal(fl.TransmissionMaps.read, path, "is larger than 256 MB when it is unpacked")


def test_more_positioners_than_there_are_memory_for_are_refused():
    with pytest.raises(InputError, match="n_positioners = 100000: must be at most 20000"):
        fl.FocalPlane.of("sdssv", n=100_000)


def test_an_instrument_of_endless_holes_is_refused(tmp_path):
    path = tmp_path / "i.toml"
    valid_files.instrument(path)
    path.write_text(path.read_text().replace("rings = 13", "rings = 100000"))
    refusal(load_instrument, path, "layout.rings = 100000", "less than or equal to 120")


@pytest.mark.parametrize("angle", [1e7, -1e9, 1e300])
def test_angles_without_end_are_refused_at_once(tmp_path, angle):
    path = tmp_path / "t.json"
    valid_files.trajectories(path)
    document = json.loads(path.read_text())
    document["robots"][2]["alpha_deg"][-1] = angle
    path.write_text(json.dumps(document))
    refusal(read_plans, path, f"'alpha_deg' holds {angle:g} deg", "at most 3600 deg")
    moved = [Trajectory(int(p), np.array([0.0]), np.array([angle]), np.array([180.0])) for p in IDS]
    with pytest.raises(InputError, match=r"goes to .* deg; at most 3600 deg is sound"):
        verify(PLANE, Plan("sdssv", 2.0, tuple(moved)))


def test_arms_wider_than_the_pitch_are_refused_at_once(tmp_path):
    path = tmp_path / "t.json"
    valid_files.trajectories(path)
    document = json.loads(path.read_text()) | {"collision_buffer_mm": 12.0}
    path.write_text(json.dumps(document))
    words = r"collision_buffer_mm = 12: the arms are 24 mm wide, the positioners 22.4\d* mm apart"
    with pytest.raises(InputError, match=words):
        verify(PLANE, read_plans(path)[0])
    # one that is narrower is proven, whatever comes out
    verify(PLANE, Plan.from_dict(document | {"collision_buffer_mm": 11.0}))


# tracebacks


@pytest.mark.parametrize(
    ("name", "call"), [("targets.par.gz", read_targets), ("maps.npz", fl.TransmissionMaps.read)]
)
def test_packed_data_that_is_damaged_is_one_line(tmp_path, name, call):
    path = tmp_path / name
    valid_files.WRITERS[name](path)
    content = bytearray(path.read_bytes())
    middle = len(content) // 3
    content[middle : middle + 30] = b"\xff" * 30
    path.write_bytes(content)
    refusal(call, path)


def packed_maps(path, **change):
    valid_files.maps(path)
    with np.load(path) as file:
        parts = {name: file[name] for name in file.files}
    np.savez(path, **parts | change)
    return path


def meta(**change):
    known = {"format": "fiberloom transmission maps", "format_version": 1, "gear": 1024.0, "seed": 0}
    return np.array(json.dumps(known | change))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"meta": np.array("[" * 5000)}, "nested too deeply"),
        ({"meta": np.array("[1]")}, "not a file of transmission maps"),
        ({"meta": meta(gear=None)}, "gear = None: must be a ratio above 0"),
        ({"meta": meta(gear=True)}, "gear = True"),
        ({"meta": meta(gear=-4)}, "gear = -4"),
        ({"meta": meta(gear=float("inf"))}, "gear = inf"),
        ({"meta": meta(seed="a")}, "seed = 'a'"),
        ({"meta": meta(note=3)}, "note = 3: must be a text"),
        ({"meta": meta(format_version="9" * 3000)}, "of format '999"),
        ({"wire_deg": np.array(3.0)}, "shape ()"),
        ({"wire_deg": np.array([["a"]])}, "wire_deg: numbers of the type <U1"),
        ({"output_deg": np.zeros((7, 2, 2, 20), complex)}, "complex"),
        ({"positioner_id": np.zeros((7, 1), int)}, "positioner_id: 2 dimensions"),
        ({"positioner_id": np.full(7, 5)}, "a positioner appears twice"),
    ],
)
def test_maps_of_another_kind_are_one_line(tmp_path, change, words):
    refusal(fl.TransmissionMaps.read, packed_maps(tmp_path / "m.npz", **change), words)


@pytest.mark.parametrize("value", [np.inf, -np.inf, 1e200])
def test_knots_that_are_no_angles_are_refused(tmp_path, value):
    knots = np.broadcast_to(np.linspace(0.0, 360.0, 20), (7, 2, 2, 20)).copy()
    knots[3, 1, 0, -1 if not value < 0 else 0] = value
    path = packed_maps(tmp_path / "m.npz", wire_deg=knots)
    refusal(fl.TransmissionMaps.read, path, f"positioner {IDS[3]}, beta, negative contact", f"{value:g} deg")


def test_a_cell_without_end_is_one_line(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("# a comment\ntarget_id,x_mm,y_mm\na,1,2\n" + "b" * 140_000 + ",1,2\n")
    refusal(read_targets, path, "line 4: not CSV (field larger than field limit (131072))")
    path.write_text("target_id,x_mm,y_mm\na," + "7" * 100_000 + "x,2\n")
    refusal(read_targets, path, "line 2: x_mm = '777")


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("positioner_id", 10**400, "is no number of a positioner"),
        ("positioner_id", -3, "positioner_id = -3 is no number"),
        ("positioner_id", "3", "'positioner_id' has the wrong type (str)"),
        ("time_s", ["0"], "'time_s' must be a list of numbers"),
        ("time_s", [True], "'time_s' must be a list of numbers"),
        ("time_s", [10**400], "'time_s' must be a list of numbers"),
        ("time_s", [1e30], "'time_s' holds 1e+30 s; at most 100000 s is sound"),
        ("beta_deg", [[[1.0]]], "'beta_deg' must be a flat list"),
        ("beta_deg", [{}], "'beta_deg' must be a list of numbers"),
    ],
)
def test_trajectories_with_the_wrong_values_are_one_line(tmp_path, key, value, words):
    path = tmp_path / "t.json"
    valid_files.trajectories(path)
    document = json.loads(path.read_text())
    document["robots"][0] |= {key: value}
    path.write_text(json.dumps(document))
    refusal(read_plans, path, words)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"collision_buffer_mm": 10**400}, "collision_buffer_mm = 1000"),
        ({"not_arrived": [1]}, "'not_arrived' has the wrong type (list)"),
        ({"not_arrived": {"three": "why"}}, "'not_arrived' names 'three'"),
        ({"not_arrived": {"٣": "why"}}, "which is no positioner"),
    ],
)
def test_a_plan_with_the_wrong_values_is_one_line(tmp_path, change, words):
    path = tmp_path / "t.json"
    valid_files.trajectories(path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    refusal(read_plans, path, words)


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"a":' * 100_000, "9" * 6000, '{"robots": ' + "9" * 6000 + "}"]
)
def test_json_without_end_is_one_line(tmp_path, text):
    path = tmp_path / "t.json"
    path.write_text(text)
    refusal(read_plans, path, "not JSON")


@pytest.mark.parametrize(
    "text", ["a = " + "[" * 50_000, "a = " + "9" * 6000, "a." * 3000 + "b = 1", "a = 0x" + "f" * 6000]
)
def test_toml_without_end_is_one_line(tmp_path, text):
    path = tmp_path / "i.toml"
    path.write_text(text + "\n")
    refusal(load_instrument, path)
    if "0x" not in text and "a.a" not in text:
        with pytest.raises(InputError, match="here: not valid TOML"):
            parse_toml(text, "here")


# silent wrong results


@pytest.mark.parametrize("cell", ["1_0.0", "١٠", "１０", "0x10", "1e999", "nan"])
def test_only_plain_digits_are_numbers(tmp_path, cell):
    path = tmp_path / "t.csv"
    path.write_text(f"target_id,x_mm,y_mm\na,{cell},2\n")
    refusal(read_targets, path, f"line 2: x_mm = {'' if cell in ('1e999', 'nan') else chr(39)}")
    path.write_text(f"positioner_id,alpha_deg,beta_deg\n{cell},1,2\n")
    refusal(lambda p: read_configuration(p, PLANE), path, "line 2: positioner_id =")


def test_a_positioner_in_two_ways_of_writing_is_one(tmp_path):
    path = tmp_path / "c.csv"
    valid_files.configuration(path)
    path.write_text(path.read_text() + f"{IDS[2]}.0,1,2\n")
    refusal(
        lambda p: read_configuration(p, PLANE),
        path,
        f"line 9: positioner_id = {IDS[2]} was used before, in line 4",
    )
    write_layout(PLANE, tmp_path / "l")
    table = tmp_path / "l" / "positioners.ecsv"
    table.write_text("\n".join(line for line in table.read_text().splitlines() if "rows_sum" not in line))
    lines = table.read_text().replace(
        "name: positioner_id, datatype: int64", "name: positioner_id, datatype: string"
    )
    first, second = lines.splitlines()[-2:]
    table.write_text(lines.replace(second.split(" ")[0] + " ", first.split(" ")[0] + ".0 ", 1))
    with pytest.raises(InputError):
        read_layout(tmp_path / "l", PLANE.instrument)


@pytest.mark.parametrize(
    ("name", "value"), [("flags", -1), ("flags", 128), ("x_err_px", 1e200), ("y_err_px", -1)]
)
def test_spots_that_nothing_measured_are_refused(tmp_path, name, value):
    path = tmp_path / "s.csv"
    row = {"x_px": 1, "y_px": 2, "x_err_px": 0.1, "y_err_px": 0.1, "flags": 4} | {name: value}
    path.write_text(",".join(row) + "\n" + ",".join(map(str, row.values())) + "\n")
    refusal(
        read_spots, path, f"line 2: {name} = {value:g}" if name != "flags" else f"line 2: flags = {value}"
    )


def without_sum(path):
    """As a person changes it: the sum is taken out."""
    path.write_text(
        "\n".join(line for line in path.read_text().splitlines() if "rows_sum" not in line) + "\n"
    )


@pytest.mark.parametrize("value", ["1e200", "nan", "-inf"])
def test_a_covariance_beyond_sense_is_refused(tmp_path, value):
    path = tmp_path / "arms.ecsv"
    valid_files.arms(path)
    without_sum(path)
    load_arms(path, PLANE)
    content = path.read_text()
    assert "[[1e-06" in content or "1e-06" in content
    path.write_text(content.replace("1e-06", {"nan": "NaN", "-inf": "-Infinity"}.get(value, value), 1))
    refusal(lambda p: load_arms(p, PLANE), path)


@pytest.mark.parametrize("share", [0.6, 0.8, 0.95, 0.99])
def test_a_result_that_was_cut_short_is_not_read_as_a_shorter_one(tmp_path, share):
    path = tmp_path / "fibres.ecsv"
    valid_files.fibres(path)
    assert len(read_table(path)) == len(IDS)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    refusal(read_table, path)
    lines = content.decode().splitlines()
    path.write_text("\n".join(lines[:-2]) + "\n")
    refusal(read_table, path, "was cut short or changed since it was written")
    path.write_text("\r\n".join(lines) + "\r\n")  # as other systems end lines: nothing has changed
    assert len(read_table(path)) == len(IDS)


# the store


@pytest.fixture(scope="module")
def kept_store(tmp_path_factory):
    path = tmp_path_factory.mktemp("store") / "s.sqlite"
    valid_files.store(path)
    return path.read_bytes()


def contents(path):
    """What was measured and where positioners are, as text; and each row of what was learnt and noted."""
    with Store.open(path, create=False) as store:
        measured = {k: v.tolist() for k, v in store.measurements(1).items()}
        places = ArrayBook(store, "bus").places(IDS)
        rows = {repr(item) for item in LearntHistory(store, "cafe").latest().items()}
        for table in (store.moves(1), store.events(1), store.calibrations(1)):
            rows |= {repr(row) for row in zip(*(v.tolist() for v in table.values()), strict=True)}
        return repr((measured, places.angles_deg.tolist())), rows


def after_damage(path, content):
    """The same; None where the store is refused, in one line that names it."""
    for beside in ("-wal", "-shm"):
        path.with_name(path.name + beside).unlink(missing_ok=True)
    path.write_bytes(content)
    try:
        return contents(path)
    except InputError as error:
        return None if str(path) in str(error) else str(error)


def test_no_flipped_bit_changes_what_was_measured(tmp_path, kept_store):
    path = tmp_path / "s.sqlite"
    whole, rows = after_damage(path, kept_store)
    rng, found = np.random.default_rng(5), 0
    for _ in range(250):
        damaged = bytearray(kept_store)
        damaged[rng.integers(len(damaged))] ^= 1 << int(rng.integers(8))
        now = after_damage(path, damaged)
        found += now is None
        if now is not None:
            assert now[0] == whole
            # an index that is damaged may hide one of these, but none has changed
            assert now[1] <= rows
    assert found > 25


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            "UPDATE measurements SET x_mm = x_mm + 1e-9 WHERE id = 7",
            "row 7 of the table measurements is not what",
        ),
        ("UPDATE measurements SET seen = 0 WHERE id = 9", "row 9 of the table measurements"),
        ("UPDATE measurements SET x_mm = 'far' WHERE id = 9", "is damaged"),
        ("DELETE FROM measurements WHERE id = 9", "move 1 has 58 measurements of 59"),
        (
            "PRAGMA foreign_keys=OFF; DELETE FROM moves WHERE id = 2",
            "move 2 is gone, its measurements are there",
        ),
        ("UPDATE moves SET number = 3 WHERE id = 2", "row 2 of the table moves"),
        ("UPDATE runs SET utc_start = 'yesterday'", "is damaged"),
        ("UPDATE moves SET utc = x'ff00'", "is damaged"),
        ("UPDATE moves SET kind = CAST(x'ff80' AS TEXT)", "store"),
    ],
)
def test_a_row_that_changed_by_itself_is_told(tmp_path, kept_store, change, words):
    path = tmp_path / "s.sqlite"
    path.write_bytes(kept_store)
    with sqlite3.connect(path) as raw:
        raw.executescript(change)
    raw.close()

    def everything(at):
        with Store.open(at, create=False) as store:
            return store.runs(), store.measurements(1)

    refusal(everything, path, words)


def test_a_store_of_the_third_version_is_refused_and_left_as_it_was(tmp_path, kept_store):
    path = tmp_path / "s.sqlite"
    path.write_bytes(kept_store)
    with sqlite3.connect(path) as raw:
        raw.execute("UPDATE fiberloom_schema SET version = 3")
    raw.close()
    before = path.read_bytes()
    with pytest.raises(InputError, match=r"of version 3, .*fiberloom store upgrade"):
        contents(path)
    assert path.read_bytes() == before


# the command line


def test_a_plan_that_the_verifier_refuses_is_one_line():
    code = (
        "import sys; from fiberloom.cli import app\n"
        "from fiberloom.operation.motion import UnsafePlanError\n"
        "def refuse(**_): raise UnsafePlanError('the verifier refused the planned motion: all')\n"
        "app.app_of = lambda words: refuse; app.main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "fiberloom: the verifier refused the planned motion: all\n"


def test_every_reader_has_its_valid_file():
    assert set(READERS) == set(valid_files.WRITERS)
    assert all(Path(name).suffix for name in READERS)
