import numpy as np
import pytest
from astropy.table import MaskedColumn, Table

from fiberloom.errors import InputError
from fiberloom.tables import read_table


def write(path, text):
    path.write_text(text)
    return path


def first_column(path):
    table = read_table(path)
    table.require("x")
    return table.numbers("x")


def test_csv_with_comments_and_blank_lines(tmp_path):
    table = read_table(write(tmp_path / "a.csv", "# first\n\nx, name\n# second\n1.5, a b \n-2,c\n"))
    assert table.numbers("x").tolist() == [1.5, -2.0]
    assert table.strings("name").tolist() == ["a b", "c"]
    assert list(table.places) == ["line 5", "line 6"]


@pytest.mark.parametrize("suffix", ["csv", "ecsv", "fits"])
def test_same_columns_from_every_kind(tmp_path, suffix):
    path = tmp_path / f"t.{suffix}"
    Table({"x": [1.25, 1e-9], "n": [3, -1], "s": ["BOSS", ""]}).write(path)
    table = read_table(path)
    assert table.numbers("x").tolist() == [1.25, 1e-9]
    assert table.integers("n").tolist() == [3, -1]
    assert table.strings("s").tolist() == ["BOSS", ""]


@pytest.mark.parametrize("suffix", ["csv", "ecsv", "fits"])
@pytest.mark.parametrize("masked", [False, True])
def test_text_is_read_as_numbers_alike_from_every_kind(tmp_path, suffix, masked):
    path = tmp_path / f"t.{suffix}"
    Table({"x": MaskedColumn(["1.5", "1_0", "-2"], mask=[False, False, masked])}).write(path)
    with pytest.raises(InputError, match=r"row 2|line 3") as told:
        read_table(path).numbers("x")
    assert "'1_0' is not a number" in str(told.value)
    assert read_table(path).strings("x").tolist() == ["1.5", "1_0", "" if masked else "-2"]


def test_ecsv_under_the_name_of_csv(tmp_path):
    Table({"x": [1.0]}).write(tmp_path / "t.ecsv")
    (tmp_path / "t.ecsv").rename(tmp_path / "t.csv")
    assert read_table(tmp_path / "t.csv").numbers("x").tolist() == [1.0]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x\n1\nabc\n", ["line 3", "x", "'abc'", "not a number"]),
        ("x\n1\nnan\n", ["line 3", "x", "not finite"]),
        ("x\ninf\n", ["line 2", "x", "not finite"]),
        ("x\n1,2\n", ["line 2", "2 cells", "1 columns"]),
        ("y\n1\n", ["no column x", "the columns are y"]),
        ("x,y,x\n1,2,3\n", ["line 1", "column x appears twice"]),
        ("x\n", ["no rows"]),
        ("", ["empty"]),
        ("# only a comment\n", ["empty"]),
    ],
)
def test_what_is_wrong_and_where(tmp_path, text, words):
    path = write(tmp_path / "bad.csv", text)
    with pytest.raises(InputError) as caught:
        first_column(path)
    message = str(caught.value)
    assert "bad.csv" in message
    assert "\n" not in message
    for word in words:
        assert word in message


@pytest.mark.parametrize("cell", ["1.5", "", "1e400", "x"])
def test_whole_numbers(tmp_path, cell):
    table = read_table(write(tmp_path / "n.csv", f"n,k\n{cell},1\n"))
    with pytest.raises(InputError, match=r"line 2: n = '.*' is not a whole number"):
        table.integers("n")


def test_duplicates_name_both_rows(tmp_path):
    table = read_table(write(tmp_path / "d.csv", "id\na\nb\na\n"))
    with pytest.raises(InputError, match="line 4: id = a was used before, in line 2"):
        table.unique("id")


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("no.csv", None, "no such file"),
        ("t.xlsx", b"x", "unknown kind of table"),
        ("t.csv", b"\xff\xfe\x00x", "not a text file"),
        ("t.fits", b"SIMPLE", "cannot be read as fits"),
        ("t.ecsv", b"# nothing\n", "cannot be read as ascii.ecsv"),
    ],
)
def test_files_that_cannot_be_read(tmp_path, name, content, words):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=words):
        read_table(tmp_path / name)


def test_masked_cells_of_ecsv_are_empty(tmp_path):
    table = Table({"x": np.ma.array([1.0, 2.0], mask=[False, True])})
    table.write(tmp_path / "m.ecsv")
    with pytest.raises(InputError, match="row 2: x = '' is not a number"):
        read_table(tmp_path / "m.ecsv").numbers("x")
