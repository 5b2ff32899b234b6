"""The whole tree counted: a row for each language of a top folder and for each room of the host."""

from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from tools.coverage_data import Count, Coverage, read_coverage
from tools.duplicates import Pair, find_duplicates
from tools.layout import HOST, TOPS, Group, files_below, group_of, top_under_test
from tools.native_source import is_public_header, read_native
from tools.python_source import read_python
from tools.source import Function, Source, median_length

MAX_LENGTH, MAX_PARAMETERS, MAX_FILE, MAX_FOLDER = 60, 6, 600, 15

Value = float | str | None
"""A figure; None where there is nothing to count; a text where it could not be measured."""


@dataclass
class Tree:
    """All that was read."""

    root: Path
    sources: dict[Group, list[Source]]
    tests: dict[tuple[str, str], int]
    """Code lines of tests by (top folder, room)."""
    test_sources: list[Source]
    folders: Counter[Path]
    """Files directly in each folder."""
    duplicates: list[Pair]
    coverage: Coverage


@dataclass
class Row:
    """The figures of one row, by column."""

    name: str
    values: dict[str, Value] = field(default_factory=dict)


def read_tree(root: Path) -> Tree:
    """Reads every file of code and tests below `root`."""
    files = files_below(root)
    groups = {path: group for path in files if (group := group_of(path)) is not None}
    with_include = {group.top for path, group in groups.items() if "include" in path.parts}
    sources: dict[Group, list[Source]] = defaultdict(list)
    for path, group in groups.items():
        sources[group].append(read_source(root, path, group.top in with_include))
    tests: Counter[tuple[str, str]] = Counter()
    test_sources = []
    for path in files:
        if "tests" in path.parts and (top := top_under_test(path, _text(root / path))) is not None:
            test = read_source(root, path, top_has_include=True)
            tests[top] += len(test.code)
            test_sources.append(test)
    return Tree(
        root,
        dict(sorted(sources.items(), key=lambda item: _order(item[0]))),
        tests,
        test_sources,
        Counter(path.parent for path in files if path.parent != Path()),
        find_duplicates(s for group in sources.values() for s in group),
        read_coverage(root),
    )


def _order(group: Group) -> tuple[int, str, str]:
    return TOPS.index(group.top), group.language, group.room


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace")


def read_source(root: Path, path: Path, top_has_include: bool = True) -> Source:
    """One file: its functions, code lines and public names."""
    if path.suffix == ".py":
        return read_python(root, path)
    return read_native(root, path, is_public_header(path, top_has_include))


def rows(tree: Tree) -> list[Row]:
    """The table. The host has a row for all of it and one for each room."""
    found = []
    host = [s for g, sources in tree.sources.items() if g.top == HOST for s in sources]
    host_listed = False
    for group, sources in tree.sources.items():
        if group.top == HOST and not host_listed:
            host_listed = True
            n_tests = sum(n for (top, _), n in tree.tests.items() if top == HOST)
            found.append(Row("host Python", _figures(tree, host, n_tests)))
        found.append(Row(str(group), _figures(tree, sources, _test_lines(tree, group))))
    not_asked = dict.fromkeys(("documented", "parameters named", "lines covered", "branches covered"))
    found.append(Row("tests", _figures(tree, tree.test_sources, None) | not_asked))
    return found


def _test_lines(tree: Tree, group: Group) -> int | None:
    """Tests of a room, or of a top folder in whichever language; None for one of several languages.

    Tests of a top folder do not tell its languages apart: they count for the language of most of its code.
    """
    if group.top == HOST:
        return tree.tests.get((HOST, group.room), 0)
    lines = {
        g.language: sum(len(s.code) for s in tree.sources[g]) for g in tree.sources if g.top == group.top
    }
    return tree.tests.get((group.top, ""), 0) if max(lines, key=lines.__getitem__) == group.language else None


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _figures(tree: Tree, sources: list[Source], n_test_lines: int | None) -> dict[str, Value]:
    functions = [f for s in sources for f in s.functions]
    public = [p for s in sources for p in s.public]
    asked = [p for p in public if p.names_parameters is not None]
    n_code = sum(len(s.code) for s in sources)
    covered = tree.coverage.of(tree.root, [s.path for s in sources if s.code])
    own = {s.path for s in sources}
    sizes = {s.path.parent: tree.folders[s.path.parent] for s in sources}
    return {
        "files": len(sources),
        "code lines": n_code,
        "functions": len(functions),
        "median length": median_length(functions),
        f"over {MAX_LENGTH}": _share(sum(f.n_lines > MAX_LENGTH for f in functions), len(functions)),
        "longest": max((f.n_lines for f in functions), default=None),
        f"over {MAX_PARAMETERS} parameters": sum(f.n_parameters > MAX_PARAMETERS for f in functions),
        "documented": _share(sum(p.documented for p in public), len(public)),
        "parameters named": _share(sum(bool(p.names_parameters) for p in asked), len(asked)),
        "test:code": None if n_test_lines is None else _share(n_test_lines, n_code),
        "lines covered": _covered(covered, lambda c: _share(c.n_lines_hit, c.n_lines)),
        "branches covered": _covered(covered, lambda c: _share(c.n_branches_hit, c.n_branches)),
        "duplicates": sum(p.one.path in own or p.other.path in own for p in tree.duplicates),
        "largest folder": max(sizes.values(), default=None),
        f"folders over {MAX_FOLDER}": sum(n > MAX_FOLDER for n in sizes.values()),
        f"files over {MAX_FILE}": sum(s.n_lines > MAX_FILE for s in sources),
    }


def _covered(count: Count | str, share: Callable[[Count], float | None]) -> Value:
    return count if isinstance(count, str) else share(count)


def offenders(tree: Tree) -> dict[str, list[str]]:
    """What is above a limit, by name."""
    code = [s for sources in tree.sources.values() for s in sources]

    def named(fits: Callable[[Function], bool], n: Callable[[Function], int]) -> list[str]:
        every = [
            (n(f), f"{s.path.as_posix()}:{f.line} {f.name}") for s in code for f in s.functions if fits(f)
        ]
        return [f"{text} ({count})" for count, text in sorted(every, key=lambda e: (-e[0], e[1]))]

    return {
        f"functions over {MAX_LENGTH} lines": named(lambda f: f.n_lines > MAX_LENGTH, lambda f: f.n_lines),
        f"functions over {MAX_PARAMETERS} parameters": named(
            lambda f: f.n_parameters > MAX_PARAMETERS, lambda f: f.n_parameters
        ),
        "undocumented": [f"{s.path}:{p.line} {p.name}" for s in code for p in s.public if not p.documented],
        "parameters not named": [
            f"{s.path}:{p.line} {p.name}" for s in code for p in s.public if p.names_parameters is False
        ],
        "duplicates": [f"{p.one} = {p.other} ({p.n_lines} lines)" for p in tree.duplicates],
        f"folders over {MAX_FOLDER} files": [
            f"{path.as_posix()} ({n})" for path, n in tree.folders.most_common() if n > MAX_FOLDER
        ],
        "files with functions, in no measurement of coverage": [
            f"{s.path.as_posix()} ({len(s.functions)})"
            for s in code
            if s.functions and s.path not in tree.coverage.counts
        ],
        f"files over {MAX_FILE} lines": [
            f"{s.path} ({s.n_lines})" for s in (*code, *tree.test_sources) if s.n_lines > MAX_FILE
        ],
    }
