"""The pages as a whole: links lead to pages and headings, the site lists every page, words are plain."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs").rglob("*.md"))
WRITTEN = {"commands.md"}
"""Pages that exist in the site only: programs write them when it is built."""
PLAIN = re.compile(
    r"\b(?:everybody|nobody|somebody|everyone|whoever|whomever|who|stands?|stood)\b|would not go",
    re.I,
)


def name(page):
    return str(page.relative_to(ROOT))


def prose(text):
    """The text without blocks and code."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.M | re.S)
    return re.sub(r"`[^`\n]+`", "", re.sub(r"^ {4}.*$", "", text, flags=re.M))


def anchors(text):
    """Headings of a page as the site links to them."""
    heads = re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```", "", text, flags=re.M | re.S), re.M)
    return {re.sub(r"[\s_]+", "-", re.sub(r"[^\w\s-]", "", head.lower()).strip()) for head in heads}


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=name)
def test_links_lead_somewhere(page):
    text = page.read_text()
    for link in re.findall(r"\]\(([^)\s]+)\)", prose(text)):
        if not link.startswith("http"):
            path, _, anchor = link.partition("#")
            target = (page.parent / path).resolve() if path else page
            if target in [ROOT / "docs" / page for page in WRITTEN]:
                continue  # test_built_site.py looks at these
            assert target.exists(), link
            assert not anchor or anchor in anchors(target.read_text()), link


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_pages_named_in_words_exist(page):
    for path in re.findall(r"\bdocs/[\w/-]+\.md", page.read_text()):
        assert (ROOT / path).is_file(), path


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=name)
def test_files_named_in_backticks_exist(page):
    """Whole paths, or the end of one (`search.cpp`); results of a run are no files of ours."""
    rooms = [ROOT / room for room in ("core", "firmware", "rig", "src", "tests", "benchmarks", "examples")]
    ours = [str(p) for room in rooms for p in room.rglob("*.*")]
    for path in re.findall(r"`((?:[\w-]+/)*[\w-]+\.(?:py|c|h|cpp|hpp|ld|cmake|ipynb))`", page.read_text()):
        assert any(p.endswith("/" + path) for p in ours), path


def test_the_site_lists_every_page():
    nav = set(re.findall(r"^\s*- [^#\n]*: ([\w/-]+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.M))
    assert nav == {str(p.relative_to(ROOT / "docs")) for p in PAGES} | WRITTEN


def test_code_names_pages_that_exist():
    """Comments and messages that send the reader to a page."""
    lost = set()
    for room in ("src", "core", "firmware", "rig", "tests", "benchmarks", "examples"):
        for path in (ROOT / room).rglob("*"):
            if path.suffix in {".py", ".c", ".h", ".hpp", ".cpp", ".toml"}:
                cited = re.findall(r"\bdocs/[\w/-]+\.md", path.read_text())
                lost |= {(name(path), page) for page in cited if not (ROOT / page).is_file()}
    assert lost == set()


@pytest.mark.parametrize("page", [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *PAGES], ids=name)
def test_words_are_plain(page):
    """Positioners are not persons: every positioner, none, which, is."""
    assert [m.group() for m in PLAIN.finditer(prose(page.read_text()))] == []


def test_the_checks_can_fail():
    assert PLAIN.search("where Everybody stands")
    assert anchors("# How good\n\n## What it costs\n") == {"how-good", "what-it-costs"}
    assert not PLAIN.search(prose("`twin.stand(wire)`"))
