"""Tables that people write: CSV, ECSV, FITS. Every complaint names file, row and column."""

import csv
import hashlib
import io
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fiberloom.errors import InputError, one_line
from fiberloom.files import check_axes, read_bytes, read_text
from fiberloom.tables.plain import read_plain, write_plain
from fiberloom.timing import part
from fiberloom.typing import Array, Floats, Ints
from fiberloom.wholefile import write_whole

SUFFIXES = (".csv", ".csv.gz", ".ecsv", ".fits", ".fit", ".fits.gz")


@dataclass(frozen=True)
class TableFile:
    """A table as read, and where each of its rows came from."""

    path: Path
    columns: Mapping[str, Sequence[Any]]
    places: Sequence[str]
    """For each row, how to find it: `line 12` of a text, `row 3` otherwise."""
    head: Mapping[str, Any] = field(default_factory=dict)
    """What the header says beside the columns; empty of CSV."""

    def __len__(self) -> int:
        return len(self.places)

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def require(self, *names: str) -> None:
        """Raise InputError unless all these columns are there and at least one row is."""
        missing = [n for n in names if n not in self.columns]
        if missing:
            raise InputError(
                f"{self.path}: no column {', '.join(missing)}; the columns are "
                f"{', '.join(self.columns) or 'none'}{self._hint(missing)}"
            )
        if not len(self):
            raise InputError(f"{self.path}: no rows below the header")

    def _hint(self, missing: Sequence[str]) -> str:
        """What may be meant: cells divided by something else, or a quantity in another unit."""
        if len(self.columns) == 1 and any(c in next(iter(self.columns)) for c in " |:"):
            return "; cells must be divided by commas, semicolons or tabs"
        stems = {name.rpartition("_")[0]: name for name in missing if "_" in name}
        for column in self.columns:
            stem = column.rpartition("_")[0]
            wanted = stems.get(stem or column)
            if wanted is not None:
                return f"; '{column}' is not read: give {wanted}, in {wanted.rpartition('_')[2]}"
        return ""

    def select(self, rows: Ints) -> "TableFile":
        """Some rows of it, which keep their places."""
        chosen = rows.tolist()
        columns: dict[str, Any] = {
            name: cells[rows] if isinstance(cells, np.ndarray) else [cells[k] for k in chosen]
            for name, cells in self.columns.items()
        }
        return TableFile(self.path, columns, [self.places[k] for k in chosen], self.head)

    def error(self, row: int, name: str, problem: str) -> InputError:
        """The complaint about one cell."""
        return InputError(f"{self.path}, {self.places[row]}: {name} {problem}")

    def strings(self, name: str) -> NDArray[np.str_]:
        """A column as text without surrounding blanks; masked cells are empty."""
        cells = [_text(value) for value in self.columns[name]]
        return np.array(cells, dtype=np.str_)

    def numbers(self, name: str) -> Floats:
        """A column as finite numbers, in the unit that its name gives (`x_mm`: mm); InputError with
        file, row and column else.
        """
        values = self._convert(name, float, np.float64, "a number")
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise self.error(bad[0], name, f"= {self.columns[name][bad[0]]} is not finite")
        return values

    def integers(self, name: str) -> Ints:
        """A column as whole numbers."""
        return self._convert(name, _whole, np.int64, "a whole number")

    def unique(self, name: str, *, number: bool = False) -> None:
        """Raise InputError where a value of this column appears twice; a `number` (whole) also where it
        is written in two ways: 252 and 252.0.
        """
        first: dict[Any, int] = {}
        values = self.integers(name) if number else self.strings(name)
        for row, value in enumerate(values.tolist()):
            if value in first:
                earlier = self.places[first[value]]
                raise self.error(row, name, f"= {value} was used before, in {earlier}")
            first[value] = row

    def _convert(self, name: str, kind: Callable[[Any], Any], dtype: type, noun: str) -> Array:
        cells = self.columns[name]
        if isinstance(cells, np.ndarray) and cells.dtype.kind in "iuf" and np.can_cast(cells.dtype, dtype):
            return cells.astype(dtype)
        out: Array = np.empty(len(self), dtype=dtype)
        for row, value in enumerate(cells):
            try:
                out[row] = kind(_plain(value))
            except (TypeError, ValueError, OverflowError):
                shown = _text(value)
                raise self.error(row, name, f"= '{shown}' is not {noun}") from None
        return out


@part("files")
def read_table(path: str | Path) -> TableFile:
    """Read a table, by the suffix of its name. In CSV, lines that start with # are comments."""
    path = Path(path)
    suffix = "".join(path.suffixes[-2:]).lower() if path.suffix == ".gz" else path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: unknown kind of table '{suffix}'; known are {' '.join(SUFFIXES)}")
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    if suffix == ".csv.gz" or (suffix == ".csv" and not _is_ecsv(path)):
        return read_csv(path)
    return read_ecsv(path) if suffix in (".csv", ".ecsv") else _read_fits(path)


DELIMITERS = ",;\t"
"""Of CSV files, by preference."""


def read_csv(path: Path) -> TableFile:
    """A CSV file: a header, then rows; # starts a comment line; blank lines do not count.

    Cells are divided by commas, semicolons or tabs: by what the header has most of.
    """
    lines = list(_lines(path))
    if not lines:
        raise InputError(f"{path}: the file is empty")
    rows = _rows(path, lines)
    if len(rows) != len(lines):
        raise InputError(f"{path}: a quoted cell runs over several lines")
    header = [cell.strip() for cell in rows[0]]
    if len(set(header)) < len(header):
        twice = next(name for name in header if header.count(name) > 1)
        raise InputError(f"{path}, line {lines[0][0]}: column {twice} appears twice")
    places = [f"line {number}" for number, _ in lines[1:]]
    for place, row in zip(places, rows[1:], strict=True):
        if len(row) != len(header):
            raise InputError(f"{path}, {place}: {len(row)} cells, the header has {len(header)} columns")
    columns = {name: [row[i] for row in rows[1:]] for i, name in enumerate(header)}
    return TableFile(path, columns, places)


