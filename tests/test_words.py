"""One word for each thing: no class name stands for two, and retired words do not come back."""

import ast
import re
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "fiberloom"

RETIRED = {
    "python": r"\b(Robot|Floor|Passage|Trouble|misbehave|NOBODY|_Hunt)\b",
    "native": r"\b(Cast|Team|Crowd|Piece|Bend|sway|Squad|muster|Hills|Errand)\b",
}
"""Names that gave way to words of the field (docs/glossary.md)."""


def class_places() -> dict[str, list[str]]:
    places = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(str(path.relative_to(PACKAGE)))
    return places


def test_no_class_name_stands_for_two_things():
    assert {name: places for name, places in class_places().items() if len(places) > 1} == {}


def test_retired_names_do_not_come_back():
    python = dict.fromkeys(PACKAGE.rglob("*.py"), RETIRED["python"])
    native = {
        p: RETIRED["native"]
        for folder in ("core", "firmware", "rig")
        for p in (ROOT / folder).rglob("*")
        if p.suffix in {".c", ".h", ".cpp", ".hpp"}
    }
    found = {
        str(path.relative_to(ROOT)): words
        for path, pattern in (python | native).items()
        if (words := re.findall(pattern, path.read_text()))
    }
    assert found == {}


def test_test_files_have_names_of_their_own():
    """Two of one name cannot be collected in one run."""
    places = defaultdict(list)
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        places[path.name].append(str(path.parent.relative_to(ROOT)))
    assert {name: folders for name, folders in places.items() if len(folders) > 1} == {}
