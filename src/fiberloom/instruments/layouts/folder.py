"""What readers of the tables of instruments have in common."""

from pathlib import Path

import numpy as np

from fiberloom.errors import InputError
from fiberloom.instruments.model import Instrument
from fiberloom.tables import TableFile, read_table
from fiberloom.typing import Flags, Floats

ALIKE = 0.2
"""By so much the arms of a table may differ from the instrument's, as a share: units differ by 5 %."""


def newest(folder: Path, *patterns: str) -> Path | None:
    """The file of a folder that fits one of the patterns and is the last by its name; None: there is none."""
    found = [path for pattern in patterns for path in folder.glob(pattern) if path.is_file()]
    return max(found, key=lambda path: path.name, default=None)


def required(folder: Path, *patterns: str) -> Path:
    """The same; InputError where there is none."""
    if (path := newest(folder, *patterns)) is None:
        raise InputError(f"{folder}: no {' or '.join(patterns)} in it")
    return path


def table_of(path: Path, *columns: str) -> TableFile:
    """A table that has these columns, and rows."""
    table = read_table(path)
    table.require(*columns)
    return table


def truths(table: TableFile, name: str) -> Flags:
    """A column of True and False."""
    words = np.char.lower(table.strings(name))
    for row in np.flatnonzero(~np.isin(words, ("true", "false")))[:1]:
        raise table.error(int(row), name, f"= '{words[row]}' is neither True nor False")
    is_true: Flags = words == "true"
    return is_true


def lengths(table: TableFile, name: str) -> Floats:
    """A column of lengths above 0, in mm."""
    values = table.numbers(name)
    for row in np.flatnonzero(~(values > 0.0))[:1]:
        raise table.error(int(row), name, f"= {values[row]:g} must be above 0")
    return values


def check_arms(path: Path, instrument: Instrument, l_alpha_mm: Floats, maker: str) -> None:
    """InputError where most arms (N,) mm are not this instrument's: the folder is another one's."""
    nominal, found = instrument.positioner.l_alpha_mm, float(np.median(l_alpha_mm))
    if abs(found - nominal) > ALIKE * nominal or len(instrument.science_fibres) != 1:
        raise InputError(
            f"{path}: a table of {maker} with arms of {found:.3f} mm, but those of instrument "
            f"'{instrument.name}' have {nominal:g} mm and its science fibres are "
            f"{', '.join(instrument.science_fibres)}; use --instrument {maker.lower()}"
        )


def points_of(instrument: Instrument, length_mm: Floats) -> dict[str, Floats]:
    """The one science fibre, at the end of beta arms of these lengths (N,) mm."""
    return {instrument.science_fibres[0]: np.column_stack([length_mm, np.zeros(len(length_mm))])}
