"""Names of instruments: checked before anything heavy is imported."""

from importlib.resources import files
from pathlib import Path

from fiberloom.errors import InputError


def instrument_names() -> list[str]:
    """Names of the presets that come with fiberloom."""
    folder = files("fiberloom.instruments.presets")
    return sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml"))


def check_name(name: str) -> None:
    """Raises InputError unless this is a preset or a file."""
    names = instrument_names()
    if name not in names and not Path(name).is_file():
        raise InputError(f"instrument '{name}': neither a preset ({', '.join(names)}) nor a TOML file")
