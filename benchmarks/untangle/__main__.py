"""Fields taken apart after collisions and stops: how many, how long it takes, and what touches anew.

    python -m benchmarks.untangle [--positioners 37 61] [--seeds 100] [--kinds "two arms" knot ...]
    python -m benchmarks.untangle --twin [--positioners 37] [--seeds 20]
    python -m benchmarks.untangle --stops 1000 --off 0.1 0.3 [--positioners 127] [--real]

Collisions: each seed is a random field in which one positioner (two for a knot) moved from a false place
until it met something. `--twin`: it happens on the twin, and the firmware carries the stages out.
`--stops`: plans from A to B are stopped at random moments, ten each. At a `stop` all are where they were
planned to be; if they are `displaced`, each is up to --off deg from there, and it is known.

`untangle` plans from there to the folded array; every stage is verified again. New contacts are looked for
where the arms really are: each is up to --off deg from where it is said to be, on both axes, and the bodies
have their own radius, 1.5 mm, instead of the buffer's 2.0. Bodies that touch at the start may only part. On
the twin, new contacts are those that it has seen itself.

`--out DIR` keeps each result there as soon as it is known. Run again, it goes on where it was stopped;
results of another build are not mixed. Exit code 1 where something is not freed, not verified or touches
anew, or does not fold after a stop; 2: bad input.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from fiberloom.errors import InputError
from fiberloom.planning import PlanSettings
from fiberloom.planning.crashes import KINDS

from ..planning.builds import claim
from .judge import HEAD, Case, Judged, Results, line
from .starts import REAL, STOPS, after_crash, after_stop, on_twin

_EVERY_S = 60.0
"""Between two lines of progress."""


def main() -> int:
    """Run what the command line asks for."""
    given = arguments()
    try:
        if given.out:
            claim(given.out, f"stopped with {given.in_hand:g} mm in hand" if given.stops else "collided")
        results = Results(given.out and given.out / "results.jsonl")
        return 0 if run(given, results) else 1
    except (InputError, FileNotFoundError) as error:
        print(error, file=sys.stderr)
        return 2


def run(given: argparse.Namespace, results: Results) -> bool:
    """Every case, and a row of the table for those with the same array, start and error."""
    print(HEAD, flush=True)
    good = True
    for array in [f"hexagon {n}" for n in given.positioners] + [REAL] * given.real:
        for start in starts(given):
            for off_deg in given.off:
                cases = [Case(array, start, off_deg, seed) for seed in seeds(given)]
                rows = tried(cases, given, results)
                print(line(rows), flush=True)
                good &= all(judged.good for _, judged in rows)
    return good


def tried(cases: list[Case], given: argparse.Namespace, results: Results) -> list[tuple[Case, Judged]]:
    """Cases that are known already are not tried again."""
    told = time.monotonic()
    for k, case in enumerate(cases):
        if case not in results.known:
            results.add(case, one(case, given))
        if not results.known[case].good:
            print(f"{case}: {results.known[case]}", file=sys.stderr, flush=True)
        if time.monotonic() - told > _EVERY_S:
            told = time.monotonic()
            print(f"{k + 1} of {len(cases)}: {case}", file=sys.stderr, flush=True)
    return [(case, results.known[case]) for case in cases]


def one(case: Case, given: argparse.Namespace) -> Judged:
    """One collision or stop."""
    if given.stops:
        return after_stop(case, given.in_hand)
    return on_twin(case) if given.twin else after_crash(case)


def starts(given: argparse.Namespace) -> list[str]:
    """Kinds that are asked for."""
    if given.stops:
        return [kind for kind in STOPS if given.kinds is None or kind in given.kinds]
    kinds = [kind for kind in KINDS if given.kinds is None or kind in given.kinds]
    return [f"twin {kind}" for kind in kinds] if given.twin else kinds


def seeds(given: argparse.Namespace) -> range:
    """Those asked for."""
    return range(given.first, given.first + (given.stops or given.seeds))


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.untangle",
        description=__doc__,
        formatter_class=argparse.RawTextHelpFormatter,
    )
    parser.add_argument("--positioners", type=int, nargs="*", default=[37, 61], help="of generated arrays")
    parser.add_argument("--real", action="store_true", help="the array of Apache Point too")
    parser.add_argument("--seeds", type=int, default=100, help="collisions of each kind")
    parser.add_argument("--first", type=int, default=0, help="seed")
    parser.add_argument("--kinds", nargs="+", choices=(*KINDS, *STOPS), help="all if left out")
    parser.add_argument("--off", type=float, nargs="+", default=[0.1], help="deg by which angles are wrong")
    parser.add_argument("--twin", action="store_true", help="collide and untangle on the twin")
    parser.add_argument("--stops", type=int, default=0, help="stops of each kind, instead of collisions")
    parser.add_argument(
        "--in-hand", type=float, default=PlanSettings().in_hand_mm, help="mm, of plans that are stopped"
    )
    parser.add_argument("--out", type=Path, help="folder of results")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
