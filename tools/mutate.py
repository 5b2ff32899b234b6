"""Changes the code in small ways and looks whether a test notices: `make mutate`.

    python -m tools.mutate [--only NAME ...] [--sample N] [--seed S] [--skip K] [--match TEXT] [--kind KIND]

Works in copies below build/mutate. A mutant of Python runs the tests that reach its line, the quickest
first, and where these do not notice all tests of its package; every mutant of C is in one build, and an
environment variable chooses. Exit code 1 where a mutant survives that tools/mutants_explained.toml does not
explain, or where an explanation fits no mutant; 2 where the tests fail without any change.
"""

import argparse
import random
import sys
import tomllib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tools.layout import MUTATED, ROOT, Target, files_below
from tools.mutation.python import KINDS, Mutant, mutants_of
from tools.mutation.runs import NativeRuns, PythonRuns, Runs, TestsFail, Verdict

EXPLAINED = Path(__file__).with_name("mutants_explained.toml")
SAMPLE, SEED = 30, 0


@dataclass(frozen=True)
class Result:
    """What became of one mutant."""

    target: str
    mutant: Mutant
    verdict: Verdict


def explanations(path: Path) -> dict[str, str]:
    """Why a mutant may survive, by its key."""
    entries = tomllib.loads(path.read_text(encoding="utf-8")).get("mutant", [])
    return {e["key"]: e["reason"] for e in entries}


def code_of(root: Path, target: Target) -> list[Path]:
    """The files that a target mutates."""
    suffixes = {".py"} if target.language == "Python" else {".c", ".h"}
    files = [f for f in files_below(root) if f.suffix in suffixes]
    return [f for f in files if any(f.is_relative_to(c) for c in target.code)]


def runs_of(root: Path, target: Target) -> Runs:
    """How the mutants of a target are tried."""
    files = code_of(root, target)
    if target.language == "Python":
        return PythonRuns(root, target, [m for f in files for m in mutants_of(root, f)])
    return NativeRuns(root, target, files)


def mutate(runs: Runs, chosen: Sequence[Mutant], seen: Callable[[Result], None]) -> list[Result]:
    """Tries mutants one after the other; `seen` is told of each result."""
    results = []
    runs.prepare()
    try:
        for mutant in chosen:
            results.append(Result(runs.target.name, mutant, runs.try_one(mutant)))
            seen(results[-1])
    finally:
        runs.close()
    return results


def choose(mutants: Sequence[Mutant], n: int, seed: int, match: str = "", kind: str = "") -> list[Mutant]:
    """A sample in the order of the code; all of them where n is 0. `kind`: one of KINDS, or all."""
    fitting = [m for m in mutants if match in m.key and kind in ("", m.kind)]
    if n == 0 or n >= len(fitting):
        return fitting
    picked = sorted(random.Random(seed).sample(range(len(fitting)), n))
    return [fitting[i] for i in picked]


def summary(results: Sequence[Result]) -> str:
    """Killed, survived and timed out, a row for each package."""
    lines = [f"{'':14}{'killed':>8}{'timeouts':>10}{'survived':>10}"]
    for name in dict.fromkeys(r.target for r in results):
        n = Counter(r.verdict for r in results if r.target == name)
        counts = (n[Verdict.KILLED], n[Verdict.TIMEOUT], n[Verdict.SURVIVED])
        lines.append(f"{name:14}{counts[0]:8}{counts[1]:10}{counts[2]:10}")
    return "\n".join(lines)


def judge(results: Sequence[Result], reasons: dict[str, str], every_key: set[str] | None) -> tuple[str, bool]:
    """The text of the survivors, and whether all is well.

    `every_key`: the keys of all mutants there are; None where not all targets were looked at.
    """
    survivors = [r.mutant for r in results if r.verdict is Verdict.SURVIVED]
    unexplained = [m for m in survivors if m.key not in reasons]
    lines = [f"survived, explained: {len(survivors) - len(unexplained)}"]
    lines += [
        f"survived, not explained: {len(unexplained)}",
        *(f"{m}\n    key: {m.key}" for m in unexplained),
    ]
    gone = [] if every_key is None else sorted(set(reasons) - every_key)
    lines += [f"explained, but no such mutant: {key}" for key in gone]
    return "\n".join(lines), not unexplained and not gone


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit codes as the module says."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.mutate", description="mutants that no test notices"
    )
    names = [t.name for t in MUTATED]
    parser.add_argument(
        "--only", nargs="+", choices=names, default=names, metavar="NAME", help=", ".join(names)
    )
    parser.add_argument("--sample", type=int, default=SAMPLE, metavar="N", help="of each package; 0: all")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument(
        "--skip", type=int, default=0, metavar="K", help="the first K of the sample were tried"
    )
    parser.add_argument("--match", default="", metavar="TEXT", help="only mutants whose key contains it")
    parser.add_argument("--kind", default="", choices=KINDS, help="only mutants of this kind")
    given = parser.parse_args(arguments)
    every_key: set[str] = set()
    results: list[Result] = []
    for target in (t for t in MUTATED if t.name in given.only and code_of(ROOT, t)):
        runs = runs_of(ROOT, target)
        every_key |= {m.key for m in runs.mutants}
        chosen = choose(runs.mutants, given.sample, given.seed, given.match, given.kind)[given.skip :]
        print(f"{target.name}: {len(chosen)} of {len(runs.mutants)} mutants", flush=True)
        try:
            results += mutate(runs, chosen, lambda r: print(f"{r.verdict.value:9}{r.mutant.key}", flush=True))
        except TestsFail as failure:
            print(f"mutate: {failure}", file=sys.stderr)
            return 2
    text, well = judge(results, explanations(EXPLAINED), every_key if given.only == names else None)
    print(f"\n{summary(results)}\n\n{text}")
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
