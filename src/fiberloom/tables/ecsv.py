"""Plain tables as ECSV (APE 6 of astropy), read and written without astropy, which takes half a second.

Plain are columns of numbers and text, whole arrays in a cell too, and a header of the like: what fiberloom
writes. `read` leaves everything else to astropy; `text_of` writes the same bytes as astropy does.
"""

from __future__ import annotations

import csv
import io
import json
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml

from fiberloom.typing import Array

VERSION, SCHEMA = "1.0", "astropy-2.0"
_FIRST = re.compile(r"%ECSV 1\.\d+(\.\d+)?")
_NUMBERS = frozenset({f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)})
_NUMBERS |= {"float16", "float32", "float64"}
_KNOWN_OF_HEADER = {"datatype", "meta", "schema", "delimiter"}
_KNOWN_OF_COLUMN = {"name", "datatype", "subtype", "unit", "description", "format"}
_SERIALIZED = "__serialized_columns__"
"""Key of columns that are more than their numbers: times, coordinates, masks."""
_OMAP = "tag:yaml.org,2002:omap"
_NOTHING = "\ue000"
"""In place of an empty cell until all are written: between blanks it would not be seen."""
_WIDTH = 130
"""Characters of a line of the header, as astropy breaks them."""


@dataclass(frozen=True)
class PlainTable:
    """Columns of like length, and what the header says beside them."""

    columns: Mapping[str, Array]
    head: Mapping[str, Any]


class _NotPlain(Exception):
    """Astropy must read this, or say what is wrong with it."""


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Reads the header; its ordered mappings are dicts."""


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]  # no types of its own
    """Writes the header; a dict of its first level keeps its order, those within are sorted."""


class _Ordered(dict[str, Any]):
    """Written as an ordered mapping: `!!omap`."""


class _Fixed(dict[str, Any]):
    """Written as a mapping in its own order."""


def _omap(loader: Any, node: Any) -> dict[Any, Any]:
    pairs = [loader.construct_mapping(part, deep=True) for part in node.value]
    if any(len(pair) != 1 for pair in pairs):
        raise _NotPlain
    return {key: value for pair in pairs for key, value in pair.items()}


def _ordered_node(dumper: Any, pairs: _Ordered) -> Any:
    return dumper.represent_sequence(_OMAP, [{key: value} for key, value in pairs.items()])


def _fixed_node(dumper: Any, pairs: _Fixed) -> Any:
    return dumper.represent_mapping("tag:yaml.org,2002:map", pairs.items())


def _tuple_node(dumper: Any, values: tuple[Any, ...]) -> Any:
    return dumper.represent_sequence("tag:yaml.org,2002:python/tuple", values)


def _number_node(dumper: Any, number: np.generic) -> Any:
    return dumper.represent_data(number.item())


_Loader.add_constructor(_OMAP, _omap)
_Dumper.add_representer(_Ordered, _ordered_node)
_Dumper.add_representer(_Fixed, _fixed_node)
_Dumper.add_representer(tuple, _tuple_node)
_Dumper.add_multi_representer(np.generic, _number_node)


def read(content: bytes) -> PlainTable | None:
    """The table in the `content` of a file; None where it is not plain, or not right: astropy knows which."""
    try:
        lines = content.decode().splitlines()
        header, body = _header(lines)
        return PlainTable(_columns(header, body), header.get("meta", {}))
    except Exception:  # a damaged header can hold anything, and astropy says what is wrong with it
        return None


def read_head(content: bytes) -> Mapping[str, Any] | None:
    """What the header says beside the columns; None as of `read`. The rows are not looked at."""
    try:
        return dict(_header(content.decode().splitlines())[0].get("meta", {}))
    except Exception:  # as above
        return None


def _header(lines: Sequence[str]) -> tuple[dict[str, Any], list[str]]:
    """What the lines with # say, and the lines below them."""
    end = next((k for k, line in enumerate(lines) if not line.startswith("#")), len(lines))
    said = [line[1:] for line in lines[:end] if line[1:].strip()]
    if not said or not _FIRST.fullmatch(said[0].strip()):
        raise _NotPlain
    header = yaml.load(textwrap.dedent("\n".join(said[1:])), Loader=_Loader)
    if not isinstance(header, dict) or not set(header) <= _KNOWN_OF_HEADER:
        raise _NotPlain
    meta = header.get("meta", {})
    if header.get("schema") != SCHEMA or not isinstance(meta, dict) or _SERIALIZED in meta:
        raise _NotPlain
    return header, list(lines[end:])


