"""`import fiberloom`: fifteen names, at no cost, and no event loop or print where they do not belong."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import fiberloom as fl

ROOT = Path(__file__).resolve().parents[2]
NAMES = [
    *("Instrument", "FocalPlane", "TargetList", "read_targets", "assign", "plan", "verify", "Plan"),
    *("Field", "Observation", "TransmissionMaps", "centroid", "Spots", "InputError", "__version__"),
]


def loaded_by(statement):
    """Top modules, and modules of ours, that a statement loads in a new interpreter."""
    code = f"{statement}\nimport sys\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    names = done.stdout.split()
    return {n.partition(".")[0] for n in names}, {n for n in names if n.startswith("fiberloom")}


def test_the_door_offers_these_names_and_no_others():
    assert sorted(fl.__all__) == sorted(NAMES)
    assert dir(fl) == sorted(NAMES)
    for name in NAMES:
        assert getattr(fl, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'Robot'"):
        _ = fl.Robot


def test_the_import_alone_loads_nothing():
    top, ours = loaded_by("import fiberloom")
    heavy = {"numpy", "scipy", "astropy", "matplotlib", "sqlalchemy", "pydantic", "can", "dask", "rich"}
    assert top & heavy == set()
    assert ours == {"fiberloom", "fiberloom.version"}


def test_a_name_loads_what_it_needs_and_not_the_twin():
    top, ours = loaded_by("import fiberloom as fl; fl.FocalPlane.of('sdssv', n=7)")
    assert top & {"matplotlib", "astropy", "sqlalchemy"} == set()
    assert not any(name.startswith("fiberloom.twin") for name in ours)
    _, ours = loaded_by("import fiberloom as fl; fl.Field.open")
    assert not any(name.startswith("fiberloom.twin") for name in ours)


def test_type_checkers_see_where_each_name_is_found():
    """The imports for type checkers and the places at run time are one list."""
    tree = ast.parse((ROOT / "src/fiberloom/__init__.py").read_text())
    block = next(n for n in tree.body if isinstance(n, ast.If))
    seen = {a.name: n.module for n in block.body for a in n.names}
    assert seen == {name: f"fiberloom.{place}" for name, place in fl._PLACES.items()}


def test_every_name_has_its_place_in_the_reference():
    pages = "".join(path.read_text() for path in (ROOT / "docs" / "api").glob("*.md"))
    shown = set(re.findall(r"^::: fiberloom\.(\w+)$", pages, flags=re.MULTILINE))
    assert shown == set(NAMES) - {"__version__"}
    nav = (ROOT / "mkdocs.yml").read_text()
    assert all(f"api/{path.name}" in nav for path in (ROOT / "docs" / "api").glob("*.md"))


# one place each


def uses(tree):
    """What only the command line may do, in a parsed source."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print":
            yield "print"
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            name = f"{node.value.id}.{node.attr}"
            if name in ("asyncio.run", "sys.argv"):
                yield name
        if isinstance(node, ast.ImportFrom) and node.module in ("asyncio", "sys"):
            yield from (
                f"{node.module}.{a.name}"
                for a in node.names
                if f"{node.module}.{a.name}" in ("asyncio.run", "sys.argv")
            )


def found():
    package = ROOT / "src" / "fiberloom"
    for path in package.rglob("*.py"):
        place = path.relative_to(package)
        if place.parts[0] != "cli":
            yield from ((str(place), what) for what in uses(ast.parse(path.read_text())))


def test_event_loops_begin_in_one_place_and_only_the_command_line_prints():
    assert sorted(found()) == [("blocking.py", "asyncio.run")]


def test_that_search_finds_what_it_looks_for():
    source = (
        "import asyncio, sys\nfrom asyncio import run\nasyncio.run(f())\nprint(sys.argv)\nconsole.print(1)"
    )
    assert sorted(uses(ast.parse(source))) == ["asyncio.run", "asyncio.run", "print", "sys.argv"]
