"""The site as built: nothing from elsewhere, no broken link, every command, every equation drawn."""

import ast
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urljoin, urlsplit

import pytest

from tools.pages import commands, equations

ROOT = Path(__file__).resolve().parents[2]
HOME = "http://site.invalid/"
TEXT = (ROOT / "docs" / "theory" / "equations.md").read_text()
LOADS = {"script", "img", "iframe", "source", "video", "audio", "embed", "object", "track", "input"}
EQUATION = re.compile(r"^\$\$\n(.+?)\n\$\$$|(?<![$\w])\$([^$\n]+)\$(?!\$)", re.M | re.S)


class SeenPage(HTMLParser):
    """What a page loads, where it links to, its anchors, its text, its equations."""

    def __init__(self, html):
        super().__init__()
        self.loads, self.links, self.anchors, self.equations = [], [], set(), 0
        self.text, self._code = [], 0
        self.feed(html)

    def handle_starttag(self, tag, attributes):
        said = dict(attributes)
        self.anchors |= {said[k] for k in ("id", "name") if said.get(k)}
        self.equations += tag == "math"
        self._code += tag in {"code", "pre", "script", "style"}
        if tag == "a":
            self.links += [said["href"]] if "href" in said else []
        elif tag == "link":  # a canonical address loads nothing
            self.loads += [said["href"]] if said.get("rel") != "canonical" else []
        self.loads += [said[k] for k in ("src", "data", "poster") if tag in LOADS and said.get(k)]
        self.loads += re.findall(r"url\(([^)]+)\)", said.get("style") or "")

    def handle_endtag(self, tag):
        self._code -= tag in {"code", "pre", "script", "style"}

    def handle_data(self, data):
        self.text += [] if self._code else [data]


def from_elsewhere(address):
    """Is it the address of another host?"""
    return bool(urlsplit(address.strip("'\" ")).netloc)


def broken(pages, where, link):
    """Is it a link inside of the site that leads nowhere? `pages`: SeenPage by path, None for other files."""
    there = urlsplit(urljoin(HOME + where, link))
    if there.netloc != urlsplit(HOME).netloc or there.scheme not in {"http", "https"}:
        return False
    path = unquote(there.path).lstrip("/")
    path += "index.html" if not path or path.endswith("/") else ""
    if path not in pages:
        return True
    return bool(there.fragment) and pages[path] and unquote(there.fragment) not in pages[path].anchors


def read_site(folder):
    """Every file below the folder by its path: SeenPage, or None for what is no page."""
    files = [p for p in folder.rglob("*") if p.is_file()]
    return {
        str(p.relative_to(folder)): SeenPage(p.read_text()) if p.suffix == ".html" else None for p in files
    }


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("mkdocs", reason="pip install mkdocs mkdocstrings[python]: as in constraints.txt")
    folder = tmp_path_factory.mktemp("site")
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src")}
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "-d", str(folder)],
        capture_output=True, text=True, cwd=ROOT, env=environment,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr + done.stdout
    return folder


@pytest.fixture(scope="module")
def pages(site):
    return read_site(site)


@pytest.mark.slow
def test_nothing_is_loaded_from_elsewhere(site, pages):
    assert len([p for p in pages.values() if p]) > 35
    loaded = [(name, a) for name, page in pages.items() if page for a in page.loads]
    assert len(loaded) > 100
    assert [(name, a) for name, a in loaded if from_elsewhere(a)] == []
    styles = [(p.name, a) for p in site.rglob("*.css") for a in re.findall(r"url\(([^)]+)\)", p.read_text())]
    assert [(name, a) for name, a in styles if from_elsewhere(a)] == []
    assert [p.name for p in site.rglob("*.css") if "@import" in p.read_text()] == []


@pytest.mark.slow
def test_links_and_loaded_files_are_there(pages):
    asked = {(name, a) for name, page in pages.items() if page for a in (*page.links, *page.loads)}
    inside = [a for _, a in asked if not from_elsewhere(a)]
    assert len(inside) > 1000
    assert sorted((name, a) for name, a in asked if broken(pages, name, a)) == []


@pytest.mark.slow
def test_every_command_has_its_place(pages):
    page = pages["commands/index.html"]
    missing = [name for name, _ in commands.commands() if commands.anchor(name) not in page.anchors]
    assert missing == []


@pytest.mark.slow
def test_equations_are_drawn(pages):
    """As many as are written, and no LaTeX is left in the text of any page."""
    assert pages["theory/equations/index.html"].equations == len(EQUATION.findall(TEXT))
    left = re.compile(r"\$\$|\\[\[\](]|\\(?:frac|alpha|theta|mathrm)\b")
    assert [n for n, page in pages.items() if page and left.search("".join(page.text))] == []


# without building the site


def test_the_equations_of_the_theory_are_understood():
    found = EQUATION.findall(TEXT)
    blocks = [block for block, _ in found if block]
    assert len(blocks) >= 20
    assert len(found) - len(blocks) > 80
    for block, inline in found:
        assert equations.mathml(block or inline).startswith("<math ")


def test_every_public_name_of_the_door_has_its_reference():
    import fiberloom as fl

    written = "".join(p.read_text() for p in (ROOT / "docs" / "api").glob("*.md"))
    named = set(re.findall(r"^::: fiberloom\.(\w+)$", written, re.M))
    assert named == set(fl.__all__) - {"__version__"}


def returns_a_code():
    """Names of the commands that return an exit code, and what their docstrings say."""
    for path in (ROOT / "src" / "fiberloom" / "cli").rglob("*.py"):
        for node in ast.parse(path.read_text()).body:
            if (
                isinstance(node, ast.FunctionDef)
                and not node.name.startswith("_")
                and len(node.args.args) == 1
            ):
                (asked,) = node.args.args
                if asked.arg == "options" and node.returns and ast.unparse(node.returns) == "int":
                    yield node.name, " ".join((ast.get_docstring(node) or "").split())


def test_commands_say_when_they_end_with_1():
    said = dict(returns_a_code())
    assert len(said) > 15
    assert [name for name, text in said.items() if not commands.EXIT_ONE.search(text)] == []
    shown = {name.split()[-1] for name, c in commands.commands() if "none" not in commands.exit_one(c)}
    assert shown == {name.replace("_", "-") for name in said}


def test_options_have_their_defaults():
    page = commands.page()
    section = page.split("\n## fiberloom observe\n")[1].split("\n## ")[0]
    assert "| `--instrument <str>` | Preset name, or a TOML file of your own. | sdssv |" in section
    assert "| `--seed <int>` | The one seed of everything random. | 0; x>=0 |" in section
    assert "Exit code 1: where fewer of the assigned fibres" in section
    rows = [row for row in page.splitlines() if row.startswith("| `--")]
    assert len(rows) == sum(len(commands.shown(command, "option")) for _, command in commands.commands())
    assert len(rows) > 200


def test_the_checks_can_fail():
    page = SeenPage(
        '<a href="b/#two">x</a><h2 id="one">y</h2><img src="//cdn.example/x.png">$$ <math></math>'
    )
    pages = {"a/index.html": page, "a/b/index.html": page}
    assert from_elsewhere(page.loads[0])
    assert broken(pages, "a/index.html", "b/#two")
    assert broken(pages, "a/index.html", "../c/")
    assert not broken(pages, "a/index.html", "b/#one")
    assert not broken(pages, "a/index.html", "https://www.mkdocs.org/")
    assert page.equations == 1
    assert "$$" in "".join(page.text)
    for latex in (r"\nosuchword{x}", r"\frac{1}", r"a & b"):
        with pytest.raises(equations.EquationError):
            equations.mathml(latex)
