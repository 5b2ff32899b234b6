"""Target lists from files."""

import gzip

import numpy as np
import pytest
from astropy.table import Table

from fiberloom.errors import InputError
from fiberloom.targets import random_targets, read_targets, write_targets

HEADER = "target_id,x_mm,y_mm,priority,fibre,positioner_id\n"


def write(path, text):
    path.write_text(text)
    return path


def same(a, b):
    for name in ("target_id", "x_mm", "y_mm", "priority", "fibre", "positioner_id"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


@pytest.fixture
def targets(patch):
    return random_targets(patch, 50, seed=3)


@pytest.mark.parametrize("suffix", ["csv", "ecsv", "fits"])
def test_there_and_back(tmp_path, targets, suffix):
    path = tmp_path / f"t.{suffix}"
    if suffix == "csv":
        write_targets(targets, path, ("made by a test",))
    else:
        names = ("target_id", "x_mm", "y_mm", "priority", "fibre", "positioner_id")
        Table({n: getattr(targets, n) for n in names}).write(path)
    same(read_targets(path), targets)


def test_optional_columns(tmp_path):
    found = read_targets(write(tmp_path / "t.csv", "target_id,y_mm,x_mm\na,2,1\nb,4,3\n"))
    np.testing.assert_array_equal(found.xy_mm, [[1, 2], [3, 4]])
    assert found.priority.tolist() == [0, 0]
    assert found.fibre.tolist() == ["", ""]
    assert found.positioner_id.tolist() == [-1, -1]


def test_empty_positioner_is_free(tmp_path):
    found = read_targets(write(tmp_path / "t.csv", HEADER + "a,1,2,3,,\nb,1,2,3,BOSS,17\n"))
    assert found.positioner_id.tolist() == [-1, 17]
    assert found.fibre.tolist() == ["", "BOSS"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("target_id,x_mm\na,1\n", ["no column y_mm", "the columns are target_id, x_mm"]),
        ("target_id,ra,dec\na,1,2\n", ["has RA and Dec; give the field with --field"]),
        ("target_id,x_mm,y_mm\na,1,2\na,3,4\n", ["line 3: target_id = a was used before"]),
        ("target_id,x_mm,y_mm\n,1,2\n", ["line 2: target_id is empty"]),
        ("target_id,x_mm,y_mm\na,nan,2\n", ["line 2: x_mm = nan is not finite"]),
        ("target_id,x_mm,y_mm\na,1,inf\n", ["line 2: y_mm = inf is not finite"]),
        ("target_id,x_mm,y_mm\na,1,z\n", ["line 2: y_mm = 'z' is not a number"]),
        ("target_id,x_mm,y_mm\n", ["no rows"]),
        (HEADER + "a,1,2,3,,5\nb,1,2,3,,5\n", ["line 3: positioner_id = 5", "line 2 too"]),
        (HEADER + "a,1,2,3,,-7\n", ["line 2: positioner_id = -7: -1 means any"]),
        (HEADER + "a,1,2,,,\n", ["line 2: priority = '' is not a number"]),
    ],
)
def test_what_is_wrong_and_where(tmp_path, text, words):
    with pytest.raises(InputError) as caught:
        read_targets(write(tmp_path / "bad.csv", text))
    message = str(caught.value)
    assert "\n" not in message
    for word in ["bad.csv", *words]:
        assert word in message


def test_missing_files(tmp_path):
    for name in ("none.csv", "none.par", "none.par.gz"):
        with pytest.raises(InputError, match="no such file"):
            read_targets(tmp_path / name)
    with pytest.raises(InputError, match="unknown kind of table"):
        read_targets(tmp_path / "t.xls")


