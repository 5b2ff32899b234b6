"""Tables as text: what is wrong with a line is told with its number."""

import numpy as np
import pytest
from astropy.table import Table

from fiberloom.errors import InputError
from fiberloom.tables import read_table, write_ecsv


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "the file is empty"),
        ("# only a comment\n\n", "the file is empty"),
        ('x,y\n"1\n2",3\n', "a quoted cell runs over several lines"),
        ("# c\nx,y,x\n1,2,3\n", "line 2: column x appears twice"),
        ("x,y\n1,2\n\n1,2,3\n", "line 4: 3 cells, the header has 2 columns"),
    ],
)
def test_a_text_that_is_no_table(tmp_path, text, words):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(InputError) as refused:
        read_table(path)
    assert str(refused.value).endswith(words)


def test_a_table_without_rows_and_columns_that_are_missing(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("x,y\n")
    table = read_table(path)
    assert len(table) == 0
    with pytest.raises(InputError, match="no rows below the header"):
        table.require("x")
    with pytest.raises(InputError, match="no column z; the columns are x, y"):
        table.require("x", "z")


@pytest.mark.parametrize("name", ["a.txt", "a", "a.txt.gz"])
def test_another_suffix_is_refused_with_those_that_are_known(tmp_path, name):
    with pytest.raises(InputError, match=r"unknown kind of table .*; known are \.csv \.csv\.gz \.ecsv"):
        read_table(tmp_path / name)


def test_rows_written_as_ecsv_come_back_with_their_head(tmp_path):
    path = tmp_path / "a.ecsv"
    write_ecsv(path, [{"x_mm": 1.5, "n": 2}, {"x_mm": None, "n": 3}], {"seed": 4})
    table = Table.read(path)
    assert table.meta["seed"] == 4
    np.testing.assert_array_equal(table["x_mm"], [1.5, np.nan])
    with pytest.raises(InputError, match=r"row 2: x_mm = nan is not finite"):
        read_table(path).numbers("x_mm")
    write_ecsv(path, [], {"seed": 5})
    assert len(Table.read(path)) == 0
