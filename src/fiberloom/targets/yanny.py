"""A reader for the `yanny` parameter files of SDSS (.par): keywords, then rows of structures.

The format (SDSS-III, "FTCL Yanny files"): `#` starts a comment, `typedef struct {...} NAME;` lists
typed columns, a line that starts with NAME is a row of it, any other line is `keyword value`. Text
with blanks is in double quotes, arrays are in braces, a backslash at the end continues the line.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from fiberloom.errors import InputError
from fiberloom.files import read_text

Cell = str | list[str]

_STRUCT = re.compile(r"typedef\s+struct\s*\{(?P<body>[^}]*)\}\s*(?P<name>\w+)\s*;", re.DOTALL)
_ENUM = re.compile(r"typedef\s+enum\s*\{[^}]*\}\s*\w+\s*;", re.DOTALL)
# from the begin of a word, without going back into it: a word without end takes no time without end
_MEMBER = re.compile(r"\b(?P<type>\w++)\s++(?P<name>\w++)(?P<size>(\s*\[\s*\d*\s*\])*)\s*;")
_TOKEN = re.compile(r'\s*(?:"((?:[^"\\]|\\.)*)"|([{}])|([^\s{}"]+))')


@dataclass
class Yanny:
    """A parsed file. Cells are text; the reader of a column knows its type."""

    path: Path
    keywords: dict[str, str] = field(default_factory=dict)
    structs: dict[str, list[str]] = field(default_factory=dict)
    """Column names by structure (upper case)."""
    rows: dict[str, list[dict[str, Cell]]] = field(default_factory=dict)
    lines: dict[str, list[int]] = field(default_factory=dict)
    """Line number of each row."""


def read_yanny(path: str | Path) -> Yanny:
    """Read a .par or .par.gz file."""
    path = Path(path)
    text = _structs_blanked(out := Yanny(path), _read_text(path))
    for number, line in _logical_lines(text):
        word, _, rest = line.partition(" ")
        if word.upper() in out.structs:
            _add_row(out, word.upper(), rest, number)
        else:
            out.keywords[word] = rest.split(" #")[0].strip().strip('"')
    return out


def _read_text(path: Path) -> str:
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    return read_text(path)


def _structs_blanked(out: Yanny, text: str) -> str:
    """Note the structures, and leave only their line breaks so that line numbers hold."""

    def keep_lines(match: re.Match[str]) -> str:
        return "\n" * match.group().count("\n")

    def note(match: re.Match[str]) -> str:
        name = match["name"].upper()
        out.structs[name] = [m["name"] for m in _MEMBER.finditer(match["body"])]
        out.rows[name], out.lines[name] = [], []
        return keep_lines(match)

    return _STRUCT.sub(note, _ENUM.sub(keep_lines, text))


def _logical_lines(text: str) -> Iterator[tuple[int, str]]:
    """Lines that say something; a continued line is joined and has the number of its start."""
    pending, first = "", 0
    for number, line in enumerate(text.split("\n"), start=1):
        first = first if pending else number
        pending += line.strip().replace("\t", " ")
        if pending.endswith("\\"):
            pending = pending[:-1] + " "
            continue
        if pending and not pending.startswith("#"):
            yield first, pending
        pending = ""


def _add_row(out: Yanny, name: str, text: str, number: int) -> None:
    columns = out.structs[name]
    try:
        cells = _cells(text)
    except ValueError as error:
        raise InputError(f"{out.path}, line {number}: {error}") from None
    if len(cells) != len(columns):
        raise InputError(
            f"{out.path}, line {number}: {len(cells)} values, structure {name} has {len(columns)}"
        )
    out.rows[name].append(dict(zip(columns, cells, strict=True)))
    out.lines[name].append(number)


def _cells(text: str) -> list[Cell]:
    cells: list[Cell] = []
    array: list[str] | None = None
    end = 0
    text = text.strip()
    while end < len(text):
        match = _TOKEN.match(text, end)
        if match is None:
            raise ValueError('a double quote (") is not closed')
        end = match.end()
        quoted, brace, word = match.groups()
        if brace is None:
            target = cells if array is None else array
            target.append(quoted if quoted is not None else word)
        elif brace == "{" and array is None:
            array = []
        elif brace == "}" and array is not None:
            cells.append(array)
            array = None
        else:
            raise ValueError("braces { } do not match")
    if array is not None:
        raise ValueError("braces { } do not match")
    return cells
