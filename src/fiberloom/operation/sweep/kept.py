"""What a sweep has measured so far, in a file: one that was stopped goes on from there.

A file is of one array, one camera and one set of points. Passes are kept in the order in which they were
made; the last one may be partial. It goes on where the same positioners take part as before, else it is begun
anew: a map is not made of two halves with a gap.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fiberloom.errors import InputError, one_line
from fiberloom.files import check_zip
from fiberloom.operation.sweep.ways import ClearWays, SweepPass
from fiberloom.typing import Floats
from fiberloom.wholefile import whole

KEPT = "sweep-part.npz"
"""Name of the file, in the folder of the sweep."""


@dataclass
class KeptPass:
    """One pass as far as it was measured: K points upward, then downward."""

    swept: SweepPass
    ways: ClearWays
    xy_mm: Floats
    """(2, K, N, 2) first index 0 for down and 1 for up; NaN where not seen, or not yet."""
    done: int = 0
    """Points of 2 K."""

    @classmethod
    def begun(cls, swept: SweepPass, ways: ClearWays) -> KeptPass:
        """A pass with nothing measured."""
        return cls(swept, ways, np.full((2, len(swept.points_deg), len(ways.takes), 2), np.nan))

    @property
    def complete(self) -> bool:
        """All points of both directions were measured."""
        return self.done == 2 * len(self.swept.points_deg)

    @property
    def steps(self) -> list[tuple[int, int]]:
        """Direction and point of every step, in order."""
        count = len(self.swept.points_deg)
        return [(1, k) for k in range(count)] + [(0, k) for k in reversed(range(count))]

    def fits(self, swept: SweepPass, ways: ClearWays) -> bool:
        """Whether it is the same pass with the same positioners."""
        return (
            (self.swept.axis, self.swept.rest_deg) == (swept.axis, swept.rest_deg)
            and np.array_equal(self.ways.takes, ways.takes)
            and np.array_equal(self.ways.low_deg, ways.low_deg)
        )

    def begin_deg(self) -> Floats:
        """(N, 2) from where its next step has the contact of its direction: a run-up before that point."""
        direction, k = self.steps[self.done]
        run_up_deg = self.swept.run_up_deg if direction else -self.swept.run_up_deg
        (place_deg,) = self.swept.at(self.swept.points_deg[[k]] - run_up_deg, self.ways.low_deg)
        return np.asarray(place_deg)


@dataclass
class KeptSweep:
    """The passes of one sweep."""

    path: Path | None = None
    """None: nothing is kept."""
    about: Mapping[str, str] = field(default_factory=dict)
    """What it is of: words that have to be the same when it goes on."""
    passes: list[KeptPass] = field(default_factory=list)

    @classmethod
    def open(cls, folder: Path, about: Mapping[str, str]) -> KeptSweep:
        """The partial sweep in a folder; empty where there is none.

        Raises InputError where the one there is of something else, or cannot be read.
        """
        kept = cls(folder / KEPT, about)
        if (folder / KEPT).exists():
            kept.passes = _read(folder / KEPT, about)
        return kept

    @property
    def done(self) -> int:
        """Points that were measured."""
        return sum(p.done for p in self.passes)

    def at(self, number: int) -> KeptPass | None:
        """The pass of this number from 0; None where it was not begun."""
        return self.passes[number] if number < len(self.passes) else None

    def begin(self, number: int, begun: KeptPass) -> None:
        """From now on the pass of this number is this one; what came after it is gone."""
        self.passes[number:] = [begun]

    def save(self) -> None:
        """Writes all. InputError where the disk is full or the folder cannot be written."""
        if self.path is None:
            return
        arrays: dict[str, np.ndarray] = {"about": np.array(json.dumps(dict(self.about)))}
        for i, p in enumerate(self.passes):
            why = json.dumps(p.ways.why)
            head = [p.swept.axis, p.swept.rest_deg, p.swept.run_up_deg, p.done]
            arrays |= {f"head{i}": np.array(head), f"points{i}": p.swept.points_deg, f"xy{i}": p.xy_mm}
            arrays |= {f"takes{i}": p.ways.takes, f"low{i}": p.ways.low_deg, f"why{i}": np.array(why)}
        with whole(self.path) as part:
            np.savez(part, **arrays)  # type: ignore[arg-type]

    def forget(self) -> None:
        """The sweep is finished: the file goes."""
        if self.path is not None:
            with contextlib.suppress(OSError):
                self.path.unlink()


def _read(path: Path, about: Mapping[str, str]) -> list[KeptPass]:
    remedy = "choose another --out, or remove that file to sweep anew"
    try:
        check_zip(path)
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            held = dict(file)
        known = json.loads(str(held["about"]))
        passes = [_pass_of(held, i) for i in range(sum(name.startswith("head") for name in held))]
    except Exception as error:  # numpy, zipfile and zlib raise many kinds for a broken file
        text = one_line(error)
        raise InputError(f"{path}: no partial sweep can be read from it ({text}); {remedy}") from None
    for name, value in about.items():
        if known.get(name) != value:
            raise InputError(
                f"{path}: a sweep that was stopped, with another {name}: {known.get(name)}, now {value}; "
                f"{remedy}"
            )
    return passes


def _pass_of(held: Mapping[str, np.ndarray], i: int) -> KeptPass:
    axis, rest_deg, run_up_deg, done = held[f"head{i}"].tolist()
    swept = SweepPass(int(axis), held[f"points{i}"], rest_deg, run_up_deg)
    why = {int(row): str(text) for row, text in json.loads(str(held[f"why{i}"])).items()}
    ways = ClearWays(held[f"takes{i}"], held[f"low{i}"], why)
    return KeptPass(swept, ways, held[f"xy{i}"], int(done))
