"""Plain tables as ECSV: the same bytes as astropy writes, and the same values as it reads."""

import io

import numpy as np
import pytest
from astropy.table import Table
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from fiberloom.tables import ecsv, read_table, write_columns

KINDS = ("int64", "float64", "float32", "uint16", "int32")
WORDS = st.text(st.characters(min_codepoint=32, max_codepoint=0x24F), max_size=8)
NESTED = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**9), 10**9) | st.floats() | WORDS | st.just((1, 2.5)),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from("abcdef"), inner, max_size=4),
    max_leaves=12,
)


@st.composite
def tables(draw):
    rows = draw(st.integers(1, 5))
    columns = {}
    for k in range(draw(st.integers(1, 4))):
        kind = draw(st.sampled_from((*KINDS, "text", "array")))
        if kind == "text":
            columns[f"c{k}_mm"] = np.array(draw(st.lists(WORDS, min_size=rows, max_size=rows)), dtype=np.str_)
        elif kind == "array":
            shape = draw(array_shapes(max_dims=2, max_side=3))
            columns[f"c{k}_mm"] = draw(arrays("float64", (rows, *shape), elements=st.floats()))
        else:
            columns[f"c{k}_mm"] = draw(arrays(kind, rows))
    return columns, draw(st.dictionaries(st.sampled_from("stuvwx"), NESTED, max_size=4))


def text_by_astropy(columns, head):
    out = io.StringIO()
    Table(columns, meta=head).write(out, format="ascii.ecsv")
    return out.getvalue()


@settings(max_examples=150, deadline=None)
@given(tables())
def test_the_same_bytes_and_values_as_astropy(table):
    columns, head = table
    text = ecsv.text_of(columns, head)
    assert text == text_by_astropy(columns, head)
    if (found := ecsv.read(text.encode())) is None:
        return
    theirs = Table.read(text, format="ascii.ecsv")
    assert theirs.colnames == list(found.columns)
    for name, column in found.columns.items():
        expected = theirs[name].filled("") if hasattr(theirs[name], "mask") else theirs[name]
        assert column.dtype.kind == expected.dtype.kind
        np.testing.assert_array_equal(column, np.asarray(expected))
    np.testing.assert_equal(dict(found.head), dict(theirs.meta))


def test_what_fiberloom_writes_is_read_without_astropy(tmp_path):
    path = tmp_path / "t.ecsv"
    covariance = np.arange(8.0).reshape(2, 2, 2)
    columns = {"n": np.array([1, 2]), "x_mm": [0.1, np.nan], "s": ["a b", ""], "c": covariance}
    head = {"seed": 3, "frame": {"b": [1.5, 2], "a": "x"}}
    write_columns(path, columns, head)
    found = ecsv.read(path.read_bytes())
    assert found is not None
    np.testing.assert_array_equal(found.columns["c"], covariance)
    assert found.columns["s"].tolist() == ["a b", ""]
    assert {key: found.head[key] for key in head} == head


def plain(column, cells, more=""):
    head = f"# %ECSV 1.0\n# ---\n# datatype:\n# - {{name: x, {column}}}\n{more}# schema: astropy-2.0\n"
    return f"{head}x\n{cells}\n"


@pytest.mark.parametrize(
    "text",
    [
        plain("datatype: float64", "1.0 2"),
        plain("datatype: float64", '""'),
        plain("datatype: bool", "True"),
        plain("datatype: string, subtype: 'float64[2]'", "[1.0,null]"),
        plain("datatype: int64", "1", "# meta: {__serialized_columns__: {}}\n"),
        plain("datatype: int64", "1", "# meta: !!python/object:os.path {}\n"),
        plain("datatype: int64", "1.5"),
        plain("datatype: int64", "1\n# 2"),
        plain("datatype: int64", "1").replace("1.0", "9.0"),
        plain("datatype: int64", "1").replace("# ---", "# - a: ["),
        "x\n1\n",
    ],
)
def test_the_rest_is_left_to_astropy(text):
    assert ecsv.read(text.encode()) is None


def test_a_plain_one_is_not():
    found = ecsv.read(plain("datatype: int64", "1", "# meta: !!omap\n# - {a: {b: 2}}\n").encode())
    assert found is not None
    assert found.columns["x"].tolist() == [1]
    assert found.head == {"a": {"b": 2}}


def test_a_masked_number_is_an_empty_cell(tmp_path):
    path = tmp_path / "t.ecsv"
    Table({"x": np.ma.masked_array([1.5, 2.5], [False, True]), "n": [1, 2]}).write(path)
    assert list(read_table(path).columns["x"]) == [1.5, ""]


def test_objects_are_not_written():
    with pytest.raises(TypeError, match="column x: numbers or text are written, not object"):
        ecsv.text_of({"x": [1.5, None]}, {})


def test_a_column_without_a_name_is_left_to_astropy():
    assert ecsv.read(plain("datatype: int64", "1").replace("name: x", "n\\ame: x").encode()) is None