def _rows(path: Path, lines: Sequence[tuple[int, str]]) -> list[list[str]]:
    delimiter = max(DELIMITERS, key=lines[0][1].count)
    reader = csv.reader((line for _, line in lines), delimiter=delimiter)
    try:
        return list(reader)
    except csv.Error as error:
        place = lines[min(reader.line_num, len(lines)) - 1][0]
        raise InputError(f"{path}, line {place}: not CSV ({error})") from None


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if line.strip() and not line.startswith("#"):
            yield number, line


def _is_ecsv(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(16).replace(b" ", b"").startswith(b"#%ECSV")


def read_ecsv(path: Path) -> TableFile:
    """Read an ECSV file, whatever its suffix; masked cells are empty.

    InputError where the file at `path` cannot be read, or is not what was written.
    """
    content = read_bytes(path)
    check_sum(path, content)
    plain = read_plain(content.decode("utf-8", errors="replace"))
    return _by_astropy(path, content, "ascii.ecsv") if plain is None else _table(path, *plain)


def _read_fits(path: Path) -> TableFile:
    content = read_bytes(path)
    check_axes(path, io.BytesIO(content))
    return _by_astropy(path, content, "fits")


def _by_astropy(path: Path, content: bytes, kind: str) -> TableFile:
    from astropy.table import Table  # takes a third of a second: only where it is needed

    try:
        with warnings.catch_warnings(action="ignore"):  # the error says it
            table = Table.read(io.BytesIO(content), format=kind)
    except Exception as error:  # astropy raises many kinds for a broken file
        raise InputError(f"{path}: cannot be read as {kind}: {one_line(error)}") from None
    columns = {name: _cells(table[name]) for name in table.colnames}
    return _table(path, columns, dict(table.meta))


def _table(path: Path, columns: Mapping[str, Any], head: Mapping[str, Any]) -> TableFile:
    n = len(next(iter(columns.values()), ()))
    return TableFile(path, columns, [f"row {i + 1}" for i in range(n)], head)


def _cells(column: Any) -> Any:
    """Of a column of astropy; those that are masked are empty text."""
    if np.ma.is_masked(column):
        return ["" if value is np.ma.masked else value for value in column]
    return np.asarray(column)


def write_ecsv(path: Path, rows: Sequence[Mapping[str, Any]], head: Mapping[str, Any]) -> None:
    """Write rows of like keys as ECSV, with `head` in its header; None becomes NaN."""
    write_columns(path, {key: [_cell(row[key]) for row in rows] for key in rows[0]} if rows else {}, head)


SUM = "rows_sum"
"""Key in the header of an ECSV table: the sum over its rows."""
_NO_SUM = "sha256-" + 16 * "0"


@part("files")
def write_columns(path: Path, columns: Mapping[str, Any], head: Mapping[str, Any]) -> None:
    """Write columns of like length as ECSV, with `head` in its header; empty ones are columns of text.

    The sum of the rows is in the header: a file that was cut short is not taken for one with fewer rows.
    """
    cells = {name: column if len(column) else _emptied(column) for name, column in columns.items()}
    unsummed = {**head, SUM: _NO_SUM}
    text = write_plain(cells, unsummed) or _written_by_astropy(cells, unsummed)
    write_whole(path, text.replace(_NO_SUM, _sum_of(text), 1))


def _written_by_astropy(columns: Mapping[str, Any], head: Mapping[str, Any]) -> str:
    from astropy.table import Table  # takes a third of a second: only where it is needed

    text = io.StringIO()
    Table(columns, meta=head).write(text, format="ascii.ecsv")
    return text.getvalue()


def _emptied(column: Any) -> Array:
    """A column without rows: an array as it is, a list as one of text."""
    return column if isinstance(column, np.ndarray) else np.empty(0, "U1")


def check_sum(path: Path, content: bytes) -> None:
    """Raise InputError for the content of an ECSV file whose rows are not those it was written with; one
    without a sum, of another program, is not checked.
    """
    text = content.decode("utf-8", errors="replace")
    found = re.search(rf"^#.*\b{SUM}: '?(sha256-\w+)", text, flags=re.MULTILINE)
    if found and found[1] != _sum_of(text):
        raise InputError(
            f"{path}: was cut short or changed since it was written; copy or make it again, or take {SUM} "
            "out of its header where the change is meant"
        )


def _sum_of(text: str) -> str:
    rows = [line.rstrip() for line in text.splitlines() if not line.startswith("#")]
    return "sha256-" + hashlib.sha256("\n".join(rows).encode()).hexdigest()[:16]


def _cell(value: Any) -> Any:
    return float("nan") if value is None else value


def _plain(value: Any) -> Any:
    """Text as numbers are written in files: float() also takes 1_0.0 and the digits of every script."""
    if isinstance(value, bytes):  # FITS has no other text
        value = _text(value)
    if isinstance(value, str) and not (value.isascii() and "_" not in value):
        raise ValueError
    return value


def _whole(value: Any) -> int:
    number = float(value)
    if number != int(number):
        raise ValueError
    return int(number)


def _text(value: Any) -> str:
    if isinstance(value, bytes):
        return value.decode("utf-8", errors="replace").strip()
    return str(value).strip()
