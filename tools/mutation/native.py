"""Mutants of C, all in one build: the compiled program holds every one and acts on that which is chosen.

Each change is an expression that asks for a number: `a - b` becomes `a - FL_SIGN(17) * (b)`, `a < b`
`((a < b) != FL_ON(17))`, `0.5f` `(FL_ON(17) ? 1.5f : 0.5f)`. The environment variable FL_MUTANT chooses
when the program starts; without it nothing is changed, and every value is the same bit for bit.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from tree_sitter import Node

from tools.mutation.python import Mutant, more, numbered
from tools.native_source import DIRECTIVE, parse

COMPARISONS = {"<", ">", "<=", ">=", "==", "!="}
TURNED = {"<": ">=", ">": "<=", "<=": ">", ">=": "<", "==": "!=", "!=": "=="}
SIGNS = {"+": "-", "-": "+", "+=": "-=", "-=": "+="}
# What the compiler must know: no variable may be in it.
FIXED = {"array_declarator", "enumerator", "case_statement", "static_assert_declaration", "bitfield_clause",
         "subscript_designator"}  # fmt: skip
DEFINE = re.compile(rb"^[ \t]*#[ \t]*define[ \t]+(\w+)[ \t]+(?!\()([^\n/]*?)[ \t]*(?:/\*|//|$)", re.M)
DEFINE_IN_PARENTHESES = re.compile(rb"^[ \t]*#[ \t]*define[ \t]+(\w+)[ \t]+(\([^\n/]*/[^\n/]*\))", re.M)
NUMBER = re.compile(rb"(?<![\w.])(\d+\.?\d*(?:e[-+]?\d+)?)([fFuUlL]*)\b(?!\.)")
USE_THAT_MUST_BE_KNOWN = (
    r"(?:\[[^\]\n]*|\bcase\s+|#\s*(?:el)?if\b.*|static_assert\s*\(.*|static\s+const.*)\b{}\b"
)

PRELUDE = """\
#pragma once
#include <stdlib.h>
#ifdef __cplusplus
extern "C" {
#endif
__attribute__((weak, visibility("default"))) int fl_mutant;
__attribute__((constructor)) static void fl_mutant_choose(void) {
    const char *chosen = getenv("FL_MUTANT");
    fl_mutant = chosen ? atoi(chosen) : 0;
}
#ifdef __cplusplus
}
#endif
#define FL_ON(n) (fl_mutant == (n))
#define FL_SIGN(n) (FL_ON(n) ? -1 : 1)
"""


@dataclass(frozen=True)
class Change:
    """One mutant: which bytes become what, as shown, and what is compiled before and after them."""

    start: int
    end: int
    shown: bytes
    opening: str
    closing: str
    at: int
    """Where a reader sees the change."""
    kind: str


def native_mutants(root: Path, path: Path, every_source: Iterable[Path]) -> list[tuple[Mutant, Change]]:
    """Every mutant of a file of C with what compiles to it, in the order of its lines.

    `every_source`: where a macro of this file may be used as something that the compiler must know.
    """
    raw = (root / path).read_bytes()
    uses = "\n".join((root / p).read_text(encoding="utf-8") for p in every_source)
    changes = [(name, c) for name, node in _functions(parse(raw)) for c in _changes(raw, node)]
    changes += [(name, c) for name, c in _defines(raw) if not _must_be_known(name, uses)]
    # by what a reader sees; of equal ranges the outer change comes first, as `schema` wants it
    found = [(_mutant(path, raw, name, c), c) for name, c in sorted(changes, key=lambda item: item[1].at)]
    return list(zip(numbered(m for m, _ in found), (c for _, c in found), strict=True))


def schema(raw: bytes, changes: Iterable[tuple[int, Change]]) -> bytes:
    """The file that holds every change, by its number."""
    inserted: list[tuple[tuple[int, int, int, int], bytes]] = []
    for order, (number, c) in enumerate(changes):
        size = c.end - c.start
        # of those that close at one place the inner closes first; of those that open, the outer opens first
        inserted.append(((c.end, 0, size, -order), c.closing.replace("@", str(number)).encode()))
        inserted.append(((c.start, 1, -size, order), c.opening.replace("@", str(number)).encode()))
    out, last = [], 0
    for (at, *_), new in sorted(inserted):
        out += [raw[last:at], new]
        last = at
    return b"".join([*out, raw[last:]])


def _mutant(path: Path, raw: bytes, name: str, c: Change) -> Mutant:
    text = raw[: c.at] + c.shown + raw[c.at + _width(raw, c) :]
    row = raw.count(b"\n", 0, c.at) + 1
    before, after = (t.splitlines()[row - 1].decode().strip() for t in (raw, text))
    return Mutant(path, row, f"{name}: {before} => {after}", before, after, text, c.kind)


def _width(raw: bytes, c: Change) -> int:
    """Bytes that a reader sees replaced: an operator, or a number."""
    m = re.match(rb"[-+<>=!]+|[\w.]+(?:(?<=[eE])[-+]\w+)?", raw[c.at :])
    return m.end() if m else 0


def _functions(tree: Node) -> Iterator[tuple[str, Node]]:
    for node in _walk(tree):
        if node.type == "function_definition":
            declarator = node.child_by_field_name("declarator")
            body = node.child_by_field_name("body")
            if declarator is not None and body is not None:
                name = re.search(rb"(\w+)\s*\(", declarator.text or b"")
                yield (name.group(1).decode() if name else ""), body


def _walk(node: Node) -> Iterator[Node]:
    yield node
    for child in node.children:
        yield from _walk(child)


def _changes(raw: bytes, node: Node) -> Iterator[Change]:
    if node.type in FIXED or (node.type == "declaration" and (node.text or b"").startswith(b"static")):
        return
    change = _change(raw, node)
    if change is not None:
        yield change
    for child in node.children:
        yield from _changes(raw, child)


def _change(raw: bytes, node: Node) -> Change | None:
    if node.type == "number_literal":
        return _of_number(raw, node.start_byte, node.end_byte)
    operator = node.child_by_field_name("operator")
    if operator is None:
        return None
    sign = (operator.text or b"").decode()
    right = node.child_by_field_name("right")
    if node.type in ("binary_expression", "assignment_expression") and sign in SIGNS and right is not None:
        shown = SIGNS[sign].encode()
        return Change(
            right.start_byte, right.end_byte, shown, "FL_SIGN(@) * (", ")", operator.start_byte, "sign"
        )
    if node.type == "binary_expression" and sign in COMPARISONS:
        shown = TURNED[sign].encode()
        return Change(
            node.start_byte, node.end_byte, shown, "((", ") != FL_ON(@))", operator.start_byte, "comparison"
        )
    if node.type == "unary_expression" and sign in "-!":
        closing = "))" if sign == "-" else ") != FL_ON(@))"
        kind = "sign" if sign == "-" else "condition"
        opening = "(FL_SIGN(@) * (" if sign == "-" else "(("
        return Change(node.start_byte, node.end_byte, b"", opening, closing, operator.start_byte, kind)
    return None


def _of_number(raw: bytes, start: int, end: int) -> Change | None:
    m = NUMBER.fullmatch(raw, start, end)
    if m is None:
        return None
    number, suffix = m.group(1).decode(), m.group(2).decode()
    new = f"{more(float(number) if any(c in number for c in '.e') else int(number))!r}{suffix}"
    return Change(start, end, new.encode(), f"(FL_ON(@) ? {new} : ", ")", start, "number")


def _defines(raw: bytes) -> Iterator[tuple[str, Change]]:
    """The numbers of `#define NAME 0.05f` and `#define NAME (1.0f / 120.0f)`."""
    for directive in DIRECTIVE.finditer(raw):
        text = directive.group()
        m = DEFINE_IN_PARENTHESES.match(text) or DEFINE.match(text)
        if m is None or b"\\" in text:
            continue
        for n in NUMBER.finditer(text, *m.span(2)):
            change = _of_number(raw, directive.start() + n.start(), directive.start() + n.end())
            if change is not None:
                yield m.group(1).decode(), change


def _must_be_known(macro: str, uses: str) -> bool:
    """Whether the macro, or one made of it, is used where the compiler must know its value."""
    if re.search(USE_THAT_MUST_BE_KNOWN.format(re.escape(macro)), uses) is not None:
        return True
    made_of_it = re.findall(rf"^[ \t]*#[ \t]*define[ \t]+(\w+)[ \t]+.*\b{re.escape(macro)}\b", uses, re.M)
    return any(_must_be_known(other, uses) for other in made_of_it if other != macro)
