"""Places that share six or more lines, word by word or in shape.

Of the same shape are lines that differ in numbers, in texts and in the names of variables, where one name
always stands for the same other one. Called functions and members must agree: two constructors that store
their arguments, or two lists of options, are no duplicates. Imports and lines of brackets alone are no lines.
"""

import keyword
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from tools.source import Source

N_LINES = 6
MIN_NAMES = 2 * N_LINES  # less is a list of values, not an algorithm
CALLED_ALIKE = 3  # a shape in common says little where nothing in common is called or accessed
COMMON = 40  # a window found in more places is boilerplate of the language; pairs would be without end

TOKEN = re.compile(r"\"(?:\\.|[^\"\\])*\"|'(?:\\.|[^'\\])*'|(?:\.|->|::)?[A-Za-z_]\w*(?:\s*\()?|\d[\w.]*|\S")
NO_LINE = re.compile(r"(from\s.*\simport\s|import\s|#|using\s|[^\w]*$)")
KEPT = set(keyword.kwlist) | {
    "auto", "bool", "break", "case", "char", "class", "const", "constexpr", "double", "else", "enum", "false",
    "float", "for", "if", "inline", "int", "long", "namespace", "new", "return", "sizeof", "static", "struct",
    "switch", "template", "true", "typedef", "unsigned", "void", "while",
}  # fmt: skip


@dataclass(frozen=True)
class Place:
    """Lines of a file, first and last one included."""

    path: Path
    first: int
    last: int

    def __str__(self) -> str:
        return f"{self.path.as_posix()}:{self.first}-{self.last}"


@dataclass(frozen=True)
class Pair:
    """Two places alike."""

    one: Place
    other: Place
    n_lines: int


Line = tuple[int, list[str]]
Spot = tuple[int, int]  # number of the file, index of the line in it


def find_duplicates(sources: Iterable[Source]) -> list[Pair]:
    """Pairs of places, the longest first; overlapping ones are joined."""
    files = list(sources)
    lines = [_lines(s) for s in files]
    places: dict[tuple[str, ...], list[Spot]] = defaultdict(list)
    for number, own in enumerate(lines):
        for at in range(len(own) - N_LINES + 1):
            shape = _shape([tokens for _, tokens in own[at : at + N_LINES]])
            if shape is not None:
                places[shape].append((number, at))
    starts = {pair for spots in places.values() if len(spots) <= COMMON for pair in _pairs(spots)}
    found = [
        Pair(_place(files, lines, one, n), _place(files, lines, other, n), n)
        for one, other, n in _joined(starts)
    ]
    return sorted(found, key=lambda p: (-p.n_lines, str(p.one), str(p.other)))


def _lines(source: Source) -> list[Line]:
    return [(row, TOKEN.findall(text)) for row, text in source.code if not NO_LINE.match(text)]


def _shape(window: list[list[str]]) -> tuple[str, ...] | None:
    """The window with its variables numbered by their first use; None where it holds too little."""
    numbers: dict[str, str] = {}
    shape: list[str] = []
    called, n_names = set(), 0
    for tokens in window:
        for token in tokens:
            if token[0] in "\"'" or token[0].isdigit():
                shape.append("0")
            elif not (token[-1] == "(" and len(token) > 1) and (token[0].isalpha() or token[0] == "_"):
                n_names += token not in KEPT
                shape.append(token if token in KEPT else numbers.setdefault(token, f"v{len(numbers)}"))
            else:
                n_names += len(token) > 2
                called |= {token} if len(token) > 2 else set()
                shape.append(token)
        shape.append("\n")
    return tuple(shape) if n_names >= MIN_NAMES and len(called) >= CALLED_ALIKE else None


def _pairs(spots: list[Spot]) -> Iterator[tuple[Spot, Spot]]:
    for i, one in enumerate(spots):
        for other in spots[i + 1 :]:
            # a place does not repeat itself
            if one[0] != other[0] or other[1] - one[1] >= N_LINES:
                yield one, other


def _joined(starts: set[tuple[Spot, Spot]]) -> Iterator[tuple[Spot, Spot, int]]:
    """Windows that go on in both places, as one; with the number of lines."""
    for one, other in starts:
        if ((one[0], one[1] - 1), (other[0], other[1] - 1)) in starts:
            continue
        n = 0
        while ((one[0], one[1] + n), (other[0], other[1] + n)) in starts:
            n += 1
        yield one, other, n + N_LINES - 1


def _place(files: list[Source], lines: list[list[Line]], spot: Spot, n: int) -> Place:
    number, at = spot
    return Place(files[number].path, lines[number][at][0], lines[number][at + n - 1][0])
