"""Nothing declared and unread: each field of the instrument's tables has a reader outside the model.

Readers are found in the source: attributes of objects whose table is known from an annotation (of an
argument, or of the function that returned it), from the chain of names
(`plane.instrument.operation.stop_rule`), or from a local variable that holds such a chain.
A property of a table counts as a reader of its fields when it is read itself; a validator does not.
"""

import ast
import types
import typing
from collections.abc import Iterator
from pathlib import Path

import fiberloom
from fiberloom.instruments import model
from fiberloom.instruments.model import Instrument, Table

PACKAGE = Path(fiberloom.__file__).parent
MODELS = [PACKAGE / "instruments" / name for name in ("model.py", "array.py", "axis.py", "outlines.py")]
MODELS += [PACKAGE / "instruments" / "telescope" / "tables.py"]

TABLES = {
    name: cls
    for name, cls in vars(model).items()
    if isinstance(cls, type) and issubclass(cls, Table) and cls is not Table
}

READ_AS_A_WHOLE = {
    ("Instrument", "description"): "shown by `fiberloom instruments NAME`, which prints all fields",
    ("Instrument", "reference"): "the same: where the numbers come from",
} | {
    (table, "kind"): "tells the tables of optics apart while a file is read"
    for table in TABLES
    if table.endswith("Optics")
}
"""Fields that generic code reads (model_dump): text for people, which nothing acts on."""

Seen = set[tuple[str, str]]


class Kind(typing.NamedTuple):
    """What is known of an expression: a table, or a sequence or mapping of tables."""

    table: str
    shape: str = "one"


def kind_of(annotation: object) -> Kind | None:
    """The table in a type: T, T | None, tuple[T, ...], dict[str, T]."""
    if isinstance(annotation, type) and annotation.__name__ in TABLES:
        return Kind(annotation.__name__)
    origin, args = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (typing.Union, types.UnionType, typing.Annotated):
        return next(filter(None, map(kind_of, args)), None)
    if origin in (tuple, list, dict):
        inner = next((kind for kind in map(kind_of, args) if kind), None)
        return inner and Kind(inner.table, "map" if origin is dict else "many")
    return None


def attribute(table: str, name: str) -> Kind | None:
    """What an attribute of a table is."""
    cls = TABLES[table]
    if name in cls.model_fields:
        return kind_of(cls.model_fields[name].annotation)
    getter = getattr(getattr(cls, name, None), "fget", None)
    return getter and kind_of(typing.get_type_hints(getter).get("return"))


