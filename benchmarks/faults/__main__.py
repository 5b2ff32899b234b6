"""The fault campaign: random combinations of faults, and what of them is told, missed, made worse.

    python -m benchmarks.faults --seeds 0:1000 --workers 2 --out runs/faults

Every seed is a deployed field of the twin with one to four kinds of faults, and two `fiberloom observe` one
after the other. Definitions, goals and a table are in docs/twin/faults.md. Run again, it goes on where it was
stopped; `--again 17` does a seed anew and prints its line. Exit code 0: every goal is reached; 1: one is not;
3: none is missed, but too few seeds were run to judge all; 2: bad input; 130: interrupted.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from functools import partial
from pathlib import Path

from .campaign import Campaign, Line, arrays_of, interruptible, observed
from .table import exit_code, seeds_with, table

BAD = ("hang", "crash", "unreadable", "false_good", "false_success", "contacts", "false_flags")


def main() -> int:
    """Runs what the command line asks for."""
    asked = arguments()
    return interruptible(asked.out, partial(run, asked))


def run(asked: argparse.Namespace) -> int:
    """All seeds, then the table."""
    arrays = arrays_of(asked.positioners, asked.out)
    campaign = Campaign(asked.out, partial(observed, arrays), asked.workers, asked.deadline)
    if asked.again:
        return _again(campaign, asked.again)
    lines = list(campaign.run(seeds_of(asked.seeds), _tell).values())
    print("\n".join(table(lines)))
    return exit_code(lines)


def _again(campaign: Campaign, seeds: list[int]) -> int:
    """Elsewhere, so that the file keeps what it has."""
    with tempfile.TemporaryDirectory() as folder:
        other = Campaign(Path(folder), campaign.work, campaign.workers, campaign.deadline_s)
        for line in other.run(seeds).values():
            print(json.dumps(line, indent=1))
    return 0


def _tell(line: Line) -> None:
    missed = [f["kind"] for f in line.get("faults", ()) if f.get("missed")]
    wrong = [name for name in BAD if seeds_with([line], name)] + [f"missed {kind}" for kind in missed]
    kinds = sorted({f["kind"] for f in line.get("faults", ())})
    print(f"seed {line['seed']}: {', '.join(kinds)}{': ' if wrong else ''}{', '.join(wrong)}",
          file=sys.stderr, flush=True)  # fmt: skip


def seeds_of(text: str) -> range:
    """A:B, the first and the one after the last."""
    first, _, after = text.partition(":")
    return range(int(first), int(after))


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.faults", description="fault campaign")
    parser.add_argument("--seeds", default="0:1000", help="A:B: the first, and the one after the last")
    parser.add_argument("--positioners", type=int, default=37)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument(
        "--deadline", type=float, default=300.0, help="s of real time; a seed beyond it hangs"
    )
    parser.add_argument("--again", type=int, nargs="+", help="these seeds only, in full, kept nowhere")
    parser.add_argument("--out", type=Path, default=Path("runs/faults"))
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