def test_random_targets_are_uniform_and_reproducible(plane):
    found = random_targets(plane, 4000, seed=1)
    same(found, random_targets(plane, 4000, seed=1))
    assert not np.array_equal(found.x_mm, random_targets(plane, 4000, seed=2).x_mm)
    reach = np.linalg.norm(found.xy_mm[:, None] - plane.centres_mm, axis=2).min(axis=1)
    assert reach.max() < 22.4
    # within 200 mm every place is in reach: the inner quarter of that disc holds a quarter of it
    r = np.hypot(found.x_mm, found.y_mm)
    inner, all_of_it = np.count_nonzero(r < 100), np.count_nonzero(r < 200)
    # three standard deviations of a binomial of 1700 are 0.032
    assert inner / all_of_it == pytest.approx(0.25, abs=0.032)
    assert set(found.priority) == {1, 2, 3, 4, 5}
    assert np.mean(found.fibre == "") == pytest.approx(0.7, abs=0.03)


PAR = """#%yanny
# a comment
observatory APO
note "in quotes"   # and a comment

typedef enum {
    BOSS,
    APOGEE
} FIBERTYPE;
typedef struct {
    short positionerId;
    FIBERTYPE fiberType;
    short assigned;
    short valid;
    double xwok;
    double ywok;
    float mag[3];
    char name[40];
    long catalogid;
} FIBERMAP;

FIBERMAP 3 BOSS 1 1 1.5 -2.5 {1.0 nan 3} "two words" 900
FIBERMAP 3 APOGEE 0 1 9 9 {1 2 3} "" -999
fibermap 4 APOGEE 1 1 7.25 8 {1 2 3} \\
   one -999
FIBERMAP 5 BOSS 1 0 -999 -999 {1 2 3} {} -999
FIBERMAP 6 BOSS 1 1 5 6 { 1 2 3 } x -999
"""


def test_confsummary(tmp_path):
    found = read_targets(write(tmp_path / "c.par", PAR))
    assert found.positioner_id.tolist() == [3, 4, 6]
    assert found.fibre.tolist() == ["BOSS", "APOGEE", "BOSS"]
    np.testing.assert_array_equal(found.xy_mm, [[1.5, -2.5], [7.25, 8.0], [5.0, 6.0]])
    # places on the sky share a catalogue number: they are told apart by their positioner
    assert found.target_id.tolist() == ["900", "-999-P4", "-999-P6"]
    (tmp_path / "c.par.gz").write_bytes(gzip.compress(PAR.encode()))
    same(read_targets(tmp_path / "c.par.gz"), found)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"two words"', '"two words', "line 22: a double quote"),
        ("{1.0 nan 3}", "{1.0 nan 3", "line 22: braces"),
        ("1.5 -2.5", "1.5", "line 22: 8 values, structure FIBERMAP has 9"),
        ("1.5 -2.5", "1.5 y", "line 22: ywok = 'y' is not a number"),
        ("1.5 -2.5", "1.5 nan", "line 22: ywok = nan is not finite"),
        ("FIBERMAP 6", "FIBERMAP 3", "positionerId = 3 was used before, in line 22"),
        ("    double ywok;\n", "", "structure FIBERMAP has 8"),
        ("} FIBERMAP;", "} OTHER;", r"no structure FIBERMAP; .* \(found OTHER\)"),
        ("short valid", "short good", "no column valid"),
    ],
)
def test_broken_confsummary(tmp_path, old, new, words):
    path = write(tmp_path / "c.par", PAR.replace(old, new))
    with pytest.raises(InputError, match=words):
        read_targets(path)


def test_confsummary_without_targets(tmp_path):
    lines = [line for line in PAR.splitlines() if not line.lower().startswith("fibermap")]
    with pytest.raises(InputError, match="no rows"):
        read_targets(write(tmp_path / "c.par", "\n".join(lines[:-1])))
    with pytest.raises(InputError, match="no row with valid = 1"):
        read_targets(write(tmp_path / "c.par", PAR.replace(" 1 1 ", " 1 0 ")))


def test_broken_gzip(tmp_path):
    (tmp_path / "c.par.gz").write_bytes(gzip.compress(PAR.encode())[:60])
    with pytest.raises(InputError, match="cannot be unpacked"):
        read_targets(tmp_path / "c.par.gz")


def test_the_real_field(shared_sdssv):
    found = read_targets(shared_sdssv / "confSummary-test.par.gz")
    # counted with awk: valid and assigned
    assert len(found) == 490
    assert np.count_nonzero(found.fibre == "APOGEE") == 7
    assert np.unique(found.target_id).size == 490
