"""ECSV without astropy: astropy's own bytes and values are the reference."""

import io
import subprocess
import sys

import numpy as np
import pytest
from astropy.table import MaskedColumn, Table
from hypothesis import example, given
from hypothesis import strategies as st

from fiberloom.tables import read_ecsv, write_columns
from fiberloom.tables.plain import read_plain, write_plain

NUMBERS = st.floats(width=64) | st.sampled_from([0.0, -0.0, 1e-320, 1.5e300])
LETTERS = st.characters(codec="utf-8", exclude_categories=["Cc", "Zl", "Zp"]) | st.sampled_from(' \n"\t')
WORDS = st.text(LETTERS, max_size=6)
"""Without what ends a line for one reader and not for another."""
CELLS = [NUMBERS, st.integers(-(2**63), 2**63 - 1), WORDS]
HEADS = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | WORDS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(WORDS, inner, max_size=3),
    max_leaves=6,
)


@st.composite
def tables(draw):
    n = draw(st.integers(0, 4))
    kinds = draw(st.lists(st.sampled_from(CELLS), min_size=1, max_size=4))
    columns = {f"c{k}": draw(st.lists(kind, min_size=n, max_size=n)) for k, kind in enumerate(kinds)}
    if n and draw(st.booleans()):  # astropy cannot read such a column without rows
        columns["arrays"] = np.array(draw(st.lists(NUMBERS, min_size=6 * n, max_size=6 * n))).reshape(n, 2, 3)
    return columns, draw(st.dictionaries(st.from_regex("[a-z_]{1,9}", fullmatch=True), HEADS, max_size=3))


def by_astropy(columns, head):
    text = io.StringIO()
    Table(columns, meta=head).write(text, format="ascii.ecsv")
    return text.getvalue()


def told(column):
    """Cells as a reader of the table sees them: astropy masks empty text."""
    return ["" if cell is np.ma.masked else cell for cell in column] if column.ndim == 1 else column.tolist()


@given(tables())
@example(({"c0": ["", " x"]}, {}))
@example(({"c0": [1]}, {"note": "a\n\nb", "by": {"\n": None}}))
def test_the_bytes_and_the_values_of_astropy(table):
    columns, head = table
    text = by_astropy(columns, head)
    ours = write_plain(columns, head)
    assert ours in (text, None)
    read = read_plain(text)
    if read is None:
        return
    theirs = Table.read(io.BytesIO(text.encode()), format="ascii.ecsv")
    assert list(read[0]) == theirs.colnames
    assert read[1] == head
    assert read[1] == dict(theirs.meta) or "\n# \n" in text  # astropy's reader loses empty lines of text
    for name, column in read[0].items():
        np.testing.assert_array_equal(told(column), told(theirs[name]))
        assert column.dtype.kind == theirs[name].dtype.kind


PLAIN = {
    "positioner_id": [7, 11],
    "x_mm": np.array([0.1, np.nan]),
    "n": np.array([-1, 2**40]),
    "reason": ["", 'it "slips"\nby a turn'],
    "covariance": np.arange(8.0).reshape(2, 2, 2),
}
HEAD = {"utc": "2026-11-28T05:20:25+00:00", "seed": 0, "flags": {"B": 2, "A": [1.5, None]}}


def test_what_calibrations_hold_is_plain():
    text = write_plain(PLAIN, HEAD)
    assert text == by_astropy(PLAIN, HEAD)
    columns, head = read_plain(text)
    assert head == HEAD
    assert list(columns) == list(PLAIN)
    for name, column in PLAIN.items():
        np.testing.assert_array_equal(columns[name], column)


@pytest.mark.parametrize(
    "column",
    [
        MaskedColumn([1, 2], mask=[False, True]),
        np.array([1, 2], dtype=np.float32),
        [True, False],
        [None, 1.0],
        [[1], [1, 2]],
        ["#first", "b"],
    ],
    ids=["masked", "single", "flags", "none", "ragged", "comment"],
)
def test_more_than_plain_columns_go_through_astropy(column, tmp_path):
    """Which reads and writes them as ever: what comes back is what was written."""
    assert write_plain({"c": column}, {}) is None
    if isinstance(column, list) and column[0] == "#first":
        return  # astropy writes a row that it takes for a comment
    write_columns(tmp_path / "t.ecsv", {"c": column}, {"seed": 1})
    table = read_ecsv(tmp_path / "t.ecsv")
    assert len(table) == 2
    assert table.head["seed"] == 1


@pytest.mark.parametrize("value", [np.float64(1.0), (1, 2), 1j], ids=["numpy", "tuple", "complex"])
def test_a_head_of_more_than_yaml_goes_through_astropy(value, tmp_path):
    assert write_plain(PLAIN, {"value": value}) is None
    write_columns(tmp_path / "t.ecsv", PLAIN, {"value": value})
    assert read_ecsv(tmp_path / "t.ecsv").head["value"] == value


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("# %ECSV 1.0", "# %ECSV 2"),
        ("# ---\n", ""),
        ("float64}", "float31}"),
        ("int64", "int64{"),
        ("positioner_id x_mm", "positioner_id y_mm"),
        ("7 0.1", "7.5 0.1"),
        ("7 0.1", "7"),
        ("7 0.1", '7 ""'),
        ("7 0.1 -1", "7  -1"),
        ('-1 ""', "-1 "),
        ("[[0.0,1.0]", "[[null,1.0]"),
        ("[[0.0,1.0]", "[[0.0]"),
        ("# schema", "# delimiter: ','\n# schema"),
        ("\n11 nan", "\n# 11\n11 nan"),
        ("\n11 nan", "\r\n11 nan"),
        ("meta: !!omap", "meta: !astropy.units.Unit"),
        ("meta: !!omap", "meta: !!omap " + 5000 * "["),
        ("meta: !!omap\n", "meta: !!omap text\n# other:\n"),
        ("- {seed: 0}", "- {__serialized_columns__: {}}"),
    ],
)
def test_what_is_not_whole_or_not_plain_is_left_to_astropy(old, new):
    text = write_plain(PLAIN, HEAD)
    assert old in text
    assert read_plain(text.replace(old, new, 1)) is None


def test_plain_tables_load_no_astropy(tmp_path):
    path = tmp_path / "t.ecsv"
    write_columns(path, PLAIN, HEAD)
    code = (
        "import sys; from pathlib import Path; from fiberloom.tables import read_ecsv, write_columns\n"
        "path = Path(sys.argv[1]); table = read_ecsv(path); write_columns(path, table.columns, table.head)\n"
        "print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, check=True)
    assert "fiberloom.tables.plain" in done.stdout.split()
    assert "astropy" not in done.stdout.split()
