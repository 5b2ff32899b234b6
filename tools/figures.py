"""The figures of the tree, one table: `make figures`.

    python -m tools.figures [--json FILE] [--list] [--coverage]

What could not be measured says so, with the command that measures it; a figure of code that has changed
since is not shown.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from tools.coverage_data import HOW
from tools.layout import ROOT
from tools.tree import Row, Value, offenders, read_tree, rows

# Columns in three blocks, each as wide as a screen; every block has every row.
BLOCKS = (
    ("files", "code lines", "functions", "median length", "over 60", "longest", "over 6 parameters"),
    ("documented", "parameters named", "test:code", "lines covered", "branches covered"),
    ("duplicates", "largest folder", "folders over 15", "files over 600"),
)
SHARES = {"over 60", "documented", "parameters named", "lines covered", "branches covered"}
LISTED = 10
LEGEND = """\
code lines: no blank, comment or docstring. Length: from the signature to the end, without the docstring.
documented: public functions and classes with a docstring, or a comment directly above in a public header.
parameters named: of public Python functions with four or more, those whose docstring names each one
(commands are left out: their options carry the help).
test:code: code lines of tests for one of code, by the table of tools/layout.py; those of a top folder count
for the language of most of its code. Duplicates: pairs of places with six or more lines alike.
branches of C and C++: those of the source, without exceptions. A line of a template counts once, whatever
types it is compiled for; the kernels of metrology are measured in one copy instead of three."""


def cell(column: str, value: Value) -> str:
    """A figure as it is printed; `-` where there is nothing to count."""
    if value is None:
        return "-"
    if isinstance(value, str):
        return value
    if column in SHARES:
        return f"{100 * value:.1f} %"
    if column == "test:code":
        return f"{value:.2f}"
    return f"{value:.1f}".removesuffix(".0")


def block(table: list[Row], columns: Sequence[str]) -> str:
    """Some columns of the table, aligned."""
    lines = [["", *columns], *([r.name, *(cell(c, r.values[c]) for c in columns)] for r in table)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(columns) + 1)]
    return "\n".join(
        "  ".join(
            [line[0].ljust(widths[0]), *(t.rjust(w) for t, w in zip(line[1:], widths[1:], strict=True))]
        )
        for line in lines
    )


def missing(table: list[Row]) -> list[str]:
    """Lines that say what was not measured, or is stale, and what to do."""
    found = []
    for why in ("not measured", "stale"):
        names = [r.name.strip() for r in table if r.values["lines covered"] == why]
        if names:
            found.append(f"coverage {why} ({HOW}): {', '.join(names)}")
    return found


def report(table: list[Row], listed: dict[str, list[str]], limit: int | None) -> str:
    """All that `make figures` prints; of every list the first `limit` entries."""
    parts = [block(table, columns) for columns in BLOCKS]
    parts.append("\n".join([LEGEND, *missing(table)]))
    for title, entries in listed.items():
        shown = entries if limit is None else entries[:limit]
        more = [f"  ... {len(entries) - len(shown)} more (--list)"] if len(shown) < len(entries) else []
        parts.append("\n".join([f"{title}: {len(entries)}", *(f"  {e}" for e in shown), *more]))
    return "\n\n".join(parts)


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0; 1 where the tests under coverage fail."""
    parser = argparse.ArgumentParser(prog="python -m tools.figures", description="figures of the tree")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the table and the lists as JSON")
    parser.add_argument("--list", action="store_true", help="print the lists in full")
    parser.add_argument("--coverage", action="store_true", help=f"run `{HOW}` first")
    parser.add_argument("--root", type=Path, default=ROOT, help="another tree than this one")
    given = parser.parse_args(arguments)
    root = given.root.resolve()
    if given.coverage and subprocess.run(HOW.split(), cwd=root, check=False).returncode != 0:
        print(f"figures: `{HOW}` failed; above: why", file=sys.stderr)
        return 1
    tree = read_tree(root)
    table, listed = rows(tree), offenders(tree)
    print(report(table, listed, None if given.list else LISTED))
    if given.json is not None:
        content = {"rows": {r.name.strip(): r.values for r in table}, "lists": listed}
        given.json.parent.mkdir(parents=True, exist_ok=True)
        given.json.write_text(json.dumps(content, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