class Reader(ast.NodeVisitor):
    """Notes (table, attribute) of every attribute that is read in a piece of source."""

    def __init__(
        self,
        tables: set[str] = frozenset(TABLES),
        known: dict[str, Kind] | None = None,
        returned: dict[str, Kind] | None = None,
    ) -> None:
        """`tables`: names that mean tables of the model here; `returned`: what functions give."""
        self.tables, self.known, self.returned = tables, dict(known or {}), dict(returned or {})
        self.seen: Seen = set()

    # what an expression is

    def infer(self, node: ast.AST | None) -> Kind | None:
        match node:
            case ast.Name(id=name):
                return self.known.get(name)
            case ast.Attribute(value=value, attr=name):
                base = self.infer(value)
                if base and base.shape == "one":
                    return attribute(base.table, name)
                return Kind("Instrument") if name == "instrument" else None
            case ast.Subscript(value=value):
                base = self.infer(value)
                return base and Kind(base.table)
            case ast.Tuple(elts=elts) | ast.List(elts=elts):
                kinds = {self.infer(e) for e in elts}
                one = kinds.pop() if len(kinds) == 1 else None
                return one and Kind(one.table, "many")
            case ast.BoolOp(values=values):
                return next(filter(None, map(self.infer, values)), None)
            case ast.Call():
                return self._call(node)
        return None

    def _call(self, node: ast.Call) -> Kind | None:
        match node.func:
            case ast.Name(id=name) if name in self.returned:
                return self.returned[name]
            case ast.Name(id="getattr"):
                base = self.infer(node.args[0])
                found = {attribute(base.table, n) for n in _words(node, base.table)} if base else set()
                return found.pop() if len(found) == 1 else None
            case ast.Attribute(value=value, attr="model_copy"):
                return self.infer(value)
            case ast.Attribute(value=value, attr="values"):
                base = self.infer(value)
                return base and Kind(base.table, "many")
        return None

    # names that get a value

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        outer = dict(self.known)
        for argument in [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]:
            self._bind(argument, annotated(argument.annotation, self.tables))
        self.generic_visit(node)
        self.known = outer

    visit_AsyncFunctionDef = visit_FunctionDef

    def visit_Assign(self, node: ast.Assign) -> None:
        for target in node.targets:
            self._bind(target, self.infer(node.value), node.value)
        self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        self._bind(node.target, annotated(node.annotation, self.tables) or self.infer(node.value))
        self.generic_visit(node)

    def visit_For(self, node: ast.For) -> None:
        self._loop(node.target, node.iter)
        self.generic_visit(node)

    def _comprehension(self, node: ast.AST) -> None:
        outer = dict(self.known)
        for generator in node.generators:
            self._loop(generator.target, generator.iter)
        self.generic_visit(node)
        self.known = outer

    visit_ListComp = visit_SetComp = visit_DictComp = visit_GeneratorExp = _comprehension

    def _loop(self, target: ast.AST, over: ast.AST) -> None:
        match over:
            case ast.Call(func=ast.Name(id="zip"), args=args) if isinstance(target, ast.Tuple):
                for part, source in zip(target.elts, args, strict=False):
                    self._loop(part, source)
            case ast.Call(func=ast.Name(id="enumerate"), args=[source, *_]) if isinstance(target, ast.Tuple):
                self._loop(target.elts[1], source)
            case ast.Call(func=ast.Attribute(value=value, attr="items")) if isinstance(target, ast.Tuple):
                base = self.infer(value)
                self._bind(target.elts[1], base and Kind(base.table))
            case ast.Call(func=ast.Name(id="map"), args=[ast.Name(id=name), *_]):
                self._bind(target, self.returned.get(name))
            case _:
                base = self.infer(over)
                self._bind(target, base and Kind(base.table))

    def _bind(self, target: ast.AST, kind: Kind | None, value: ast.AST | None = None) -> None:
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            for part, source in zip(target.elts, value.elts, strict=True):
                self._bind(part, self.infer(source))
        name = target.arg if isinstance(target, ast.arg) else getattr(target, "id", None)
        if name and kind:
            self.known[name] = kind
        elif name:
            self.known.pop(name, None)

    # reading

    def visit_Attribute(self, node: ast.Attribute) -> None:
        base = self.infer(node.value)
        if base and base.shape == "one" and isinstance(node.ctx, ast.Load):
            self.seen.add((base.table, node.attr))
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        match node.func, node.args:
            case ast.Name(id="getattr"), [first, *_] if (base := self.infer(first)) is not None:
                self.seen |= {(base.table, name) for name in _words(node, base.table)}
        self.generic_visit(node)


def _words(node: ast.Call, table: str) -> set[str]:
    """Fields that getattr(x, name) reads: a literal, else the axes of an instrument."""
    if isinstance(node.args[1], ast.Constant):
        return {node.args[1].value}
    return {"alpha", "beta"} if table == "Instrument" else set()


def annotated(annotation: ast.AST | None, tables: set[str]) -> Kind | None:
    """The table that an annotation names."""
    names = {n.id for n in ast.walk(annotation) if isinstance(n, ast.Name)} if annotation else set()
    named = names & tables
    shape = "map" if "dict" in names else "many" if names & {"tuple", "list", "Sequence"} else "one"
    return Kind(named.pop(), shape) if len(named) == 1 else None


