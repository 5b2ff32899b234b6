"""Stores of past runs."""

from __future__ import annotations

from pathlib import Path

from fiberloom.errors import InputError


def stores_below(where: str) -> list[str]:
    """The store that is named, or all below a folder. Raises InputError where there is none."""
    if "://" in where or not Path(where).is_dir():
        return [where]
    found = sorted(map(str, Path(where).rglob("*.sqlite")))
    if not found:
        raise InputError(f"{where}: no store below this folder; `fiberloom observe` makes one")
    return found
