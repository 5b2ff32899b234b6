"""A small tree with known figures gives exactly these."""

import json
from pathlib import Path

import pytest

from tools import figures, tree
from tools.coverage_data import FOLDER, file_hash
from tools.layout import Group, group_of, top_under_test

ROOM = "src/fiberloom/room"
LOOP = """
def {name}({total}, {values}):
    \"\"\"Sums what is {name}.\"\"\"
    for {x} in {values}.numbers({start}):
        if {x}.good():
            {total} += {x}.weight() * {start}
        else:
            {total} -= {x}.weight() / 2
        {values}.count({total}, {x})
    return {total}
"""


def write(root, path, text):
    target = root / path
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(text)


def long_function(n_lines):
    return "\n".join(["def long():", '    """Counts."""', *["    x = 1  # one"] * (n_lines - 1)]) + "\n"


@pytest.fixture
def root(tmp_path):
    """A folder of 16 files, and in them one of each fault."""
    for i in range(12):
        write(tmp_path, f"{ROOM}/m{i:02}.py", "")
    write(tmp_path, f"{ROOM}/long.py", long_function(61))
    many = ", ".join("abcdefg")
    write(tmp_path, f"{ROOM}/many.py", f"def many({many}):\n    return a\n\n\nclass _Own:\n    pass\n")
    one = LOOP.format(name="here", total="total", values="values", x="x", start=1)
    other = LOOP.format(name="there", total="sum_mm", values="rows", x="row", start=4)
    write(tmp_path, f"{ROOM}/one.py", one)
    write(tmp_path, f"{ROOM}/other.py", other)
    write(tmp_path, "tests/room/test_long.py", "def test_long():\n    # a comment\n\n    assert True\n")
    return tmp_path


def room(root):
    return {r.name.strip(): r.values for r in tree.rows(tree.read_tree(root))}["room"]


def test_a_small_tree_has_exactly_its_figures(root):
    values = room(root)
    # long.py: def and 60 assignments; many.py: def, return, class, pass; the loops: def and seven lines each
    assert values["code lines"] == 61 + 4 + 2 * 8
    assert values["functions"] == 4
    # 61, 2 and twice 8 + 0: the docstrings are not counted
    assert values["longest"] == 61
    assert values["median length"] == 8
    assert values["over 60"] == pytest.approx(1 / 4)
    assert values["over 6 parameters"] == 1
    assert values["documented"] == pytest.approx(3 / 4)
    assert values["parameters named"] == 0
    assert values["test:code"] == pytest.approx(2 / 81)
    assert values["duplicates"] == 1
    assert (values["largest folder"], values["folders over 15"]) == (16, 1)
    assert values["files over 600"] == 0


def test_the_places_are_named(root):
    lists = tree.offenders(tree.read_tree(root))
    assert lists["functions over 60 lines"] == [f"{ROOM}/long.py:1 long (61)"]
    assert lists["functions over 6 parameters"] == [f"{ROOM}/many.py:1 many (7)"]
    assert lists["undocumented"] == [f"{ROOM}/many.py:1 many"]
    assert lists["folders over 15 files"] == [f"{ROOM} (16)"]
    assert lists["duplicates"] == [f"{ROOM}/one.py:4-10 = {ROOM}/other.py:4-10 (7 lines)"]


def test_one_line_and_one_file_less_and_nothing_is_too_large(root):
    write(root, f"{ROOM}/long.py", long_function(60))
    (root / ROOM / "m00.py").unlink()
    values = room(root)
    assert values["over 60"] == 0
    assert values["folders over 15"] == 0


def test_a_name_used_for_two_others_is_no_duplicate(root):
    text = (root / ROOM / "other.py").read_text()
    write(root, f"{ROOM}/other.py", text.replace("row.weight() / 2", "sum_mm.weight() / 2"))
    assert room(root)["duplicates"] == 0


def test_a_file_of_601_lines_is_too_long(root):
    write(root, f"{ROOM}/m01.py", "x = 1\n" * 601)
    assert room(root)["files over 600"] == 1
    write(root, f"{ROOM}/m01.py", "x = 1\n" * 600)
    assert room(root)["files over 600"] == 0


