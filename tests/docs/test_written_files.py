"""docs/files.md names every file that the package writes, and every command."""

import ast
import re
from pathlib import Path

from tools.pages import commands

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "files.md").read_text()
FILE = re.compile(r"[\w./*-]+\.(?:json|ecsv|csv|png|html|npz|sqlite|fits|md|toml)")
NAMED = sorted({word for code in re.findall(r"`([^`\n]+)`", TEXT) for word in FILE.findall(code)})
READ = {
    *("positionerTable.csv", "wokCoords.csv", "fiducialCoords.csv", "gfaCoords.csv"),  # layouts of SDSS-V
    *("calib-*.csv", "pfs_*_cobras_scalars.csv", "*megara*rps.csv"),  # of DESI, PFS and MEGARA
    "pfs_2394_cobras_scalars.csv",  # beside a summary of motor maps
    "*.toml",  # presets
    "image.fits",  # temporary, of an INDI camera
    *("coverage.png", "efficiency.png", "gear.png", "spring.png"),  # temporary, inside the page of a design
    "maps.npz",  # of the learnt maps beside it, where no file of maps was given
}
"""Files that the package reads, or that it does not keep."""
WHOLE = {"*.fits": "exposure-NN.fits", "*-*.png": "exposure-NN-image.png"}
"""Names of which the code shows too little to be looked for."""


def pattern(node):
    """The name of a file as an expression: `*` for what is not known; None where it is no name."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(pattern(v) if isinstance(v, ast.Constant) else "*" for v in node.values)
    return None


def joined(tree):
    """Expressions that may name a file: after the slash of a path, assigned, returned, in a dict."""
    for node in ast.walk(tree):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div):
            yield node.right
        elif isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            yield from node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
        elif isinstance(node, ast.Dict):
            yield from node.values
        elif isinstance(node, ast.Return) and node.value is not None:
            yield node.value
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "Path":
            yield from node.args


def files_of(tree):
    """Names of files in a module."""
    names = {name for node in joined(tree) if (name := pattern(node)) and FILE.fullmatch(name)}
    return {name.rpartition("/")[2] for name in names}


def written():
    """Every name of a file in the package that is not only read."""
    found = set()
    for path in (ROOT / "src" / "fiberloom").rglob("*.py"):
        found |= files_of(ast.parse(path.read_text()))
    return found - READ


def is_named(name):
    """Does the page name it? `*` is a word in capitals there: ID, NAME, KEY."""
    if name in WHOLE:
        return WHOLE[name] in NAMED
    wanted = re.compile(re.sub(r"\\\*", r"[A-Z_]+", re.escape(name)))
    return any(wanted.fullmatch(said.rpartition("/")[2]) for said in NAMED)


def test_every_file_is_named():
    found = written()
    assert len(found) > 25
    assert {"summary.json", "fibres.ecsv", "commissioning-*.html", "goal.csv"} <= found
    assert sorted(name for name in found if not is_named(name)) == []


def test_every_command_is_in_the_table():
    rows = re.findall(r"^\| (`[^|]+) \| [^|]+ \|$", TEXT, re.M)
    cells = " ".join(word for row in rows for word in re.findall(r"`([^`]+)`", row)).split()
    missing = [name for name, _ in commands.commands() if name.split()[1] not in cells]
    assert missing == []
    for name, _ in commands.commands():
        words = name.split()[1:]
        assert words[-1] in cells or words[0] == "exclude", name


def test_the_check_can_fail():
    tree = ast.parse('(out / "nothing.json").write_text(x)\nfile = f"page-{n}.html"\nsay("other.csv")')
    assert files_of(tree) == {"nothing.json", "page-*.html"}
    assert not is_named("nothing.json")
    assert is_named("acceptance-*.html")
    assert not is_named("page-*.html")
