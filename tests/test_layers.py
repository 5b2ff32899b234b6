"""Imports point down, in Python, C and C++: by the floors of docs/architecture.md."""

import ast
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "architecture.md").read_text()

Edges = dict[str, set[str]]


# what the page says


def floors(heading: str) -> list[set[str]]:
    """Floors of a numbered list under a heading, the ground first. One line: `1. a, b: why`."""
    section = PAGE.split(f"### {heading}\n", 1)[1].split("\n#", 1)[0]
    lines = re.findall(r"^\d+\. ([^:\n]+):", section, flags=re.M)
    return [set(re.findall(r"`([\w./]+?)/?`", line)) for line in reversed(lines)]


def faults(edges: Edges, levels: list[set[str]]) -> list[str]:
    """Edges that do not point down, and rooms that stand on no floor."""
    floor = {room: i for i, rooms in enumerate(levels) for room in rooms}
    rooms = set(edges) | {b for targets in edges.values() for b in targets}
    homeless = [f"{room} is on no floor of docs/architecture.md" for room in sorted(rooms - set(floor))]
    return homeless + [
        f"{a} (floor {floor[a]}) imports {b} (floor {floor[b]})"
        for a in sorted(edges)
        for b in sorted(edges[a])
        if a != b and a in floor and b in floor and floor[b] >= floor[a]
    ]


def circle(edges: Mapping[str, set[str]]) -> list[str]:
    """One circle of files, or nothing."""
    done: set[str] = set()

    def visit(file: str, way: list[str]) -> list[str]:
        if file in way:
            return [*way[way.index(file) :], file]
        if file in done:
            return []
        for other in sorted(edges.get(file, ())):
            if found := visit(other, [*way, file]):
                return found
        done.add(file)
        return []

    return next((found for file in sorted(edges) if (found := visit(file, []))), [])


# Python


PACKAGE = ROOT / "src" / "fiberloom"


