"""`fiberloom observe` with every unit of each instrument of Table 1, one after the other, in one table.

    python -m benchmarks.instruments.full [--seed 0] [--seeds 1] [--instrument pfs ...] [--out runs/full]

Targets are those of `examples/make_targets.py`, three for each unit; the command has no options but
instrument and seed, so moves, images and camera are those of the instrument's file. A row is kept beside its
results with the digest of the code; the same command again makes only rows that this code has not made. With
several `--seeds` in a row each row tells its seed, and below the table is how many have met, by instrument.
Exit code 0: every row is met; 1: one is not; 2: bad input; 130: interrupted.

Met is a row whose healthy fibres with a target are all within the requirement, in the twin's truth, where no
arm touched another, the exit code of `observe` is 0, and CPU time and memory keep the bounds.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from fiberloom.instruments import load_instrument
from fiberloom.version import code_digest
from fiberloom.wholefile import whole

INSTRUMENTS = ("lamost", "megara", "desi", "sdssv", "moons", "pfs")
"""As Table 1 of Kronig 2020 has them; COBRA is pfs."""
TARGETS_PER_UNIT = 3
MOST_CPU_S = 600.0
MOST_GIB = 8.0
KIB_PER_GIB = 2**20
TARGETS_MAKER = Path(__file__).resolve().parents[2] / "examples" / "make_targets.py"
COLUMNS = (
    *("instrument", "units", "with a target", "healthy within", "of all", "worst", "moves"),
    *("named", "CPU", "memory", "contacts", "code", ""),
)
HEAD, RULE = (f"| {' | '.join(cells)} |" for cells in (COLUMNS, len(COLUMNS) * ["---"]))


@dataclass(frozen=True)
class FullField:
    """How a field of all units went, as `observe` has it in summary.json."""

    instrument: str
    units: int
    assigned: int
    healthy: int
    """With a target, and no fault at the end."""
    within: int
    """Of these, in truth."""
    requirement_um: float
    worst_um: float | None
    """Of the healthy, in truth; None: none is healthy."""
    moves: int
    named: int
    """With a target, and a fault that is told."""
    left_out: int
    """Without one, since their calibration does not count on them."""
    cpu_s: float
    memory_gib: float
    contacts: int
    code: int

    @property
    def missed(self) -> list[str]:
        """What is not as it should be, in words."""
        found = {
            f"{self.healthy - self.within} of the healthy beyond {self.requirement_um:g} um": self.within
            < self.healthy,
            "contacts": self.contacts > 0,
            f"exit code {self.code}": self.code != 0,
            f"more than {MOST_CPU_S:g} CPU s": self.cpu_s > MOST_CPU_S,
            f"more than {MOST_GIB:g} GiB": self.memory_gib > MOST_GIB,
            "no fibre was observed": self.healthy == 0,
        }
        return [words for words, is_so in found.items() if is_so]

    def line(self, seed: int | None = None) -> str:
        """Of the table; `seed`: to be told."""
        cells = (
            self.instrument if seed is None else f"{self.instrument}, seed {seed}",
            f"{self.units}",
            f"{self.assigned}" + (f", {self.left_out} left out" if self.left_out else ""),
            f"{self.within} of {self.healthy}",
            f"{100.0 * self.within / max(self.assigned, 1):.2f} %",
            "-" if self.worst_um is None else f"{self.worst_um:.2f} of {self.requirement_um:g} um",
            f"{self.moves}",
            f"{self.named}",
            f"{self.cpu_s:.0f} s",
            f"{self.memory_gib:.2f} GiB",
            f"{self.contacts}",
            f"{self.code}",
            "MISSED: " + ", ".join(self.missed) if self.missed else "met",
        )
        return "| " + " | ".join(cells) + " |"


def command(name: str, seed: int, targets: Path, out: Path) -> list[str]:
    """What an operator would type, for a list of `targets` and a folder `out`."""
    typed = ["observe", str(targets), "--instrument", name, "--seed", str(seed), "--out", str(out)]
    return [sys.executable, "-m", "fiberloom.cli", *typed]


def field_of(name: str, summary: dict[str, Any], cpu_s: float, memory_gib: float, code: int) -> FullField:
    """A row of what `observe` says in its `summary`, with what it took and its exit `code`."""
    moves = [move for move in summary["moves"] if not move["comparison"]]
    last = moves[-1]
    return FullField(
        instrument=name,
        units=summary["n_positioners"],
        assigned=summary["n_assigned"],
        healthy=last["n_fibres"],
        within=last["n_within_requirement"],
        requirement_um=summary["requirement_um"],
        worst_um=last["max_um"],
        moves=len(moves),
        named=summary["n_assigned"] - last["n_fibres"],
        left_out=len(summary.get("left_out", {})),
        cpu_s=cpu_s,
        memory_gib=memory_gib,
        contacts=summary["contacts_true"],
        code=code,
    )


def observe(name: str, seed: int, folder: Path) -> FullField | str:
    """Makes the targets and runs the command; in words where one of them left nothing to go by."""
    targets, out = folder / f"{name}-{seed}.csv", folder / f"{name}-{seed}"
    units = load_instrument(name).layout.n_positioners
    n = TARGETS_PER_UNIT * units
    made = [sys.executable, str(TARGETS_MAKER), str(targets), "--instrument", name]
    if code := subprocess.run([*made, "--n", str(n), "--seed", str(seed)]).returncode:
        return f"{TARGETS_MAKER.name} ended with {code}"
    (out / "summary.json").unlink(missing_ok=True)
    log = folder / f"{name}-{seed}.log"
    with (
        log.open("wb") as said,
        subprocess.Popen(command(name, seed, targets, out), stdout=said, stderr=said) as run,
    ):
        # of this child alone, where getrusage would have the most of all before
        _, status, used = os.wait4(run.pid, 0)
        run.returncode = code = os.waitstatus_to_exitcode(status)
    try:
        summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return f"ended with {code} and left no summary; its words are in {log}"
    return field_of(name, summary, used.ru_utime + used.ru_stime, used.ru_maxrss / KIB_PER_GIB, code)


def kept(file: Path) -> FullField | None:
    """A row that this code has made; None: there is none."""
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
        return FullField(**found["row"]) if found["code"] == code_digest() else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def row(name: str, seed: int, folder: Path, fresh: bool) -> FullField | str:
    """Kept, or made now and kept."""
    file = folder / f"{name}-{seed}.json"
    found = None if fresh else kept(file)
    if found is not None:
        return found
    print(f"{name}: observing", file=sys.stderr, flush=True)
    made = observe(name, seed, folder)
    if isinstance(made, FullField):
        with whole(file, folders=True) as part:
            part.write_text(json.dumps({"code": code_digest(), "row": asdict(made)}), encoding="utf-8")
    return made


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.instruments.full", description="observe with all units of each instrument"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=1, help="how many in a row, from --seed on")
    parser.add_argument("--instrument", nargs="+", choices=INSTRUMENTS, default=list(INSTRUMENTS))
    parser.add_argument("--out", type=Path, default=Path("runs/full"))
    parser.add_argument("--fresh", action="store_true", help="make rows anew that are there")
    asked = parser.parse_args(arguments)
    if asked.seeds < 1:
        parser.error(f"--seeds {asked.seeds}: must be 1 or more")
    asked.out.mkdir(parents=True, exist_ok=True)
    seeds = range(asked.seed, asked.seed + asked.seeds)
    print("\n".join((HEAD, RULE)), flush=True)
    try:
        met = {name: _met(name, seeds, asked.out, asked.fresh) for name in asked.instrument}
    except KeyboardInterrupt:
        print(f"interrupted; rows are kept in {asked.out}: run the same again", file=sys.stderr)
        return 130
    if len(seeds) > 1:
        print(
            "\n" + "\n".join(f"{name}: met by {count} of {len(seeds)} seeds" for name, count in met.items())
        )
    return 1 if min(met.values()) < len(seeds) else 0


def _met(name: str, seeds: range, folder: Path, fresh: bool) -> int:
    """Prints the rows of an instrument; how many of the `seeds` have met."""
    met = 0
    for seed in seeds:
        found, told = row(name, seed, folder, fresh), seed if len(seeds) > 1 else None
        if isinstance(found, str):
            named = name if told is None else f"{name}, seed {seed}"
            print(f"| {named} | not made: {found} |", flush=True)
        else:
            print(found.line(told), flush=True)
            met += not found.missed
    return met


if __name__ == "__main__":
    sys.exit(main())
