"""C and C++ counted: code lines, functions, what is documented in public headers. Read with tree-sitter."""

import re
from collections.abc import Iterator
from pathlib import Path

import tree_sitter_cpp
from tree_sitter import Language, Node, Parser

from tools.source import Function, Public, Source

LANGUAGE = Language(tree_sitter_cpp.language())
HEADERS = {".h", ".hpp"}
TYPES = {"class_specifier", "struct_specifier", "union_specifier", "enum_specifier"}
# A declaration is looked for inside of these.
OPEN = {"namespace_definition", "declaration_list", "linkage_specification", "translation_unit"}
FOR_CPLUSPLUS = re.compile(rb"^[ \t]*#[ \t]*ifdef[ \t]+__cplusplus\n(.*?)^[ \t]*#[ \t]*endif", re.M | re.S)
DIRECTIVE = re.compile(rb"^[ \t]*#(?:[^\n\\]|\\.|\\\n)*", re.M)
COMMENT_OR_TEXT = re.compile(r"//[^\n]*|/\*.*?\*/|\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])+'", re.S)


def parse(text: bytes) -> Node:
    """The tree of a file without its preprocessor directives, every byte where it was.

    What is for C++ alone in a header of C is left out too: the parser reads it without a preprocessor.
    """
    text = FOR_CPLUSPLUS.sub(lambda m: _blank(m.group()), text)
    return Parser(LANGUAGE).parse(DIRECTIVE.sub(lambda m: _blank(m.group()), text)).root_node


def _blank(text: bytes) -> bytes:
    return re.sub(rb"[^\n]", b" ", text)


def read_native(root: Path, path: Path, public_header: bool) -> Source:
    """One file of C or C++; `path` is relative to `root`."""
    raw = (root / path).read_bytes()
    text = raw.decode("utf-8")
    tree = parse(raw)
    functions = [_function(n) for n in _walk(tree) if n.type == "function_definition" and _has_body(n)]
    return Source(
        path=path,
        n_lines=len(text.splitlines()),
        code=_code(text),
        functions=[f for f in functions if f.name],
        public=list(_public(tree)) if public_header else [],
    )


def is_public_header(path: Path, top_has_include: bool) -> bool:
    """Headers below an `include` folder; every header of a top folder that has none."""
    return path.suffix in HEADERS and ("include" in path.parts or not top_has_include)


def _code(text: str) -> list[tuple[int, str]]:
    """Lines with something beside comments."""

    def without(match: re.Match[str]) -> str:
        found = match.group()
        return re.sub(r"[^\n]", " ", found) if found.startswith("/") else found

    lines = COMMENT_OR_TEXT.sub(without, text).splitlines()
    return [(row, line.strip()) for row, line in enumerate(lines, 1) if line.strip()]


def _walk(node: Node) -> Iterator[Node]:
    yield node
    for child in node.children:
        yield from _walk(child)


def _has_body(node: Node) -> bool:
    body = node.child_by_field_name("body")
    return body is not None and body.type == "compound_statement"


def _declarator(node: Node | None) -> Node | None:
    """The function declarator below pointers and references; None where no function is declared."""
    while node is not None and node.type != "function_declarator":
        below = node.child_by_field_name("declarator")
        if below is None and node.type == "reference_declarator":
            below = next((c for c in node.named_children if c.type.endswith("declarator")), None)
        node = below
    return node


def _name(declarator: Node) -> str:
    name = declarator.child_by_field_name("declarator")
    # a pointer to a function, `void (*f)(int)`, is data
    if name is None or name.type == "parenthesized_declarator" or name.text is None:
        return ""
    return name.text.decode()


def _n_parameters(declarator: Node) -> int:
    listed = declarator.child_by_field_name("parameters")
    children = [] if listed is None else listed.named_children
    kinds = {"parameter_declaration", "optional_parameter_declaration", "variadic_parameter_declaration"}
    found = [c for c in children if c.type in kinds]
    # `f(void)` has none
    return 0 if len(found) == 1 and found[0].text == b"void" else len(found)


def _function(node: Node) -> Function:
    declarator = _declarator(node.child_by_field_name("declarator"))
    name, n = ("", 0) if declarator is None else (_name(declarator), _n_parameters(declarator))
    first, last = node.start_point.row, node.end_point.row
    return Function(name, first + 1, last - first + 1, n)


def _public(node: Node) -> Iterator[Public]:
    """What a header declares: functions, types with a body, and the functions of their public part."""
    for child in node.named_children:
        if child.type in OPEN:
            if not (child.type == "namespace_definition" and _is_inner(child)):
                yield from _public(child)
        elif child.type != "comment":
            yield from _declared(child, child)


def _is_inner(namespace: Node) -> bool:
    """Unnamed, or called `detail`: not for others."""
    name = namespace.child_by_field_name("name")
    return name is None or (name.text or b"").endswith(b"detail")


def _declared(node: Node, outermost: Node) -> Iterator[Public]:
    if node.type == "template_declaration":
        for child in node.named_children:
            if child.type != "template_parameter_list":
                yield from _declared(child, outermost)
        return
    kind = node if node.type in TYPES else node.child_by_field_name("type")
    if kind is not None and kind.type in TYPES and (body := kind.child_by_field_name("body")) is not None:
        # `typedef struct {...} name`; a member `struct {...} name` is data
        alias = node.child_by_field_name("declarator") if node.type == "type_definition" else None
        name = kind.child_by_field_name("name") or alias
        if name is not None and name.text is not None:
            yield Public(name.text.decode(), outermost.start_point.row + 1, _documented(outermost))
        if kind.type != "enum_specifier":
            yield from _members(body, hidden=kind.type == "class_specifier")
        return
    declarator = _declarator(node.child_by_field_name("declarator"))
    if declarator is not None and (name_text := _name(declarator)) and not _is_given(node, name_text):
        yield Public(name_text, outermost.start_point.row + 1, _documented(outermost))


def _members(body: Node, hidden: bool) -> Iterator[Public]:
    for child in body.named_children:
        if child.type == "access_specifier":
            hidden = child.text != b"public"
        elif not hidden and child.type != "comment":
            yield from _declared(child, child)


def _is_given(node: Node, name: str) -> bool:
    """Destructors, and what the compiler writes (`= default`) or must not (`= delete`)."""
    given = {"default_method_clause", "delete_method_clause"}
    return name.startswith("~") or any(c.type in given for c in node.children)


def _documented(node: Node) -> bool:
    """A comment ends on the line before, or on the same line before it."""
    before = node.prev_sibling
    if before is None or before.type != "comment":
        return False
    starts_line = before.prev_sibling is None or before.prev_sibling.end_point.row < before.start_point.row
    return starts_line and node.start_point.row - before.end_point.row <= 1
