"""Packages whose names are imported when they are first used: a command that refuses loads little.

The `__init__` of such a package imports its names below `if TYPE_CHECKING`, where type checkers see them,
and defines `__getattr__ = on_use(__name__)`. A file of the package must not have the name of one of them.
"""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any


def on_use(package: str) -> Callable[[str], Any]:
    """A `__getattr__` for the package, which imports the names that its `__init__` declares."""
    homes = _homes(Path(sys.modules[package].__file__ or "").read_text(encoding="utf-8"))

    def get(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(homes[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    return get


def _homes(source: str) -> dict[str, str]:
    """Names that are imported below an `if`, and the modules that they come from."""
    imports = (
        node
        for block in ast.parse(source).body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
    )
    return {alias.name: node.module or "" for node in imports for alias in node.names}
