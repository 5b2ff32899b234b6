"""Comments, docstrings and messages of the package are plain: positioners are not persons."""

import io
import re
import tokenize
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "src" / "fiberloom"
PERSONS = re.compile(r"\b(?:[Ee]very|[Nn]o|[Ss]ome)body\b|\b[Ee]veryone\b|\b[Ww]ho(?:m)?ever\b|would not go")

FILES = sorted(PACKAGE.rglob("*.py"))


def persons(source: str) -> list[str]:
    """Words for persons in comments and strings, with their line."""
    kinds = {tokenize.COMMENT, tokenize.STRING}
    tokens = [t for t in tokenize.generate_tokens(io.StringIO(source).readline) if t.type in kinds]
    return [f"{t.start[0]}: {m.group()}" for t in tokens for m in PERSONS.finditer(t.string)]


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_words_are_plain(path):
    assert persons(path.read_text()) == []


def test_the_check_can_fail():
    assert persons('"""Where everybody is."""\nx = 1  # Whoever waits\n') == ["1: everybody", "2: Whoever"]
    assert persons("NOBODY = -1  # no target\n") == []
    assert len(FILES) > 150
