"""Instruments by name or from a file."""

from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from fiberloom.errors import InputError
from fiberloom.files import parse_toml, read_text, shown
from fiberloom.instruments.model import Instrument
from fiberloom.instruments.names import check_name, instrument_names


def load_instrument(name_or_path: str | Path) -> Instrument:
    """A preset by name (`sdssv`), or an instrument of your own from a TOML file."""
    text, where = _read(str(name_or_path))
    return parse_instrument(parse_toml(text, where), where)


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
    return read_text(Path(name)), str(Path(name))


def first_problem(error: ValidationError) -> str:
    """The first thing that is wrong with a file, in one line: key, value, rule."""
    problems = error.errors()
    first = problems[0]
    key = ".".join(str(part) for part in first["loc"])
    message = first["msg"].removeprefix("Value error, ")
    value = "" if isinstance(first["input"], dict) else f" = {shown(first['input'])}"
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return f"{key}{value}: {message}{more}".removeprefix(": ")
