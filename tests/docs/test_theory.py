"""docs/theory/equations.md: every file and function that it cites exists, every equation has its entry."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "theory" / "equations.md").read_text()
FILE = re.compile(r"(?:core|firmware|src|tests)/[\w/]+\.(?:py|hpp|cpp|h|c)")


def citations():
    """(file, name) pairs: backticked names that follow a backticked file, up to the next file."""
    out = []
    for sentence in re.split(r"\n\n|\n\|", TEXT):
        file = None
        for word in re.findall(r"`([^`\n]+)`", sentence):
            if FILE.fullmatch(word):
                file = word
                out.append((file, None))
            elif file and re.fullmatch(r"\w+", word):
                out.append((file, word))
    return out


@pytest.mark.parametrize(("file", "name"), citations())
def test_what_is_cited_exists(file, name):
    path = ROOT / file
    assert path.is_file(), f"docs/theory/equations.md cites {file}"
    if name:
        text = path.read_text()
        # a definition, not a mention: def in Python, name before a bracket at the start of a line in C
        python = rf"^\s*(?:async )?def {name}\("
        c = rf"^(?:[\w<>:*&, ]+[ *&:])?{name}\([^;]*$"
        assert re.search(python if path.suffix == ".py" else c, text, re.M), f"{file} has no {name}"


def test_there_is_something_to_check():
    found = citations()
    assert len(found) > 60
    assert ("core/geometry/src/arm.cpp", "inverse") in found
    assert ("src/fiberloom/operation/correction.py", "plain_update") in found


def test_every_equation_of_the_paper_has_an_entry():
    named = set()
    for entry in re.findall(r"\*\*Eq\. ([^*]+?)\*\*", TEXT):
        numbers = [int(n) for n in re.findall(r"\d+", entry)]
        named |= set(range(numbers[0], numbers[-1] + 1)) if " to " in entry else set(numbers)
    named |= {3, 4, 5}  # Eq. 5a is printed with a letter
    assert named >= set(range(1, 35)), sorted(set(range(1, 35)) - named)


def test_equations_are_latex():
    """No equation is left as an indented block of text, and every `$$` is closed."""
    assert re.findall(r"^ {4}\S.*$", TEXT, re.M) == []
    assert len(re.findall(r"^\$\$$", TEXT, re.M)) == TEXT.count("$$")
    assert TEXT.count("$$") % 2 == 0
    inline = re.sub(r"`[^`\n]*`", "", re.sub(r"^\$\$\n.*?^\$\$$", "", TEXT, flags=re.M | re.S))
    assert [line for line in inline.splitlines() if line.count("$") % 2] == []


def test_links_lead_to_pages():
    pages = re.findall(r"\]\(([\w./]+\.md)\)", TEXT)
    assert pages
    for page in pages:
        assert (ROOT / "docs" / "theory" / page).is_file(), page
