"""Instruments by name or from a file."""

import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from fiberloom.errors import InputError
from fiberloom.instruments.model import Instrument
from fiberloom.instruments.names import check_name, instrument_names


def load_instrument(name_or_path: str | Path) -> Instrument:
    """A preset by name (`sdssv`), or an instrument of your own from a TOML file."""
    text, where = _read(str(name_or_path))
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{where}: not valid TOML: {error}") from None
    return parse_instrument(data, where)


def parse_instrument(data: dict[str, Any], where: str) -> Instrument:
    """The instrument of a parsed TOML file; `where` names it in errors."""
    try:
        return Instrument.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{where}: {first_problem(error)}") from None


def _read(name: str) -> tuple[str, str]:
    if name in instrument_names():
        return files("fiberloom.instruments.presets").joinpath(f"{name}.toml").read_text(), name
    check_name(name)
    path = Path(name)
    try:
        return path.read_text(encoding="utf-8"), str(path)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text: {error}") from None


def first_problem(error: ValidationError) -> str:
    """The first thing that is wrong with a file, in one line: key, value, rule."""
    problems = error.errors()
    first = problems[0]
    key = ".".join(str(part) for part in first["loc"])
    message = first["msg"].removeprefix("Value error, ")
    value = "" if isinstance(first["input"], dict) else f" = {first['input']!r}"
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return f"{key}{value}: {message}{more}".removeprefix(": ")
