"""Instruments by name or from a file."""

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from fiberloom.errors import InputError
from fiberloom.files import parse_toml, read_text, shown
from fiberloom.instruments.model import Instrument
from fiberloom.instruments.names import check_name, instrument_names

MOST_TOLD = 24
"""Problems of one file that are told; a file with more is of another kind."""
LETTERS_EACH = 250
"""Of a problem, with its key and value."""


def load_instrument(name_or_path: str | Path) -> Instrument:
    """A preset by name (`sdssv`), or an instrument of your own from a TOML file."""
    text, where = _read(str(name_or_path))
    return parse_instrument(parse_toml(text, where), where)


def parse_instrument(data: dict[str, Any], where: str) -> Instrument:
    """The instrument of a parsed TOML file; `where` names it in errors."""
    try:
        return Instrument.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{where}: {all_problems(error)}", LETTERS_EACH * MOST_TOLD) from None


def instrument_text(name_or_path: str | Path) -> str:
    """The TOML text of a preset or of a file that holds an instrument: to be changed, and read again."""
    text, where = _read(str(name_or_path))
    parse_instrument(parse_toml(text, where), where)
    return text


def _read(name: str) -> tuple[str, str]:
    if name in instrument_names():
        return files("fiberloom.instruments.presets").joinpath(f"{name}.toml").read_text(), name
    check_name(name)
    return read_text(Path(name)), str(Path(name))


def first_problem(error: ValidationError) -> str:
    """The first thing that is wrong with a file, in one line: key, value, rule."""
    first, *others = error.errors()
    return _told(first) + (f" (and {len(others)} more)" if others else "")


def all_problems(error: ValidationError) -> str:
    """All that is wrong with a file, in one line: key, value, rule of each."""
    told = [_told(one) for one in error.errors()]
    if len(told) == 1:
        return told[0]
    more = f"; and {len(told) - MOST_TOLD} more" if len(told) > MOST_TOLD else ""
    return f"{len(told)} problems: {'; '.join(told[:MOST_TOLD])}{more}"


def _told(problem: Mapping[str, Any]) -> str:
    key = ".".join(str(part) for part in problem["loc"])
    message = problem["msg"].removeprefix("Value error, ")
    value = "" if isinstance(problem["input"], dict) else f" = {shown(problem['input'])}"
    return f"{key}{value}: {message}".removeprefix(": ")
