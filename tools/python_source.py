"""Python counted: code lines, functions, what is documented. Read with `ast` and `tokenize`."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

from tools.source import Function, Public, Source

FunctionNode = ast.FunctionDef | ast.AsyncFunctionDef
Scope = FunctionNode | ast.ClassDef | ast.Module
NO_CODE = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}
MANY_PARAMETERS = 4


def read_python(root: Path, path: Path) -> Source:
    """One file of Python; `path` is relative to `root`. SyntaxError where it is none."""
    text = (root / path).read_text(encoding="utf-8")
    tree = ast.parse(text, filename=str(path))
    scopes: list[Scope] = [n for n in ast.walk(tree) if isinstance(n, Scope)]
    functions = [_function(n) for n in scopes if isinstance(n, FunctionNode)]
    return Source(
        path=path,
        n_lines=len(text.splitlines()),
        code=_code(text, scopes),
        functions=sorted(functions, key=lambda f: f.line),
        public=list(_public(tree.body, in_class=False)) if _is_public_module(path) else [],
    )


def _docstring(node: Scope) -> ast.Expr | None:
    if ast.get_docstring(node) is None:
        return None
    first = node.body[0]
    return first if isinstance(first, ast.Expr) else None


def _code(text: str, scopes: list[Scope]) -> list[tuple[int, str]]:
    """Lines with a token that is no comment and no docstring."""
    silent = {
        row
        for node in scopes
        if (doc := _docstring(node)) is not None
        for row in range(doc.lineno, (doc.end_lineno or doc.lineno) + 1)
    }
    lines = text.splitlines()
    rows: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            row, column = token.start
            lines[row - 1] = lines[row - 1][:column]
        elif token.type not in NO_CODE and token.string.strip():
            rows.update(range(token.start[0], token.end[0] + 1))
    return [(row, lines[row - 1].strip()) for row in sorted(rows - silent) if lines[row - 1].strip()]


def _function(node: FunctionNode) -> Function:
    doc = _docstring(node)
    doc_lines = 0 if doc is None else (doc.end_lineno or doc.lineno) - doc.lineno + 1
    last = node.end_lineno or node.lineno
    return Function(node.name, node.lineno, last - node.lineno + 1 - doc_lines, len(parameters(node)))


def parameters(node: FunctionNode) -> list[str]:
    """Names of all parameters, stars included, `self` and `cls` left out."""
    a = node.args
    names = [x.arg for x in (*a.posonlyargs, *a.args)]
    if names and names[0] in ("self", "cls"):
        names = names[1:]
    starred = [x.arg for x in (a.vararg, a.kwarg) if x is not None]
    return names + [x.arg for x in a.kwonlyargs] + starred


def _is_public_module(path: Path) -> bool:
    names = (*path.parts[:-1], path.stem)
    return not any(n.startswith("_") and n != "__init__" for n in names)


def _public(body: list[ast.stmt], in_class: bool) -> Iterator[Public]:
    """Functions and classes of a module without a leading underscore, and the methods of such classes."""
    for node in body:
        if not isinstance(node, FunctionNode | ast.ClassDef) or node.name.startswith("_"):
            continue
        doc = ast.get_docstring(node)
        named = None
        if isinstance(node, FunctionNode) and not _is_command(node):
            names = parameters(node)
            if len(names) >= MANY_PARAMETERS:
                named = doc is not None and all(_names(doc, name) for name in names)
        yield Public(node.name, node.lineno, doc is not None, named)
        if isinstance(node, ast.ClassDef) and not in_class:
            yield from _public(node.body, in_class=True)


def _is_command(node: FunctionNode) -> bool:
    """A command of the command line, `@app.command(...)`: its options carry the help of each parameter."""
    calls = [d.func if isinstance(d, ast.Call) else d for d in node.decorator_list]
    return any(isinstance(c, ast.Attribute) and c.attr in ("command", "callback") for c in calls)


def _names(doc: str, parameter: str) -> bool:
    """In backticks, or as an entry of numpydoc's section `Parameters`."""
    if re.search(rf"`\**{re.escape(parameter)}`", doc):
        return True
    section = re.search(r"^Parameters\n-{3,}\n(.*?)(?=^\S[^\n]*\n-{3,}\n|\Z)", doc, re.M | re.S)
    if section is None:
        return False
    # an entry begins at the margin: `name : type`, `name`, `a, b : type`
    entries = re.findall(r"^(\S[^:\n]*)", section.group(1), re.M)
    return any(parameter in re.split(r"[\s,*]+", entry) for entry in entries)
