"""How closely the control laws follow the ramps of Fig. 16, on units that the firmware knows as commissioned.

    python benchmarks/control.py                      both laws, both axes, nominal and disturbed plants
    python benchmarks/control.py --laws 0 --axes 1    the paper's law on beta alone
    python benchmarks/control.py --moves              time, energy and end of go-to moves, long and short

A unit's error is the largest of commanded minus true motor angle along the whole path, in motor degrees; the
table shows the median and the worst unit. Alarms are off, the drag is not learnt, as in Fig. 16. A disturbed
plant is not that which was commissioned: grease half or twice as stiff, inertia 20 % less or more.
Moves are as shipped, alarms and learning on. Their energy is that of (u/u_dc)^2 over time; their end the true
motor angle beyond the target, in the direction of the way, when the phases go off.
`--out FILE.json` writes what was printed.
"""

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from fiberloom.blocking import finish
from fiberloom.studies.paper.bench import PaperBench, make_bench
from fiberloom.studies.paper.control.fig16_tracking import START_DEG, follow_ramps
from fiberloom.twin import Units
from fiberloom.typing import Records
from fiberloom.units import TICK_S

AXES = ("alpha", "beta")
ALARMS = ("collision_torque", "contact_torque", "touch_torque")
GREASE = ("viscous_motor", "viscous_gear")
INERTIA = ("inertia_motor", "inertia_gear")
PLANTS: dict[str, tuple[tuple[str, ...], float]] = {
    "as commissioned": ((), 1.0),
    "grease x0.5": (GREASE, 0.5),
    "grease x2": (GREASE, 2.0),
    "inertia -20 %": (INERTIA, 0.8),
    "inertia +20 %": (INERTIA, 1.2),
}
Change = Callable[[Units], None]
Row = dict[str, float | str]
KINDS = {"long": (1.0, 12.0), "short": (0.3, 0.5)}
"""Ways of moves, output degrees: short ones cross any backlash."""
MOVES = 8


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--units", type=int, default=24)
    parser.add_argument("--laws", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--axes", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--plants", nargs="+", choices=PLANTS, default=list(PLANTS))
    parser.add_argument("--moves", action="store_true", help="go-to moves instead of the ramps")
    parser.add_argument("--learnt", action="store_true", help="the drag is learnt, as shipped")
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE", help="firmware parameters")
    parser.add_argument("--times", nargs="*", default=[], metavar="NAME=FACTOR", help="the same, multiplied")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    rows = table_of_moves(asked) if asked.moves else table_of_ramps(asked)
    if asked.out:
        asked.out.write_text(json.dumps(rows, indent=2) + "\n")
    return 0


def table_of_ramps(asked: argparse.Namespace) -> list[Row]:
    """Tracking along the ramps, by law, axis and plant."""
    print("| law | axis | plant | largest error, median unit | worst unit | rms | false alarms |")
    print("|--:|---|---|--:|--:|--:|--:|")
    return [
        row_of(asked, law, axis, plant) for law in asked.laws for axis in asked.axes for plant in asked.plants
    ]


def table_of_moves(asked: argparse.Namespace) -> list[Row]:
    """What a move takes and where it ends, by law, plant, kind and axis."""
    print("| law | plant | moves | axis | time, s | energy, ms | end, motor deg: mean | rms about it |")
    print("|--:|---|---|---|--:|--:|--:|--:|")
    return [row for law in asked.laws for plant in asked.plants for row in rows_of_moves(asked, law, plant)]


def rows_of_moves(asked: argparse.Namespace, law: int, plant: str) -> list[Row]:
    """The rows of a law and a plant, printed."""
    asked.learnt = True
    bench = make_bench(asked.seed, asked.units, change=changed(asked, law, plant), start_deg=START_DEG)
    found = finish(go_around(bench, np.random.default_rng(asked.seed)))
    out: list[Row] = []
    for kind in KINDS:
        for axis, name in enumerate(AXES):
            time_s, energy_ms, end = np.array(found[kind, axis]).T
            figures = [time_s.mean(), energy_ms.mean(), end.mean(), end.std()]
            print(f"| {law} | {plant} | {kind} | {name} | " + " | ".join(f"{x:.3f}" for x in figures) + " |")
            out.append({"law": law, "plant": plant, "moves": kind, "axis": name})
            out[-1] |= dict(zip(("time_s", "energy_ms", "end_deg", "end_rms_deg"), figures, strict=True))
    if bench.client.collisions:
        print(f"false collisions: {bench.client.collisions}")
    return out


async def go_around(bench: PaperBench, rng: np.random.Generator) -> dict[tuple[str, int], list[list[float]]]:
    """Go-to moves of both axes of all units: time s, energy ms, end motor deg, by kind and axis."""
    found: dict[tuple[str, int], list[list[float]]] = {(kind, axis): [] for kind in KINDS for axis in (0, 1)}
    at = bench.rest_wire_deg(START_DEG)
    for k in range(MOVES):
        kind = list(KINDS)[k % 2]
        way = rng.choice([-1.0, 1.0], at.shape) * rng.uniform(*KINDS[kind], at.shape)
        at = at + way
        scopes = [[bench.twin.scope(row, axis) for axis in (0, 1)] for row in range(len(bench.ids))]
        await bench.client.goto(bench.ids, at[:, 0], at[:, 1])
        await bench.client.sleep(2.0)
        for row, pair in enumerate(scopes):
            for axis, scope in enumerate(pair):
                found[kind, axis].append(told(scope.take(), float(np.sign(way[row, axis]))))
    return found


def told(log: Records, direction: float) -> list[float]:
    """Time s, energy ms and end motor deg of a move."""
    on = np.flatnonzero(log["voltage"])
    energy_ms = 1e3 * TICK_S * float((log["voltage"] ** 2).sum())
    return [TICK_S * float(on[-1]), energy_ms, -direction * float(log["tracking_deg"][on[-1]])]


def row_of(asked: argparse.Namespace, law: int, axis: int, plant: str) -> Row:
    """One row of the table, printed."""
    bench = make_bench(asked.seed, asked.units, change=changed(asked, law, plant), start_deg=START_DEG)
    seen = finish(follow_ramps(bench, axis))
    worst = np.abs(seen.error_deg).max(axis=1)
    row: Row = {
        "law": law,
        "axis": AXES[axis],
        "plant": plant,
        "median_deg": float(np.median(worst)),
        "worst_deg": float(worst.max()),
        "rms_deg": seen.rms_deg,
        "collisions": seen.collisions,
    }
    figures = f"{row['median_deg']:.2f} | {row['worst_deg']:.2f} | {row['rms_deg']:.3f} | {seen.collisions}"
    print(f"| {law} | {AXES[axis]} | {plant} | {figures} |", flush=True)
    return row


def changed(asked: argparse.Namespace, law: int, plant: str) -> Change:
    """What is done to the units before power-up."""

    def change(units: Units) -> None:
        firmware = units.firmware
        if not asked.learnt:
            firmware["drag_learning_time"] = 0.0
            for alarm in ALARMS:
                firmware[alarm] *= 100.0
        if "law" in (firmware.dtype.names or ()):
            firmware["law"] = law
        for name, value in pairs(asked.set):
            firmware[name] = value
        for name, factor in pairs(asked.times):
            firmware[name] *= factor
        names, factor = PLANTS[plant]
        for name in names:
            units.plant[name] *= factor

    return change


def pairs(words: list[str]) -> list[tuple[str, float]]:
    """NAME=VALUE words."""
    return [(word.split("=")[0], float(word.split("=")[1])) for word in words]


if __name__ == "__main__":
    sys.exit(main())
