"""Line and branch coverage as `make coverage` left it, refused where the code has changed since.

build/coverage holds python.json (coverage.py), native.json (gcovr) and sources.json: the hash of every
measured file, by which stale data are known, whatever the clock says.
"""

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path("build/coverage")
PYTHON, NATIVE, SOURCES = "python.json", "native.json", "sources.json"
HOW = "make coverage"


@dataclass(frozen=True)
class Count:
    """Lines and branches, how many there are and how many were reached."""

    n_lines: int = 0
    n_lines_hit: int = 0
    n_branches: int = 0
    n_branches_hit: int = 0

    def __add__(self, other: "Count") -> "Count":
        return Count(
            self.n_lines + other.n_lines,
            self.n_lines_hit + other.n_lines_hit,
            self.n_branches + other.n_branches,
            self.n_branches_hit + other.n_branches_hit,
        )


@dataclass
class Coverage:
    """Counts by file, and the hash of the file that was measured."""

    counts: dict[Path, Count]
    hashes: dict[str, str]

    def of(self, root: Path, files: Iterable[Path]) -> Count | str:
        """The sum over files of code, or why there is none: `not measured` or `stale`."""
        files = list(files)
        measured = [f for f in files if f in self.counts]
        if not measured:
            return "not measured"
        if any(self.hashes.get(f.as_posix()) != file_hash(root / f) for f in files):
            return "stale"
        return sum((self.counts[f] for f in measured), Count())


def file_hash(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def write_hashes(root: Path, hashes: dict[str, str]) -> None:
    """Notes what the files were that have been measured; those of the other languages stay as noted."""
    path = root / FOLDER / SOURCES
    noted = (json.loads(path.read_text()) if path.exists() else {}) | hashes
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(noted, indent=1) + "\n")


def read_coverage(root: Path) -> Coverage:
    """What has been measured; empty where nothing has."""
    counts: dict[Path, Count] = {}
    folder = root / FOLDER
    if (folder / PYTHON).exists():
        for name, entry in json.loads((folder / PYTHON).read_text())["files"].items():
            s = entry["summary"]
            counts[_inside(root, name)] = Count(
                s["num_statements"],
                s["covered_lines"],
                s.get("num_branches", 0),
                s.get("covered_branches", 0),
            )
    if (folder / NATIVE).exists():
        for entry in json.loads((folder / NATIVE).read_text())["files"]:
            counts[_inside(root, entry["filename"])] = Count(
                entry["line_total"], entry["line_covered"], entry["branch_total"], entry["branch_covered"]
            )
    hashes = folder / SOURCES
    return Coverage(counts, json.loads(hashes.read_text()) if hashes.exists() else {})


def _inside(root: Path, name: str) -> Path:
    path = Path(name)
    return path.relative_to(root) if path.is_absolute() else path