def imported(tree: ast.Module) -> set[str]:
    """Tables of the model that a module knows by name; others have classes of the same name."""
    froms = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    ours = [n for n in froms if n.module in ("fiberloom.instruments", "fiberloom.instruments.model")]
    return {alias.name for n in ours for alias in n.names} & set(TABLES)


def returned(modules: list[ast.Module]) -> dict[str, Kind]:
    """What the functions of the package give, by name, where that is a table."""
    return {
        f.name: kind
        for tree in modules
        for f in tree.body
        if isinstance(f, ast.FunctionDef) and (kind := annotated(f.returns, imported(tree)))
    }


def sources() -> Iterator[ast.Module]:
    """All modules but the model."""
    for path in sorted(PACKAGE.rglob("*.py")):
        if path not in MODELS:
            yield ast.parse(path.read_text())


def read_by(properties: str) -> Seen:
    """(table, field) that a property "Table.name" or a method that it calls reads."""
    table, name = properties.split(".")
    told = [n for path in MODELS for n in ast.parse(path.read_text()).body]
    cls = next(n for n in told if isinstance(n, ast.ClassDef) and n.name == table)
    body = {f.name: f for f in cls.body if isinstance(f, ast.FunctionDef)}
    wanted, done, seen = [name], set(), set()
    while wanted:
        method = wanted.pop()
        if method not in body or method in done:
            continue
        done.add(method)
        reader = Reader(known={"self": Kind(table)})
        for argument in body[method].args.args[1:]:
            reader._bind(argument, annotated(argument.annotation, reader.tables))
        reader.generic_visit(body[method])
        seen |= reader.seen
        wanted += [n for t, n in reader.seen if t == table]
    return seen


def unread(modules: list[ast.Module], tables: dict[str, type[Table]] = TABLES) -> list[str]:
    """Fields of the tables that no module reads."""
    seen: Seen = set(READ_AS_A_WHOLE)
    gives = returned(modules)
    for tree in modules:
        reader = Reader(imported(tree), returned=gives)
        reader.visit(tree)
        seen |= reader.seen
    pending = sorted(seen)
    while pending:
        table, name = pending.pop()
        if table in TABLES and name not in TABLES[table].model_fields:
            pending += sorted(read_by(f"{table}.{name}") - seen)
            seen |= read_by(f"{table}.{name}")
    return [f"{t}.{f}" for t, cls in tables.items() for f in cls.model_fields if (t, f) not in seen]


def test_each_field_of_the_model_is_read_by_something_that_acts_on_it():
    assert unread(list(sources())) == []


def test_a_field_that_nothing_reads_is_found():
    class Operation(model.Operation):
        patience_s: float = 1.0

    assert unread(list(sources()), {"Operation": Operation}) == ["Operation.patience_s"]


def test_readers_are_found_by_chain_by_variable_and_by_annotation_and_no_others():
    def found(text: str) -> Seen:
        reader = Reader()
        reader.visit(ast.parse(text))
        return reader.seen

    assert ("Operation", "stop_rule") in found("plane.instrument.operation.stop_rule")
    assert ("Axis", "gear") in found("axes = (i.instrument.alpha, i.instrument.beta)\n[a.gear for a in axes]")
    assert ("Axis", "step_deg") in found("def f(axis: Axis | None): return axis.step_deg")
    assert ("Scatter", "sd") in found("def f(i: Instrument):\n  s = i.scatter\n  return s.l_alpha_mm.sd")
    assert found("settings.stop_rule\nself.alpha.gear") == set()
    assert found("def f(axis: Axis): axis.gear = 3") == set()


def test_the_list_of_exceptions_is_no_longer_than_needed():
    known = {(t, f) for t, cls in TABLES.items() for f in cls.model_fields}
    assert set(READ_AS_A_WHOLE) <= known
    assert Instrument.model_fields.keys() >= {f for t, f in READ_AS_A_WHOLE if t == "Instrument"}
