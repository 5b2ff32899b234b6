"""What is counted of one source file."""

import statistics
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class Function:
    """A function with a body. Its length runs from the signature to the end, without the docstring."""

    name: str
    line: int
    n_lines: int
    n_parameters: int


@dataclass(frozen=True)
class Public:
    """A function or class that others may use, as declared."""

    name: str
    line: int
    documented: bool
    names_parameters: bool | None = None
    """Whether the docstring names every parameter; None where that is not asked for."""


@dataclass
class Source:
    """One file of code."""

    path: Path
    n_lines: int
    code: list[tuple[int, str]]
    """Line number and text of every line that is neither blank, comment nor docstring; comments cut off."""
    functions: list[Function] = field(default_factory=list)
    public: list[Public] = field(default_factory=list)


def median_length(functions: Iterable[Function]) -> float | None:
    """Median length in lines; None where there is no function."""
    lengths = [f.n_lines for f in functions]
    return statistics.median(lengths) if lengths else None
