"""Public functions of the package say in which unit they speak, and name their parameters.

Two rules, read from the source:

1. A float, or an array of floats, that goes in or comes out has its unit in its name (`x_mm`, `speed_deg_s`),
   or the docstring gives a unit, or says that there is none (ratio, share, count, ...).
2. A function with four parameters or more names each of them in its docstring: in backticks, or as
   numpydoc does.

The class's own docstring counts for its methods' units, and for what `__init__` takes.
"""

import ast
import re
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "src" / "fiberloom"

EXEMPT = {
    "cli": "the help of each option is its documentation",
}
"""Rooms whose functions the rules leave out, with the reason."""

WITHOUT = {
    "index": "rows of arrays",
    "rows": "rows of arrays",
    "which": "rows of arrays",
    "positioner_id": "numbers on the bus",
    "gear": "motor turns per output turn",
}
"""Names of parameters that are no quantity, wherever they occur."""

UNITS = (
    "mm|um|nm|mm2|um2|deg|mdeg|deg2|rad|urad|mrad|ms|us|px|px2|e-|adu|Nm|uNm|mNm|Hz|rpm|Wb|Ohm|counts?|cnt"
    "|ticks?|cycles|bytes"
)
LETTERS = "m|s|e|N|V|A|K|kg|J|W"
"""Units of one letter: after a number, a bracket, a slash or "in" only, since they are words too."""
SUFFIX = re.compile(rf"(?:^|_)(?:{UNITS}|{LETTERS}|per_[a-z]+|SI)(?:_?\d)?$")
WORD = re.compile(
    rf"(?<![\w.'-])(?:{UNITS}|SI|%|dimensionless|relative|[Ss]hares?|[Rr]atios?|fractions?|factors?|flags?"
    r"|probabilit(?:y|ies)|standard deviations|sigmas?|weights?)(?:\^?-?\d)?(?![\w'-])"
    rf"|(?:\bin |/|\) |\d )(?:{LETTERS})(?![\w'-])"
)
FLOATS = re.compile(
    r"\b(?:float|Floats|ArrayLike|complex)\b|\bNDArray(?!\[)|\bNDArray\[np\.(?:float|complex)(?:\d+)?\]"
)


class Function(NamedTuple):
    """A public function: where, what it takes and returns, what it says."""

    where: str
    node: ast.FunctionDef | ast.AsyncFunctionDef
    owner: ast.ClassDef | None

    @property
    def said(self) -> str:
        """The docstrings that count for units."""
        own = ast.get_docstring(self.node) or ""
        return own + "\n" + ((ast.get_docstring(self.owner) or "") if self.owner else "")

    @property
    def parameters(self) -> list[ast.arg]:
        """Without self and cls."""
        a = self.node.args
        found = [*a.posonlyargs, *a.args, *a.kwonlyargs]
        return [p for p in found if p.arg not in {"self", "cls"} and not p.arg.startswith("_")]


def documented(node: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Is it public, and no stub of an overload?"""
    return not node.name.startswith("_") and "overload" not in map(ast.unparse, node.decorator_list)


def public(tree: ast.Module, where: str) -> list[Function]:
    """Public functions of a module, and public methods of its public classes."""
    out = []
    for node in tree.body:
        owner = node if isinstance(node, ast.ClassDef) and not node.name.startswith("_") else None
        for found in owner.body if owner else [node]:
            if isinstance(found, ast.FunctionDef | ast.AsyncFunctionDef) and documented(found):
                name = f"{owner.name}.{found.name}" if owner else found.name
                out.append(Function(f"{where}:{name}", found, owner))
    return out


def measured(annotation: ast.expr | None) -> bool:
    """Is it a float, or an array of floats?"""
    return annotation is not None and bool(FLOATS.search(ast.unparse(annotation)))


def without_unit(f: Function) -> list[str]:
    """Floats of a function whose unit nothing tells."""
    if WORD.search(f.said):
        return []
    asked = [p.arg for p in f.parameters if measured(p.annotation) and p.arg not in WITHOUT]
    bare = [name for name in asked if not SUFFIX.search(name)]
    returns = measured(f.node.returns) and not SUFFIX.search(f.node.name)
    return [f"{f.where}: unit of {name}" for name in [*bare, *(["the result"] if returns else [])]]


def unnamed(f: Function) -> list[str]:
    """Parameters of a function with four or more that its docstring does not name."""
    own = ast.get_docstring(f.node) or ""
    if len(f.parameters) < 4:
        return []
    listed = ",".join(re.findall(r"^(\w+(?:, \w+)*) ?:", own, re.M))
    said = {*re.findall(r"`(\w+)", own), *re.split(r",\s*", listed)}
    return [f"{f.where}: {p.arg}" for p in f.parameters if p.arg not in said]


def functions() -> dict[str, list[Function]]:
    """Public functions by room."""
    out: dict[str, list[Function]] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        inside = path.relative_to(PACKAGE)
        room = inside.parts[0].removesuffix(".py")
        if not any(part.startswith("_") and part != "__init__.py" for part in inside.parts):
            out.setdefault(room, []).extend(public(ast.parse(path.read_text()), str(inside)))
    return {room: found for room, found in out.items() if found and room not in EXEMPT}


ROOMS = functions()


@pytest.mark.parametrize("room", ROOMS)
def test_floats_have_units(room):
    assert [fault for f in ROOMS[room] for fault in without_unit(f)] == []


@pytest.mark.parametrize("room", ROOMS)
def test_parameters_are_named(room):
    assert [fault for f in ROOMS[room] for fault in unnamed(f)] == []


def test_there_is_something_to_check():
    found = [f for room in ROOMS.values() for f in room]
    assert len(found) > 300
    assert sum(len(f.parameters) >= 4 for f in found) > 50
    assert set(EXEMPT) <= {p.name.removesuffix(".py") for p in PACKAGE.iterdir()}


# the checks can fail

SOURCE = '''
def speed(way_deg: float, time_s: float) -> float:
    """Mean speed{}."""

def move(a: int, b: int, c: int, d: int) -> None:
    """Move `a`, `b` and `c`{}."""

def scale_ratio(x_mm: Floats, rows: Ints) -> NDArray[np.bool_]:
    """Nothing to say."""
'''


def test_the_checks_can_fail():
    mended = SOURCE.replace("speed{}", "speed in deg/s").replace("`c`{}", "`c` by `d`")
    good = public(ast.parse(mended), "x.py")
    bad = public(ast.parse(SOURCE), "x.py")
    assert [fault for f in good for fault in without_unit(f) + unnamed(f)] == []
    assert [fault for f in bad for fault in without_unit(f)] == ["x.py:speed: unit of the result"]
    assert [fault for f in bad for fault in unnamed(f)] == ["x.py:move: d"]
