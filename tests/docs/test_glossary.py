"""docs/glossary.md: every name of its last column exists, every word is listed once."""

import dataclasses
import importlib
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "glossary.md").read_text()
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in TEXT.splitlines()
    if line.startswith("| ") and not line.startswith("| word ")
]
NAMES = sorted({name for row in ROWS for name in re.findall(r"`([^`]+)`", row[-1])})


def exists(dotted: str) -> bool:
    """Module, class, function, attribute or field by its dotted path."""
    parts = dotted.split(".")
    for n in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:n]))
        except ImportError:
            continue
        return all((found := member(found, part)) is not None for part in parts[n:])
    return False


def member(owner, name):
    """An attribute, or a field of a dataclass or of a pydantic model."""
    fields = {f.name for f in dataclasses.fields(owner)} if dataclasses.is_dataclass(owner) else set()
    if name in fields or name in getattr(owner, "model_fields", {}):
        return getattr(owner, name, object())
    return getattr(owner, name, None)


@cache
def identifiers() -> frozenset[str]:
    """Identifiers in the headers of C and C++, without comments."""
    out: set[str] = set()
    for room in ("firmware", "core"):
        for path in (ROOT / room).rglob("*.h*"):
            text = re.sub(r"/\*.*?\*/|//[^\n]*", "", path.read_text(), flags=re.DOTALL)
            out |= set(re.findall(r"[A-Za-z_]\w*", text))
    return frozenset(out)


@pytest.mark.parametrize("name", NAMES)
def test_what_is_cited_exists(name):
    assert exists(name) if name.startswith("fiberloom") else name in identifiers()


def test_rows_are_whole_and_words_are_listed_once():
    assert len(ROWS) > 80
    assert all(len(row) == 4 and row[0] and row[1] and row[3] for row in ROWS)
    words = [word for row in ROWS for word in row[0].split(", ")]
    assert sorted(set(words)) == sorted(words)


def test_the_check_can_fail():
    assert not exists("fiberloom.planning.no_such_thing")
    assert not exists("fiberloom.twin.Fault.no_such_field")
    assert "fl_no_such_law_step" not in identifiers()
