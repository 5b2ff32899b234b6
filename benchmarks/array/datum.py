"""How well a datum search repeats: where the rotor comes to stand at the hard stop, and what zero it gives.

    python -m benchmarks.array.datum --units 40 --searches 6

Every unit searches both axes again and again, from other places within some degrees of the stops. The rotor
stands where the wound-up gear, friction and cogging leave it, not at the same angle each time. The firmware
takes the calibrated angle that is nearest: while the rotor stands within half a motor turn of it, the zero is
the same to the noise of the hall sensors; beyond, it is off by a whole turn. Printed for each axis, in motor
degrees: the spread of a unit's standstills (rms, median and worst of the units; the widest), the spread of
its zeros, and how many zeros were whole turns off.
"""

from __future__ import annotations

import argparse
import json
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from fiberloom.bus.identifier import decode, encode
from fiberloom.bus.protocol import Command
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import AXES
from fiberloom.twin import Twin, draw_units
from fiberloom.typing import Floats
from fiberloom.units import COUNTS_PER_DEG

GEAR = 1024.0
NEAR_DEG = (0.0, 9.0)
"""Wire positions from which a search begins; the stops are at -4 deg of the arm."""

GOTO_S, SEARCH_S = 8.0, 15.0


class Units:
    """Units of the twin on a bench."""

    def __init__(self, number: int, seed: int) -> None:
        """`number` of units of SDSS-V, drawn by the `seed`."""
        plane = FocalPlane.of("sdssv", seed=seed, n=number)
        self.ids: list[int] = plane.positioner_id.tolist()
        start = np.full((number, 2), 5.0)
        units = draw_units(plane, seed)
        self.twin = Twin(plane, units, seed=seed, threads=1, neighbours=False, start_deg=start)
        # at the motor, from where the counter is 0
        self.stop_turns: Floats = np.rad2deg(units.plant["stop_min"]) / 360.0 * GEAR

    def ask(self, command: Command, data: Sequence[bytes]) -> dict[int, bytes]:
        """Answers of all units to a `command` with its `data` for each, by number."""
        for number, own in zip(self.ids, data, strict=True):
            self.twin.send([(encode(number, command, 1), own)])
        return {decode(reply.id).positioner: reply.data for reply in self.twin.run(0.01)}

    def goto(self, place_deg: Floats) -> None:
        """All to wire positions (n, 2) in deg."""
        counts = np.rint(place_deg * COUNTS_PER_DEG).astype(int)
        self.ask(Command.GO_TO_ABSOLUTE_POSITION, [struct.pack("<ii", *pair) for pair in counts.tolist()])
        self.twin.run(GOTO_S)

    def search(self) -> tuple[Floats, Floats]:
        """Searches all datums: where the rotors stood at the stops, and the zeros; (n, 2) in motor turns."""
        n = len(self.ids)
        scopes = [[self.twin.scope(row, axis) for axis in (0, 1)] for row in range(n)]
        self.ask(Command.GO_TO_DATUMS, [b""] * n)
        self.twin.run(SEARCH_S)
        seen = [[scope.take() for scope in pair] for pair in scopes]
        for pair in scopes:
            for scope in pair:
                scope.close()
        stood = np.array([[_stood_turns(samples) for samples in pair] for pair in seen])
        rotor = np.array([[samples["motor_rad"][-1] for samples in pair] for pair in seen]) / (2.0 * np.pi)
        answers = self.ask(Command.GET_ACTUAL_POSITION, [b""] * n)
        told = np.array([struct.unpack("<ii", answers[number]) for number in self.ids])
        return stood, told / COUNTS_PER_DEG * GEAR / 360.0 - rotor


def _stood_turns(samples: Any) -> float:
    """Motor turns at the end of the longest time without voltage, before the way back begins."""
    back = np.flatnonzero(samples["voltage"] != 0.0)
    pauses = np.diff(back)
    last = back[int(np.argmax(pauses))] + int(pauses.max()) - 1
    return float(samples["motor_rad"][last] / (2.0 * np.pi))


def measured(units: int, searches: int, seed: int) -> dict[str, dict[str, float]]:
    """The figures of each axis, from so many `units` and `searches` of each, drawn by the `seed`."""
    bench, rng = Units(units, seed), np.random.default_rng(seed)
    stood, zeros = [], []
    for _ in range(searches):
        bench.goto(rng.uniform(*NEAR_DEG, (units, 2)))
        one = bench.search()
        stood.append(one[0])
        zeros.append(one[1])
    return {name: _figures(np.array(stood)[:, :, a], np.array(zeros)[:, :, a]) for a, name in enumerate(AXES)}


def _figures(stood: Floats, zeros: Floats) -> dict[str, float]:
    """Of one axis: `stood` and `zeros` (searches, units) in motor turns."""
    spread = 360.0 * stood.std(axis=0)
    whole = np.rint(zeros)
    return {
        "searches": float(zeros.size),
        "standstill_median_deg": float(np.median(spread)),
        "standstill_worst_deg": float(spread.max()),
        "standstill_range_deg": float(360.0 * np.ptp(stood, axis=0).max()),
        "zero_rms_deg": float(360.0 * (zeros - whole).std(axis=0).max()),
        "turns_off": float((whole != 0.0).sum()),
    }


def main() -> None:
    """Prints the figures; `--json` as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--units", type=int, default=40)
    parser.add_argument("--searches", type=int, default=6, help="of each unit")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = measured(options.units, options.searches, options.seed)
    if options.json:
        print(json.dumps(found, indent=2))
        return
    for name, row in found.items():
        print(
            f"{name:5s} {row['searches']:.0f} searches; motor deg: standstill of a unit "
            f"{row['standstill_median_deg']:.1f} rms (median), {row['standstill_worst_deg']:.1f} (worst), "
            f"within {row['standstill_range_deg']:.0f}; zero {row['zero_rms_deg']:.2f} rms (worst); "
            f"{row['turns_off']:.0f} off by whole turns"
        )


if __name__ == "__main__":
    main()
