"""ECSV of plain columns as text: a YAML header, then rows of cells.

Numbers, text and arrays of numbers, which is all that calibrations and results hold: the same bytes and the
same values as by astropy, without its import; but for empty lines of text in the header, which its reader
loses.
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import yaml

from fiberloom.typing import Array

_NUMBERS = {"int64": int, "float64": float}
_HEAD = re.compile(r"# %ECSV 1\.0\n# ---\n((?:# .*\n)+)")
_ARRAY = re.compile(r"float64(\[\d+(?:,\d+)*\])")
_NAME = re.compile(r"\w+")
_QUOTED = re.compile(r'^$|[ "\n\r]')
_SCHEMA, _PAGE = "astropy-2.0", 130
_OMAP = "tag:yaml.org,2002:omap"


def read_plain(text: str) -> tuple[dict[str, Array], dict[str, Any]] | None:
    """The columns and the head of ECSV; None where it is not whole, or holds more than plain columns:
    masked cells, quantities, times.
    """
    head = _HEAD.match(text)
    if head is None or "\r" in text or "\n#" in text[head.end() - 1 :]:
        return None
    try:
        header = yaml.load(re.sub("^# ", "", head[1], flags=re.MULTILINE), _Loader)
        return _read(header, text[head.end() :])
    except Exception:  # a broken header raises many kinds; astropy says what is wrong
        return None


def _read(header: dict[str, Any], rows: str) -> tuple[dict[str, Array], dict[str, Any]]:
    kinds = {column["name"]: column for column in header["datatype"]}
    head = dict(header.get("meta", {}))
    names, *cells = csv.reader(io.StringIO(rows, newline=""), delimiter=" ", skipinitialspace=True)
    _require(names == list(kinds) and len(kinds) == len(header["datatype"]))
    _require("delimiter" not in header and "__serialized_columns__" not in head)
    turned: Iterable[Sequence[str]] = zip(*cells, strict=True) if cells else [()] * len(names)
    named = zip(kinds.items(), turned, strict=True)
    return {name: _column(kind, list(column)) for (name, kind), column in named}, head


def _column(kind: Mapping[str, Any], cells: list[str]) -> Array:
    if "subtype" in kind:
        return _arrays(_ARRAY.fullmatch(kind["subtype"]), cells)
    if kind["datatype"] in _NUMBERS:
        return np.array(list(map(_NUMBERS[kind["datatype"]], cells)), dtype=kind["datatype"])
    text = np.array(cells, dtype=np.str_)
    _require(kind["datatype"] == "string" and _is_trimmed(text))
    return text


def _arrays(kind: re.Match[str] | None, cells: list[str]) -> Array:
    _require(kind is not None and not any("null" in cell for cell in cells))
    array = np.array([json.loads(cell) for cell in cells], dtype=np.float64)
    shape = (len(cells), *json.loads(kind[1])) if kind else ()
    _require(not cells or array.shape == shape)
    return array.reshape(shape)


def _require(plain: bool) -> None:
    """Else it is left to astropy."""
    if not plain:
        raise ValueError


def write_plain(columns: Mapping[str, Any], head: Mapping[str, Any]) -> str | None:
    """ECSV of columns (n, ...) of like length, with `head` in its header; None where they are not plain."""
    arrays = _plain_arrays(columns)
    if not arrays:
        return None
    header: dict[str, Any] = {
        "datatype": [_Kind(_kind(*named)) for named in arrays.items()],
        "schema": _SCHEMA,
    }
    if head:
        header["meta"] = OrderedDict(head)
    try:
        lines = yaml.dump(header, Dumper=_Dumper, default_flow_style=None, width=_PAGE).splitlines()
    except yaml.representer.RepresenterError:
        return None
    rows = list(map(" ".join, zip(*map(_texts, arrays.values()), strict=True)))
    if any(row.startswith("#") for row in rows):
        return None
    return "\n".join([*(f"# {line}" for line in ("%ECSV 1.0", "---", *lines)), " ".join(arrays), *rows, ""])


def _plain_arrays(columns: Mapping[str, Any]) -> dict[str, Array]:
    """Empty, where one is not of a kind that is written here."""
    arrays: dict[str, Array] = {}
    for name, column in columns.items():
        array = _array(column)
        if array is None or not _is_plain(array) or not _NAME.fullmatch(name):
            return {}
        arrays[name] = array
    return arrays


def _array(column: Any) -> Array | None:
    if type(column) not in (np.ndarray, list):  # astropy's columns and numpy's masked arrays hold more
        return None
    try:
        return np.asarray(column)
    except ValueError:  # rows of unlike length
        return None


def _is_plain(array: Array) -> bool:
    if array.ndim != 1:
        return array.ndim > 1 and array.dtype.name == "float64"
    if array.dtype.kind == "U":
        return _is_trimmed(array)
    return array.dtype.name in _NUMBERS


def _is_trimmed(text: Array) -> bool:
    """Whether no cell has blanks around it, which astropy takes away."""
    return bool((np.char.strip(text) == text).all())


def _kind(name: str, column: Array) -> dict[str, str]:
    if column.ndim == 1:
        return {"name": name, "datatype": "string" if column.dtype.kind == "U" else column.dtype.name}
    shape = json.dumps(column.shape[1:], separators=(",", ":"))
    return {"name": name, "datatype": "string", "subtype": f"float64{shape}"}


def _texts(column: Array) -> Iterable[str]:
    cells = column.tolist()
    if column.ndim > 1:
        return (json.dumps(cell, separators=(",", ":")) for cell in cells)
    return map(_quoted, cells) if column.dtype.kind == "U" else map(repr, cells)


def _quoted(cell: str) -> str:
    return '"' + cell.replace('"', '""') + '"' if _QUOTED.search(cell) else cell


class _Kind(dict[str, str]):
    """What a header says of a column; its keys are written in their order."""


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]
    """Of headers as astropy writes them."""

    def _ordered(self, pairs: OrderedDict[str, Any]) -> yaml.Node:
        return self.represent_sequence(_OMAP, [{key: value} for key, value in pairs.items()])

    def _kind(self, kind: _Kind) -> yaml.Node:
        return self.represent_mapping("tag:yaml.org,2002:map", list(kind.items()))


_Dumper.add_representer(OrderedDict, _Dumper._ordered)
_Dumper.add_representer(_Kind, _Dumper._kind)
_Dumper.add_representer(tuple, yaml.representer.SafeRepresenter.represent_undefined)


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Of headers; the one in C where there is one."""

    def _ordered(self, node: yaml.SequenceNode) -> dict[str, Any]:
        items = (self.construct_mapping(item, deep=True) for item in node.value)
        return {key: value for item in items for key, value in item.items()}


_Loader.add_constructor(_OMAP, _Loader._ordered)