@pytest.mark.parametrize(
    ("doc", "share"),
    [
        ("Adds `a`, `b`, `c` and `d`.", 1.0),
        ("Adds `a`, `b`, `c` and d.", 0.0),
        (
            "Adds.\n\n    Parameters\n    ----------\n    a, b : int\n        mm\n    c\n    *d\n",
            1.0,
        ),
        ("Adds.\n\n    Parameters\n    ----------\n    a, b : int\n        and d\n    c : int\n", 0.0),
        (
            "Adds.\n\n    Parameters\n    ----------\n    a, b, c\n\n    Returns\n    -------\n    d : int\n",
            0.0,
        ),
    ],
)
def test_parameters_are_named_in_backticks_or_in_numpydoc(root, doc, share):
    write(root, f"{ROOM}/many.py", f'def many(self, a, b, c, *d):\n    """{doc}"""\n')
    assert room(root)["parameters named"] == share


def test_a_command_tells_its_parameters_as_options(root):
    write(root, f"{ROOM}/many.py", '@app.command("many")\ndef many(a, b, c, d):\n    """Adds."""\n')
    assert room(root)["parameters named"] is None
    write(root, f"{ROOM}/many.py", '@app.cached("many")\ndef many(a, b, c, d):\n    """Adds."""\n')
    assert room(root)["parameters named"] == 0


HEADER = """\
// The room.
#pragma once
#ifdef __cplusplus
extern "C" {
#endif

// Adds mm. Not the end of an arm.
int add(int a, int b);
int bare(void);

struct Bare {
    // How long.
    double length_mm() const { return 1.0; }
    double other() const;
    int data; // no function
private:
    int own(int a);
};

// A class.
class Full {
    int hidden();
public:
    Full(int a, int b, int c, int d, int e, int f, int g) {}
    Full(const Full &) = delete;
    ~Full();
};
namespace detail { int inner(); }
#ifdef __cplusplus
}
#endif
"""


def test_a_header_counts_what_it_declares(tmp_path):
    write(tmp_path, "core/room/include/room.hpp", HEADER)
    write(tmp_path, "core/room/src/own.hpp", "int not_public();\n")
    write(
        tmp_path, "core/room/src/room.cpp", "/* a\n * comment */\nint add(int a, int b) {\n  return a;\n}\n"
    )
    read = tree.read_tree(tmp_path)
    values = {r.name: r.values for r in tree.rows(read)}["core C++"]
    # documented: add, length_mm, Full; not: bare, Bare, other, the constructor
    assert values["documented"] == pytest.approx(3 / 7)
    assert values["functions"] == 3
    assert values["over 6 parameters"] == 1
    source = next(s for s in read.sources[Group("core", "C++")] if s.path.name == "room.cpp")
    assert [row for row, _ in source.code] == [3, 4, 5]


def measured(root, hits, branches):
    path = f"{ROOM}/long.py"
    summary = {"num_statements": 10, "covered_lines": hits, "num_branches": 4, "covered_branches": branches}
    write(root, FOLDER / "python.json", json.dumps({"files": {path: {"summary": summary}}}))
    files = {p.relative_to(root).as_posix(): file_hash(p) for p in (root / ROOM).iterdir()}
    write(root, FOLDER / "sources.json", json.dumps(files))


def test_coverage_is_a_figure_only_while_the_code_is_what_was_measured(root):
    assert room(root)["lines covered"] == "not measured"
    measured(root, 9, 3)
    values = room(root)
    assert (values["lines covered"], values["branches covered"]) == (0.9, 0.75)
    write(root, f"{ROOM}/m03.py", "x = 1\n")
    measured(root, 9, 3)
    assert room(root)["lines covered"] == 0.9
    write(root, f"{ROOM}/m03.py", "x = 2\n")
    assert room(root)["lines covered"] == "stale"


def test_what_is_not_measured_says_what_to_do(root, capsys):
    assert figures.main(["--root", str(root), "--json", str(root / "out" / "figures.json")]) == 0
    out = capsys.readouterr().out
    assert "coverage not measured (make coverage): host Python, room" in out
    stored = json.loads((root / "out" / "figures.json").read_text())
    assert stored["rows"]["room"]["lines covered"] == "not measured"
    assert stored["lists"]["undocumented"] == [f"{ROOM}/many.py:1 many"]


@pytest.mark.parametrize(
    ("path", "text", "counts_for"),
    [
        ("tests/firmware/test_a.py", "", ("firmware", "")),
        ("firmware/tests/check.c", "", ("firmware", "")),
        ("tests/planning/test_a.py", "from fiberloom._core import planning", ("core", "")),
        ("tests/planning/test_b.py", "import fiberloom", ("src/fiberloom", "planning")),
        ("tests/test_units.py", "", ("src/fiberloom", "")),
        ("src/fiberloom/units.py", "", None),
    ],
)
def test_each_test_counts_once(path, text, counts_for):
    assert top_under_test(Path(path), text) == counts_for
    assert (group_of(Path(path)) is None) == (counts_for is not None)
