"""Stores of past runs."""

from __future__ import annotations

from pathlib import Path

from fiberloom.errors import InputError


def existing(where: str) -> str:
    """The same store. Raises InputError where it is a file that is not there."""
    if "://" not in where and not Path(where).exists():
        raise InputError(f"store '{where}': no such file; name the store of an earlier run")
    return where


def stores_below(where: str) -> list[str]:
    """The store that is named, or all below a folder. Raises InputError where there is none."""
    if "://" in where:
        return [where]
    if not Path(where).is_dir():
        return [existing(where)]
    found = sorted(map(str, Path(where).rglob("*.sqlite")))
    if not found:
        raise InputError(f"{where}: no store below this folder; `fiberloom observe` makes one")
    return found
