"""Mutants of Python: one small change of meaning each, cut into the text so that the rest stays as it is."""

import ast
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

FLIPPED: dict[type[ast.cmpop], tuple[str, str]] = {
    ast.Lt: (r"<", ">="),
    ast.LtE: (r"<=", ">"),
    ast.Gt: (r">", "<="),
    ast.GtE: (r">=", "<"),
    ast.Eq: (r"==", "!="),
    ast.NotEq: (r"!=", "=="),
    ast.Is: (r"\bis\b", "is not"),
    ast.IsNot: (r"\bis\s+not\b", "is"),
    ast.In: (r"\bin\b", "not in"),
    ast.NotIn: (r"\bnot\s+in\b", "in"),
}
# Where a whole number bounds a comparison, one more or less is a case of its own.
BOUNDS: dict[type[ast.cmpop], tuple[str, str]] = {
    ast.Lt: (r"<", "<="),
    ast.LtE: (r"<=", "<"),
    ast.Gt: (r">", ">="),
    ast.GtE: (r">=", ">"),
}
KINDS = ("sign", "comparison", "condition", "number")
SIGNS: dict[type[ast.operator], tuple[str, str]] = {ast.Add: (r"\+", "-"), ast.Sub: (r"-", "+")}


@dataclass(frozen=True)
class Mutant:
    """A change at one place of a file."""

    path: Path
    line: int
    key: str
    """`function: line before => line after`, unmoved by edits elsewhere; `#2` where the same occurs twice."""
    before: str
    after: str
    text: bytes
    """The whole file after the change."""
    kind: str = ""
    """One of KINDS."""

    def __str__(self) -> str:
        return f"{self.path.as_posix()}:{self.line}\n    - {self.before}\n    + {self.after}"


@dataclass(frozen=True)
class Edit:
    """Bytes of a file to be replaced."""

    start: int
    end: int
    new: bytes
    kind: str


class _Text:
    """A file, and where its nodes begin and end in bytes."""

    def __init__(self, raw: bytes) -> None:
        self.raw = raw
        self._starts = [0]
        for line in raw.splitlines(keepends=True):
            self._starts.append(self._starts[-1] + len(line))

    def start(self, node: ast.expr) -> int:
        return self._starts[node.lineno - 1] + node.col_offset

    def end(self, node: ast.expr) -> int:
        return self._starts[(node.end_lineno or node.lineno) - 1] + (node.end_col_offset or 0)

    def row(self, at: int) -> int:
        return self.raw.count(b"\n", 0, at) + 1

    def between(self, left: ast.expr, right: ast.expr, change: tuple[str, str], kind: str) -> Iterator[Edit]:
        """Replaces the operator between two operands."""
        pattern, new = change
        first, last = self.end(left), self.start(right)
        if (m := re.search(pattern.encode(), self.raw[first:last])) is not None:
            yield Edit(first + m.start(), first + m.end(), new.encode(), kind)

    def around(self, node: ast.expr, before: str, after: str) -> Edit:
        first, last = self.start(node), self.end(node)
        return Edit(first, last, before.encode() + self.raw[first:last] + after.encode(), "condition")


def mutants_of(root: Path, path: Path) -> list[Mutant]:
    """Every mutant of a file, in the order of its lines; `path` is relative to `root`."""
    text = _Text((root / path).read_bytes())
    found = []
    for function, node in _acting(ast.parse(text.raw), ""):
        for edit in _edits(text, node):
            mutant = _mutant(path, text, function, edit)
            if mutant is not None:
                found.append(mutant)
    return numbered(sorted(found, key=lambda m: (m.line, m.key, m.after)))


def numbered(mutants: Iterable[Mutant]) -> list[Mutant]:
    """Gives the second and later mutants of the same key a number."""
    seen: Counter[str] = Counter()
    out = []
    for m in mutants:
        seen[m.key] += 1
        key = m.key if seen[m.key] == 1 else f"{m.key} #{seen[m.key]}"
        out.append(replace(m, key=key))
    return out


def _mutant(path: Path, text: _Text, function: str, edit: Edit) -> Mutant | None:
    raw = text.raw[: edit.start] + edit.new + text.raw[edit.end :]
    row = text.row(edit.start)
    try:
        ast.parse(raw)
    except SyntaxError:
        return None
    before, after = (t.splitlines()[row - 1].decode().strip() for t in (text.raw, raw))
    return Mutant(path, row, f"{function}: {before} => {after}", before, after, raw, edit.kind)


def _acting(node: ast.AST, function: str) -> Iterator[tuple[str, ast.AST]]:
    """Nodes that act when the program runs, with the function they are in: no annotation, no decorator."""
    inner = function
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        inner = f"{function}.{node.name}".lstrip(".")
    yield inner, node
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list"):
            continue
        # what an error says is not mutated
        if isinstance(node, ast.Raise):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from _acting(child, inner)


def _edits(text: _Text, node: ast.AST) -> Iterator[Edit]:
    if isinstance(node, ast.Compare):
        yield from _of_compare(text, node)
    elif isinstance(node, ast.BinOp) and type(node.op) in SIGNS:
        yield from text.between(node.left, node.right, SIGNS[type(node.op)], "sign")
    elif isinstance(node, ast.AugAssign) and type(node.op) in SIGNS:
        yield from text.between(node.target, node.value, SIGNS[type(node.op)], "sign")
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        kind = "condition" if isinstance(node.op, ast.Not) else "sign"
        yield Edit(text.start(node), text.start(node.operand), b"", kind)
    elif isinstance(node, ast.BoolOp):
        change = (r"\band\b", "or") if isinstance(node.op, ast.And) else (r"\bor\b", "and")
        for left, right in zip(node.values, node.values[1:], strict=False):
            yield from text.between(left, right, change, "condition")
    elif isinstance(node, ast.If | ast.While | ast.IfExp) and _is_plain(node.test):
        yield text.around(node.test, "not (", ")")
    elif isinstance(node, ast.Constant) and (number := _number(node)) is not None:
        yield Edit(text.start(node), text.end(node), repr(more(number)).encode(), "number")


def _number(node: ast.Constant) -> int | float | None:
    value = node.value
    return value if isinstance(value, int | float) and not isinstance(value, bool) else None


def more(number: int | float) -> int | float:
    """One more; of a broken number beyond ten twice as much, for one more is lost in tolerances."""
    return 2 * number if isinstance(number, float) and abs(number) > 10.0 else number + 1


def _of_compare(text: _Text, node: ast.Compare) -> Iterator[Edit]:
    operands = [node.left, *node.comparators]
    for left, op, right in zip(operands, node.ops, operands[1:], strict=False):
        yield from text.between(left, right, FLIPPED[type(op)], "comparison")
        whole = any(isinstance(x, ast.Constant) and type(x.value) is int for x in (left, right))
        if whole and type(op) in BOUNDS:
            yield from text.between(left, right, BOUNDS[type(op)], "comparison")


def _is_plain(test: ast.expr) -> bool:
    """A condition that no other mutant turns round."""
    return not isinstance(test, ast.Compare | ast.BoolOp | ast.UnaryOp)
