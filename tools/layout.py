"""What the tools know of the tree: languages, top folders, and which tests count for which code.

Folders that a checkout does not have are passed over, so a move inside a room changes nothing here.
"""

import os
import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

LANGUAGES = {".c": "C", ".h": "C", ".cpp": "C++", ".hpp": "C++", ".py": "Python"}
# Code in the order of the table; what is below a `tests` folder counts as tests.
TOPS = ("firmware", "rig", "core", "src/fiberloom", "tools")
HOST = "src/fiberloom"
NOT_OURS = {"__pycache__", "build", "runs", "site", "node_modules"}
BUILT = {".so", ".pyc", ".pyd", ".o"}

# Which tests count for which code; the first line that fits counts. A test in a folder of Python and C++
# alike is one of the core where it imports the compiled module. Every other tests/NAME counts for the host
# (and for its room NAME, where there is one).
TESTS = (
    ("firmware", r"firmware/tests/|tests/firmware/"),
    ("rig", r"rig/tests/|tests/rig/"),
    ("core", r"core/tests/|core/\w+/tests/|tests/(core|geometry)/"),
    ("tools", r"tests/tools/"),
)
COMPILED = "fiberloom._core"
SHARED_WITH_CORE = r"tests/(planning|metrology|twin)/"

# `make coverage`: the small tests for Python, and of those the ones that reach most of C and C++.
COUNTED = "not long and not jaeger and not clock"  # code with counters is too slow for a clock
SMALL = f"not slow and {COUNTED}"
NATIVE_TESTS = ("tests/firmware", "tests/rig", "tests/core", "tests/bindings", "tests/geometry",
                "tests/planning", "tests/metrology", "tests/twin")  # fmt: skip


@dataclass(frozen=True)
class Target:
    """Code that is mutated and the tests that are to notice."""

    name: str
    code: tuple[str, ...]
    tests: tuple[str, ...]
    language: str = "Python"


# `make mutate`
MUTATED = (
    Target("operation", ("src/fiberloom/operation",), ("tests/operation",)),
    Target("health", ("src/fiberloom/health",), ("tests/health", "tests/operation")),
    Target("calibration", ("src/fiberloom/calibration",), ("tests/calibration", "tests/commissioning")),
    Target("planning", ("src/fiberloom/planning",), ("tests/planning",)),
    Target("sky", ("src/fiberloom/sky",), ("tests/sky",)),
    Target("drive", ("src/fiberloom/drive",), ("tests/drive",)),
    Target("laws", ("firmware/law",), ("tests/firmware",), "C"),
)


@dataclass(frozen=True)
class Group:
    """One row of the table: a language of a top folder, or a room of the host."""

    top: str
    language: str
    room: str = ""

    def __str__(self) -> str:
        name = "host" if self.top == HOST else self.top
        return f"  {self.room}" if self.room else f"{name} {self.language}"


def files_below(root: Path) -> list[Path]:
    """Every file of the tree that is no product of a build, relative to its root, sorted."""
    found = []
    for folder, folders, names in os.walk(root):
        folders[:] = sorted(f for f in folders if f not in NOT_OURS and not f.startswith("."))
        written = [n for n in names if Path(n).suffix not in BUILT and not n.startswith(".")]
        found += [(Path(folder) / n).relative_to(root) for n in written]
    return sorted(found)


def group_of(path: Path) -> Group | None:
    """The row that a file of code counts in; None for tests, documents and everything else."""
    language = LANGUAGES.get(path.suffix)
    if language is None or "tests" in path.parts:
        return None
    for top in TOPS:
        if path.is_relative_to(top):
            inner = path.relative_to(top).parts
            room = (inner[0] if len(inner) > 1 else "(top)") if top == HOST else ""
            return Group(top, language, room)
    return None


def top_under_test(path: Path, text: str) -> tuple[str, str] | None:
    """(top folder, room) that a file of tests counts for; None where it is no test."""
    if path.suffix not in LANGUAGES or "tests" not in path.parts:
        return None
    posix = path.as_posix()
    for top, pattern in TESTS:
        if re.match(pattern, posix):
            return top, ""
    if re.match(SHARED_WITH_CORE, posix) and COMPILED in text:
        return "core", ""
    return HOST, path.parts[1] if len(path.parts) > 2 else ""
