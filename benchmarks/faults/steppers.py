"""What the arrays of steppers do about failures of real life, in one table.

    python -m benchmarks.faults.steppers [--units 60] [--seed 0] [--instrument megara ...]

Each fault is put into the twin of each instrument, and a field is observed. "told" is how many of the units
with the fault the observation names, under which status; "others" is how many of all other units with a
target are within the requirement, by the twin's truth; "code" is the exit code that `observe` would end with.
Exit code 1 where arms touched, or where a fault that can be told was not.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import fiberloom as fl
from fiberloom.cli.options import met
from fiberloom.operation.results.observation import Observation
from fiberloom.targets.generate import random_targets
from fiberloom.twin.steppers.source import StepperSource

INSTRUMENTS = ("megara", "moons", "lamost")
UNSEEN = ("dark",)
"""What an instrument without a camera cannot know."""
TARGETS_PER_UNIT = 3


@dataclass(frozen=True)
class Failure:
    """A line of the table."""

    name: str
    faults: str
    """As of `--faults`."""


FAILURES = (
    Failure("none", ""),
    Failure("lost steps", "slipping=2"),
    Failure("swapped plugs", "swapped=1"),
    Failure("dark fibres", "dark=2"),
    Failure("a motor that does not turn", "dead=2"),
    Failure("deaf units", "deaf=2"),
    Failure("5 % of replies lost", "lost=0.05"),
    Failure("a gateway without power", "busoff=1"),
    Failure("the same, in motion", "busoff=1@{moving_s}"),
)
MOVING_S = {"megara": 75, "moons": 34, "lamost": 75}
"""When arms are on their way to targets, s after the begin: searches of datums come before."""


@dataclass(frozen=True)
class FaultField:
    """How a field went."""

    broken: set[int]
    """Numbers of the units with a fault; of exchanged ones both."""
    named: dict[str, list[int]]
    """By status, as the observation has it."""
    others: int
    """Other units with a target."""
    others_within: int
    contacts: int
    code: int
    blind: bool

    def told(self) -> str:
        """How many of those with a fault are named, and how."""
        if not self.broken:
            return "-"
        how = {kind: len(self.broken & set(ids)) for kind, ids in self.named.items()}
        words = ", ".join(f"{kind} {n}" for kind, n in how.items() if n)
        return f"{self._named()} of {len(self.broken)}" + (f": {words}" if words else "")

    def also(self) -> str:
        """Others that are named: they could not move because of these, or by chance."""
        how = {kind: len(set(ids) - self.broken) for kind, ids in self.named.items()}
        return ", ".join(f"{kind} {n}" for kind, n in how.items() if n) or "-"

    def missed(self, failure: Failure) -> bool:
        """Whether something is wrong here: arms touched, or what can be told was not."""
        hidden = self.blind and failure.faults.split("=")[0] in UNSEEN
        return self.contacts > 0 or (self._named() < len(self.broken) and not hidden)

    def _named(self) -> int:
        return len(self.broken & {number for ids in self.named.values() for number in ids})


def observe(name: str, failure: Failure, units: int, seed: int) -> FaultField:
    """A field of so many `units` of an instrument, with a `failure` in it."""
    plane = fl.FocalPlane.of(name, seed=seed, n=units)
    faults = failure.faults.format(moving_s=MOVING_S[name])
    field = fl.Field.twin(plane, seed=seed, camera="noise", faults=faults)
    with tempfile.TemporaryDirectory() as folder:
        seen = field.run.observe(
            random_targets(plane, TARGETS_PER_UNIT * units, seed=seed + 1), out=Path(folder) / "run"
        )
    assert isinstance(field.source, StepperSource)
    return _found(seen, _broken(field.source))


def _broken(source: StepperSource) -> set[int]:
    """Whom the faults are of; the partner of an exchange too."""
    hit = {one.positioner_id for one in source.schedule} - {0}
    ids = source.plane.positioner_id
    exchanged = {int(n) for n, row in source.bus.row_of.items() if int(ids[row]) != int(n)}
    return {int(n) for n in hit} | exchanged


def _found(seen: Observation, broken: set[int]) -> FaultField:
    summary, plane = seen.summary(), seen.plane
    named = {kind: [int(n) for n in ids] for kind, ids in summary["faults"].items()}
    own = np.isin(plane.positioner_id, list(broken))
    others = (seen.assignment.target >= 0) & ~own
    within = seen.error_um(seen.final) <= seen.requirement_um
    enough = met(
        summary["n_within_requirement"],
        summary["n_assigned"],
        plane.instrument.operation.required_share,
    )
    return FaultField(
        broken,
        named,
        int(others.sum()),
        int((others & within).sum()),
        int(summary["contacts_true"]),
        0 if enough and not summary["collisions_verified"] else 1,
        not plane.instrument.metrology.present,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.faults.steppers", description="failures of arrays of steppers"
    )
    parser.add_argument("--units", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--instrument", nargs="+", choices=INSTRUMENTS, default=list(INSTRUMENTS))
    asked = parser.parse_args(arguments)
    print("| instrument | fault | told | others named | others on target | contacts | code |")
    print("|---|---|---|---|--:|--:|--:|")
    wrong = 0
    for name in asked.instrument:
        for failure in FAILURES:
            found = observe(name, failure, asked.units, asked.seed)
            wrong += found.missed(failure)
            cells = (
                name,
                f"{failure.name} (`{failure.faults}`)".format(moving_s=MOVING_S[name])
                if failure.faults
                else failure.name,
                found.told(),
                found.also(),
                f"{found.others_within} of {found.others}",
                f"{found.contacts}",
                f"{found.code}",
            )
            print("| " + " | ".join(cells) + " |", flush=True)
    if wrong:
        print(
            f"{wrong} lines with contacts, or with a fault that was not told though it can be",
            file=sys.stderr,
        )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
