"""The version, and digests of the code itself, in a module that imports nothing of the package."""

import functools
import hashlib
from collections.abc import Iterable
from pathlib import Path

__version__ = "0.1.0"


@functools.cache
def code_digest() -> str:
    """16 hex digits that change with any file of the package: Python, compiled core, presets.

    Once for each process: what is edited later is not what runs.
    """
    root = Path(__file__).parent
    return _digest(path for path in root.rglob("*") if path.is_file() and "__pycache__" not in path.parts)


@functools.cache
def core_digest() -> str:
    """16 hex digits that change with the compiled core: firmware, twin and planner.

    Another core is another twin, to the last bits of its motion.
    """
    return _digest(Path(__file__).parent.glob("_core*.so"))


def _digest(files: Iterable[Path]) -> str:
    root = Path(__file__).parent
    found = hashlib.sha256()
    for path in sorted(files):
        found.update(f"{path.relative_to(root).as_posix()}\0".encode())
        found.update(hashlib.sha256(path.read_bytes()).digest())
    return found.hexdigest()[:16]