def module_name(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported(source: str, modules: set[str]) -> Iterator[str]:
    """Modules of ours that a source imports, also inside functions."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules)
        elif isinstance(node, ast.ImportFrom) and node.module in modules:
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                yield full if full in modules else node.module


def python_edges() -> Edges:
    paths = {module_name(path): path for path in PACKAGE.rglob("*.py")}
    return {m: set(imported(path.read_text(), set(paths))) - {m} for m, path in paths.items()}


def room(module: str) -> str:
    """The folder, or the file at the root, that a module is in."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else "__init__"


def by_room(edges: Edges) -> Edges:
    rooms: Edges = {}
    for module, targets in edges.items():
        rooms.setdefault(room(module), set()).update(room(t) for t in targets)
    return rooms


def test_python_imports_point_down():
    assert faults(by_room(python_edges()), floors("Python")) == []


def test_no_circle_in_python():
    edges = python_edges()
    faces = {m for m in edges if (PACKAGE.parent / m.replace(".", "/") / "__init__.py").is_file()}
    # a package's face only hands on names: whoever imports the package does not import its files' circle
    assert circle({m: t - faces for m, t in edges.items() if m not in faces}) == []


NEEDED_BY_A_REAL_ARRAY = {
    *("assignment", "bus", "calibration", "hardware", "health", "instruments", "metrology"),
    *("operation", "planning", "report", "sky", "store", "targets"),
}


def test_a_real_array_needs_no_line_of_the_twin():
    edges = python_edges()
    reached, open_ = set(), {m for m in edges if room(m) in NEEDED_BY_A_REAL_ARRAY}
    while open_:
        module = open_.pop()
        reached.add(module)
        open_ |= edges[module] - reached
    assert sorted(m for m in reached if room(m) in {"twin", "studies", "cli"}) == []


# C and C++


def sources(*folders: str) -> list[Path]:
    found = (p for folder in folders for p in (ROOT / folder).rglob("*"))
    return [p for p in found if p.suffix in {".c", ".h", ".cpp", ".hpp"}]


def include_edges(files: list[Path]) -> Edges:
    """Files by path below the root: a source includes what is beside it or else what has that name."""
    by_name: dict[str, list[Path]] = {}
    for path in files:
        by_name.setdefault(path.name, []).append(path)
    edges: Edges = {}
    for path in files:
        names = re.findall(r'^\s*#\s*include\s*["<]([^">]+)[">]', path.read_text(), flags=re.M)
        edges[str(path.relative_to(ROOT))] = {
            str(best.relative_to(ROOT)) for name in names if (best := _meant(name, path, by_name)) is not None
        }
    return edges


def _meant(name: str, by: Path, by_name: dict[str, list[Path]]) -> Path | None:
    candidates = [p for p in by_name.get(Path(name).name, []) if str(p).endswith(name)]
    beside = (by.parent / name).resolve()
    return beside if beside in candidates else next(iter(candidates), None)


def room_of_file(path: str, depth: int) -> str:
    return "/".join(path.split("/")[:depth])


def native_rooms(edges: Edges, top: str, depth: int) -> Edges:
    rooms: Edges = {}
    for path, targets in edges.items():
        if path.startswith(top + "/"):
            own = rooms.setdefault(room_of_file(path, depth), set())
            own.update(room_of_file(t, depth) for t in targets)
    return rooms


NATIVE = ("firmware", "core", "rig")


@pytest.mark.parametrize(("heading", "top", "depth"), [("C", "firmware", 2), ("C++", "core", 2)])
def test_includes_point_down(heading, top, depth):
    rooms = native_rooms(include_edges(sources(*NATIVE)), top, depth)
    known = {r for level in floors(heading) for r in level}
    outside = {
        r: {"firmware" if t.startswith("firmware/") and top != "firmware" else t for t in ts}
        for r, ts in rooms.items()
    }
    assert faults({r: ts for r, ts in outside.items() if r in known or r not in TESTS}, floors(heading)) == []


TESTS = {"firmware/tests"}


def test_no_circle_of_includes():
    assert circle(include_edges(sources(*NATIVE))) == []


def test_firmware_is_a_leaf():
    edges = include_edges(sources(*NATIVE))
    up = {
        f: [t for t in ts if not t.startswith("firmware/")]
        for f, ts in edges.items()
        if f.startswith("firmware/")
    }
    assert {f: ts for f, ts in up.items() if ts} == {}
    assert list((ROOT / "firmware").rglob("*.py")) == []


def test_nothing_native_knows_python():
    python = re.compile(r"#\s*include\s*[<\"](Python\.h|nanobind)")
    knowing = [p for p in sources(*NATIVE) if python.search(p.read_text())]
    assert [str(p.relative_to(ROOT)) for p in knowing if "bindings" not in p.parts] == []


# the house


def test_folders_of_at_most_fifteen_files():
    roots = [
        ROOT / name for name in ("firmware", "core", "rig", "src", "tests", "benchmarks", "docs", "examples")
    ]
    crowded = {}
    for folder in (d for root in roots if root.is_dir() for d in [root, *root.rglob("*")] if d.is_dir()):
        if "__pycache__" not in folder.parts:
            files = [f for f in folder.iterdir() if f.is_file() and f.suffix not in {".so", ".pyc"}]
            if len(files) > 15:
                crowded[str(folder.relative_to(ROOT))] = len(files)
    assert crowded == {}


# the test can fail


def test_a_floor_that_is_skipped_upward_is_found():
    levels = [{"low"}, {"middle"}, {"high"}]
    assert faults({"low": {"high"}}, levels) == ["low (floor 0) imports high (floor 2)"]
    assert faults({"high": {"low"}}, levels) == []
    assert faults({"middle": {"middle", "low"}}, levels) == []
    assert faults({"new": {"low"}}, levels) == ["new is on no floor of docs/architecture.md"]


def test_a_circle_is_found():
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"a"}}) == ["a", "b", "c", "a"]
    assert circle({"a": {"b", "c"}, "b": {"c"}}) == []
