"""What the motors take: heat, energy and current of a move and of a blocked rotor, for each set of motors.

    python -m benchmarks.motors [--units 8] [--out FILE.json]

Measured on the twin's units as drawn, their mean: a move of 3 s (32.2 deg, up to 2000 rpm) up and down in
closed loop, in open loop at the full voltage and (paper) two thirds and half of it; a rotor that is blocked
at full voltage. Beside the mean, what a formula says of the same units without spring and cogging (P =
T^2/K_M^2; friction, drag and inertia of a trapezoid of 840 rad/s^2), and what was predicted before there
was a measurement: copper and supply J, peak copper W, mean mA, of the nominal motor. The supply is ideal
and gives to motors only.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from fiberloom.blocking import finish
from fiberloom.bus import Client
from fiberloom.bus.protocol import Command
from fiberloom.bus.trace import push
from fiberloom.instruments import FocalPlane, generate, load_instrument
from fiberloom.twin import Fault, Twin, TwinTransport, draw_units
from fiberloom.twin.motors.power import MotorPower, power_of_scope, power_of_torque
from fiberloom.twin.motors.sets import MOTOR_SETS
from fiberloom.twin.units import Units
from fiberloom.typing import Floats, Records
from fiberloom.units import AXES, TICK_S

OPEN_LOOP = (Command.ALPHA_OPEN_LOOP_COLLISION_DETECTION, Command.BETA_OPEN_LOOP_COLLISION_DETECTION)
SPEED_RAD_S, ACCELERATION, MOVE_S = 2000.0 * np.pi / 30.0, 840.0, 3.0
START_DEG = (150.0, 60.0)
PREDICTED = {
    ("alpha", "paper", "move, closed loop"): "0.037, 0.084, 0.015, 2.6",
    ("alpha", "paper", "move, open loop, 100 %"): "1.37, 1.42, 0.51, 40",
    ("alpha", "paper", "move, open loop, 67 %"): "0.53, 0.57, 0.23, 16",
    ("alpha", "paper", "move, open loop, 50 %"): "0.23, 0.28, 0.13, 8",
    ("alpha", "paper", "blocked, 1 s"): "-, -, 0.51, 42",
    ("beta", "6mm", "move, closed loop"): "-, 0.007, -, -",
}
"""Integrated by hand from the nominal motor, 3 s, before the twin was asked."""
Row = dict[str, float | str]
Axis = tuple[int, str]


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--units", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    print(
        "| axis | set | what | copper J | supply J | peak copper W | mean mA | peak mA | at V | predicted |"
    )
    print("|---|---|---|--:|--:|--:|--:|--:|--:|---|")
    rows = []
    for axis, axis_name in enumerate(AXES):
        for name, motor in MOTOR_SETS.items():
            if axis_name in motor.axes:
                rows += of_set((axis, name), asked.units, asked.seed)
    if asked.out:
        asked.out.write_text(json.dumps(rows, indent=2) + "\n")
    return 0


def of_set(which: Axis, units: int, seed: int) -> list[Row]:
    """All rows of one set, printed."""
    out = [row_of(which, "move, closed loop", moves(which, units, seed, 0.0))]
    for share in (1.0, 2.0 / 3.0, 0.5) if which[1] == "paper" else (1.0,):
        what = f"move, open loop, {100.0 * share:.0f} %"
        out.append(row_of(which, what, moves(which, units, seed, share)))
    out.append(row_of(which, "move, by the formula", by_formula(bench(which, units, seed)[1], which[0])))
    out.append(row_of(which, "blocked, 1 s", blocked(which, units, seed)))
    return out


def row_of(which: Axis, what: str, found: list[MotorPower]) -> Row:
    """The mean of some, printed."""
    mean_A, peak_A = np.mean([f.current_A for f in found], axis=0)
    figures = {
        "copper_J": float(np.mean([f.copper_J for f in found])),
        "supply_J": float(np.mean([f.supply_J for f in found])),
        "peak_copper_W": float(np.mean([f.copper_W.max() for f in found])),
        "mean_mA": 1e3 * float(mean_A),
        "peak_mA": 1e3 * float(peak_A),
        "supply_V": float(np.mean([f.supply_V for f in found])),
    }
    cells = " | ".join(f"{value:.3g}" for value in figures.values())
    said = PREDICTED.get((AXES[which[0]], which[1], what), "")
    print(f"| {AXES[which[0]]} | {which[1]} | {what} | {cells} | {said} |", flush=True)
    return {"axis": AXES[which[0]], "set": which[1], "what": what, **figures}


def bench(which: Axis, units: int, seed: int) -> tuple[FocalPlane, Units]:
    """Units with this motor in one of their axes."""
    twin = {AXES[which[0]]: {"motor": which[1]}}
    instrument = load_instrument("sdssv").model_copy(update={"twin": twin})
    plane = generate(instrument, seed, n_positioners=units)
    return plane, draw_units(plane, seed)


def moves(which: Axis, units: int, seed: int, open_share: float) -> list[MotorPower]:
    """A move up and one down of each unit; in open loop with this share of the voltage, 0: closed."""
    axis = which[0]
    plane, drawn = bench(which, units, seed)
    if open_share:
        drawn.firmware["open_loop_voltage"][:, axis] = open_share
    twin = Twin(plane, drawn, seed=seed, neighbours=False, start_deg=START_DEG)
    way_deg = np.rad2deg(SPEED_RAD_S) / 1024.0 * (MOVE_S - SPEED_RAD_S / ACCELERATION)
    return finish(go(twin, drawn, axis, way_deg, open_share > 0.0))


async def go(twin: Twin, drawn: Units, axis: int, way_deg: float, open_loop: bool) -> list[MotorPower]:
    """Powers of all moves."""
    client = Client(TwinTransport(twin))
    await client.discover()
    ids = [int(p) for p in twin.plane.positioner_id]
    if open_loop:
        await client.command(OPEN_LOOP[axis], ids)
    status = np.full((2,), START_DEG)
    out = []
    for way in (way_deg, -way_deg):
        scopes = [twin.scope(row, axis) for row in range(len(ids))]
        goal = status + way * (np.arange(2) == axis)
        await client.goto(ids, goal[0], goal[1])
        await client.sleep(MOVE_S + 1.0)
        out += [power_of_scope(cut(s.take()), drawn.plant[row, axis]) for row, s in enumerate(scopes)]
        status = goal
    return out


def cut(log: Records) -> Records:
    """From the first tick with a voltage to the last."""
    on = np.flatnonzero(log["voltage"])
    return log[max(on[0] - 1, 0) : on[-1] + 2]


def blocked(which: Axis, units: int, seed: int) -> list[MotorPower]:
    """A push at full voltage against a rotor that cannot turn, 0.2 s, five times as long."""
    axis = which[0]
    plane, drawn = bench(which, units, seed)
    twin = Twin(plane, drawn, seed=seed, neighbours=False, start_deg=START_DEG)
    return finish(pushed(twin, drawn, axis))


async def pushed(twin: Twin, drawn: Units, axis: int) -> list[MotorPower]:
    """Powers of the pushes."""
    client = Client(TwinTransport(twin))
    await client.discover()
    ids = [int(p) for p in twin.plane.positioner_id]
    for p in ids:
        twin.inject(Fault("blocked", p, AXES[axis]))
    scopes = [twin.scope(row, axis) for row in range(len(ids))]
    await push(client, ids, axis, (1.0, 1.0), (0.1, 0.1))
    await client.sleep(0.5)
    found = [power_of_scope(cut(s.take()), drawn.plant[row, axis]) for row, s in enumerate(scopes)]
    return [as_long_as(f, 1.0) for f in found]


def as_long_as(found: MotorPower, time_s: float) -> MotorPower:
    """The same, steady, for this time."""
    many = round(time_s / TICK_S)
    steady = [np.full(many, np.median(w)) for w in (found.copper_W, found.supply_W, found.shaft_W)]
    return MotorPower(*steady, found.supply_V, TICK_S)


def by_formula(drawn: Units, axis: int) -> list[MotorPower]:
    """A trapezoid in closed loop against friction, drag and inertia, of each unit."""
    time = np.arange(0.0, MOVE_S, TICK_S)
    speed: Floats = np.minimum(np.minimum(time, MOVE_S - time) * ACCELERATION, SPEED_RAD_S)
    rate = ACCELERATION * np.sign(MOVE_S / 2.0 - time) * (speed < SPEED_RAD_S)
    return [
        power_of_torque(
            plant["coulomb_motor"] + plant["coulomb_gear"]
            + (plant["viscous_motor"] + plant["viscous_gear"]) * speed
            + (plant["inertia_motor"] + plant["inertia_gear"]) * rate,
            speed, plant, TICK_S,
        )
        for plant in drawn.plant[:, axis]
    ]  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