def _columns(header: dict[str, Any], body: Sequence[str]) -> dict[str, Array]:
    told = header["datatype"]
    names = [column["name"] for column in told]
    if (
        not all(isinstance(name, str) for name in names)
        or len(set(names)) < len(names)
        or any(not set(column) <= _KNOWN_OF_COLUMN for column in told)
    ):
        raise _NotPlain
    rows = list(_rows(body, header.get("delimiter", " ")))
    if not rows or rows[0] != names or any(len(row) != len(names) for row in rows):
        raise _NotPlain
    cells = zip(*rows[1:], strict=True) if len(rows) > 1 else ((),) * len(names)
    return {column["name"]: _column(column, found) for column, found in zip(told, cells, strict=True)}


def _rows(body: Sequence[str], delimiter: str) -> Iterator[list[str]]:
    if delimiter not in (" ", ",") or any(line.lstrip().startswith("#") for line in body):
        raise _NotPlain
    lines = (line.strip() for line in body if line.strip())
    for row in csv.reader(lines, delimiter=delimiter, skipinitialspace=True):
        yield [cell.strip(" \t") for cell in row]


def _column(told: Mapping[str, Any], cells: Sequence[str]) -> Array:
    kind, within = told["datatype"], told.get("subtype")
    if within is not None:
        return _arrays(str(within), cells) if kind == "string" else _refuse()
    if kind == "string":
        return np.array(cells, dtype=np.str_)
    # an empty cell is a mask
    return np.array(cells).astype(kind) if kind in _NUMBERS and "" not in cells else _refuse()


def _arrays(within: str, cells: Sequence[str]) -> Array:
    """Cells with whole arrays, e.g. `float64[6,6]`."""
    kind, _, rest = within.partition("[")
    shape = tuple(json.loads(f"[{rest}")) if rest else ()
    if kind not in _NUMBERS or not shape or not all(isinstance(size, int) for size in shape):
        raise _NotPlain
    if any("null" in cell for cell in cells):  # a mask
        raise _NotPlain
    values = np.array([json.loads(cell) for cell in cells], dtype=kind)
    return values.reshape(-1, *shape) if values.shape[1:] == shape or not cells else _refuse()


def _refuse() -> Array:
    raise _NotPlain


def text_of(columns: Mapping[str, Any], head: Mapping[str, Any]) -> str:
    """The text of a file with `columns` of like length, numbers, text or arrays of numbers in each cell, and
    `head` in its header, whose values are what YAML knows.
    """
    arrays = {name: np.asarray(column) for name, column in columns.items()}
    for name, column in arrays.items():
        if column.dtype.kind not in "biufU":
            raise TypeError(f"column {name}: numbers or text are written, not {column.dtype}")
    header: dict[str, Any] = {"datatype": [_told(name, column) for name, column in arrays.items()]}
    if head:
        header["meta"] = _Ordered(head)
    dumped = yaml.dump(header | {"schema": SCHEMA}, Dumper=_Dumper, default_flow_style=None, width=_WIDTH)
    out = io.StringIO()
    out.writelines(f"# {line}\n" for line in (f"%ECSV {VERSION}", "---", *dumped.splitlines()))
    body = io.StringIO()
    rows = csv.writer(body, delimiter=" ", lineterminator="\n")
    rows.writerow(arrays)
    rows.writerows(zip(*map(_written, arrays.values()), strict=True))
    return out.getvalue() + body.getvalue().replace(_NOTHING, '""')


def _told(name: str, column: Array) -> _Fixed:
    kind = "string" if column.dtype.kind == "U" else column.dtype.name
    if column.ndim == 1:
        return _Fixed(name=name, datatype=kind)
    shape = json.dumps(column.shape[1:], separators=(",", ":"))
    return _Fixed(name=name, datatype="string", subtype=f"{kind}{shape}")


def _written(column: Array) -> list[str]:
    if column.ndim > 1:
        return [json.dumps(cell, separators=(",", ":")) for cell in column.tolist()]
    if column.dtype.kind == "U":
        return [text.strip(" \t") or _NOTHING for text in column.tolist()]
    # one by one, as numbers of their own type: those of single precision have fewer digits
    return [str(number) for number in (column if column.dtype.itemsize < 8 else column.tolist())]
