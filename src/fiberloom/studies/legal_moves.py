"""Trials of the firmware's collision watch on the twin: legal moves, and neighbours that meet.

Legal moves must never be taken for a collision; arms that touch must be found soon. Both are questions to
the firmware and the physics alone, so that the bus is spoken to frame by frame here.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fiberloom.bus.identifier import decode, encode
from fiberloom.bus.protocol import Command
from fiberloom.instruments import FocalPlane
from fiberloom.twin.draw import draw_units
from fiberloom.twin.twin import Reply, Twin
from fiberloom.twin.units import Units
from fiberloom.twin.wear import worn
from fiberloom.typing import Floats, Records
from fiberloom.units import COUNTS_PER_DEG, GEAR, TICK_S, deg_to_rad, rpm_to_deg_s

Rng = np.random.Generator

FULL_SPEED_DEG_S = rpm_to_deg_s(2000.0, GEAR)
"""Output speed at 2000 rpm of the motor, deg/s."""
GREASE = (0.5, 2.0)
"""Viscous friction over its nominal value, between a warm and a cold night."""
WirePaths = list[list[tuple[float, float]]]
"""(time_s, wire_deg) of both axes."""
_RANGE_DEG = ((5.0, 355.0), (5.0, 175.0))


def greased(units: Units, rng: Rng) -> Units:
    """The same units at a temperature of their own: viscous friction x0.5 to x2, log-uniform."""
    plant = units.plant.copy()
    factor = np.exp(rng.uniform(np.log(GREASE[0]), np.log(GREASE[1]), (len(units), 1)))
    for name in ("viscous_motor", "viscous_gear"):
        plant[name] *= factor
    return replace(units, plant=plant)


WORN_CYCLES = 100.0
NOISY = (1.0, 2.0)
"""rms noise of the hall channels over the nominal one, assumed."""
WEAK = (0.5, 1.0)
"""Amplitude of one hall channel over the nominal one, as its calibration found it, assumed;"""
FADED = 0.02
"""and up to so much weaker since then, assumed."""


def aged(units: Units, seed: int, rng: Rng) -> Units:
    """The same units: a third worn by up to 100 cycles, a third with noisy hall channels, a third with a weak
    one.

    `seed` draws the wear, `rng` who has what and how much. The firmware knows of the weak channel only what a
    calibration found before it faded further, and nothing of the rest.
    """
    n = len(units)
    kind, channel = rng.integers(0, 3, n), rng.integers(0, 2, n)
    units = worn(units, np.where(kind == 0, rng.uniform(0.0, WORN_CYCLES, n), 0.0), seed)
    plant, firmware = units.plant.copy(), units.firmware.copy()
    plant["hall_noise"] *= np.where(kind == 1, rng.uniform(*NOISY, n), 1.0)[:, None]
    weak, faded = rng.uniform(*WEAK, n), rng.uniform(1.0 - FADED, 1.0, n)
    for k, name in enumerate(("hall_amplitude_a", "hall_amplitude_b")):
        has = (kind == 2) & (channel == k)
        firmware[name] *= np.where(has, weak, 1.0)[:, None]
        plant[name] *= np.where(has, weak * faded, 1.0)[:, None]
    return replace(units, plant=plant, firmware=firmware)


# -- legal moves ----------------------------------------------------------------------------------

MOVES = ("goto", "correction", "zigzag", "crawl", "path", "plan")
"""Kinds of legal moves: a go-to anywhere; a precise one nearby (840 motor degrees back and forth); straight
lines with steps of velocity up to 2000 rpm; slow lines; two or three lines at full speed; the same with their
corners cut, as plans are."""
CUT_S = 0.25
"""For so long a plan that changes its speed goes on with the mean of both."""


@dataclass(frozen=True)
class LegalTrial:
    """What became of the moves of a population."""

    units: int
    moves: int
    kinds: dict[str, int]
    collisions: list[tuple[int, str]]
    """Positioner and kind of every false detection."""
    lost: list[int]
    """Positioners whose count is off by a turn or more from where their motor is."""
    simulated_s: float


def legal_moves(
    plane: FocalPlane, *, moves: int, seed: int, touch: bool = True, threads: int = 2, law: int = 0
) -> LegalTrial:
    """Random legal moves of a `plane` without neighbours, over unit scatter, temperature, wear and noise.

    `moves`: of each positioner, both axes at once; `seed` draws units and moves; `threads` of the twin.
    Without `touch` Eq. 22 watches alone. `law`: the control law of all axes (0 or 1, docs/firmware.md).
    """
    rng = np.random.default_rng([seed, 0x1E6A1])
    units = aged(greased(draw_units(plane, seed), rng), seed, rng)
    units.firmware["law"] = law
    if not touch:
        units.firmware["contact_torque"] = units.firmware["touch_torque"] = 0.0
    start = np.column_stack([rng.uniform(*limits, len(plane)) for limits in _RANGE_DEG])
    twin = Twin(plane, units, seed=seed, threads=threads, neighbours=False, start_deg=start)
    kinds, collisions, at = dict.fromkeys(MOVES, 0), [], start
    for _ in range(moves):
        chosen = rng.choice(MOVES, len(plane))
        paths = [_path(kind, where, rng) for kind, where in zip(chosen, at, strict=True)]
        hit = _collided(_carry_out(twin, paths, chosen, at))
        at = np.array([[axis[-1][1] for axis in path] for path in paths])
        collisions += [(i, str(chosen[plane.index_of(i)])) for i in hit]
        if hit:
            _send_all(twin, Command.STOP_TRAJECTORY)
            rows = [int(plane.index_of(i)) for i in hit]
            at[rows] = np.clip(twin.truth()[rows], *np.transpose(_RANGE_DEG))
        for kind in chosen:
            kinds[kind] += 1
    return LegalTrial(len(plane), moves * len(plane), kinds, collisions, miscounted(twin), twin.time_s)


def miscounted(twin: Twin) -> list[int]:
    """Positioners at rest that report (32) another place than that of their gear.

    What is reported is the motor angle at which the move settled: the gear's, and up to the backlash more
    after a move upwards. Half a motor turn either way is allowed for the rest.
    """
    twin.send([(encode(int(i), Command.GET_ACTUAL_POSITION, 1), b"") for i in twin.plane.positioner_id])
    asked = [r for r in twin.run(TICK_S) if decode(r.id).command == Command.GET_ACTUAL_POSITION]
    told = {decode(r.id).positioner: struct.unpack("<ii", r.data) for r in asked}
    truth, wrong = twin.truth(), []
    for row, number in enumerate(twin.plane.positioner_id):
        for axis in (0, 1):
            gear_deg, backlash_deg = twin.units.transmission(row, axis, truth[row, axis])
            above = told[int(number)][axis] / COUNTS_PER_DEG * GEAR - gear_deg[0] * GEAR
            if not -180.0 < above < backlash_deg[0] + 180.0:
                wrong.append(int(number))
    return wrong


def _path(kind: str, at: Floats, rng: Rng) -> WirePaths:
    """(time_s, wire_deg) of both axes; what a go-to takes is its last point alone."""
    if kind == "goto":
        return [[(0.0, rng.uniform(*limits))] for limits in _RANGE_DEG]
    if kind == "correction":
        return [[(0.0, _held(x + rng.normal(0.0, 0.1), k))] for k, x in enumerate(at)]
    if kind == "plan":
        return [_planned(k, x, rng) for k, x in enumerate(at)]
    return [_lines(kind, k, x, rng) for k, x in enumerate(at)]


def _held(angle_deg: float, axis: int) -> float:
    return float(np.clip(angle_deg, *_RANGE_DEG[axis]))


def _lines(kind: str, axis: int, from_deg: float, rng: Rng) -> list[tuple[float, float]]:
    pieces, longest_s = {"zigzag": (12, 0.4), "crawl": (6, 0.6), "path": (3, 4.0)}[kind]
    points = [(0.1, float(from_deg))]
    for _ in range(rng.integers(2, pieces + 1)):
        way_s = rng.uniform(0.1, longest_s)
        top = FULL_SPEED_DEG_S * (10.0 ** rng.uniform(-3.0, -0.3) if kind == "crawl" else 1.0)
        speed = top * (rng.choice([-1.0, 1.0]) if kind == "path" else rng.uniform(-1.0, 1.0))
        points.append((points[-1][0] + way_s, _held(points[-1][1] + speed * way_s, axis)))
    return points


def _planned(axis: int, from_deg: float, rng: Rng) -> list[tuple[float, float]]:
    """Lines at full speed, or at rest, with cut corners, from rest to rest; within the travel."""
    points = [(0.1, float(from_deg)), (0.2, float(from_deg))]
    for _ in range(rng.integers(1, 4)):
        points = _with_lines(points, axis, rng)
    return points


def _with_lines(points: list[tuple[float, float]], axis: int, rng: Rng) -> list[tuple[float, float]]:
    """A line more, or two one way and then the other, each at full speed and none slower between."""
    shares = [*rng.choice([-1.0, 1.0], rng.integers(1, 3)), 0.0]
    longer, before = list(points), 0.0
    for share in shares:
        cut = 0.5 * (before + share), CUT_S
        line = (share, rng.uniform(0.05, 3.0)) if share else (0.0, rng.uniform(0.05, 0.5))
        for speed, way_s in (cut, line):
            time_s, here = longer[-1]
            longer.append((time_s + way_s, here + speed * FULL_SPEED_DEG_S * way_s))
        before = share
    low, high = _RANGE_DEG[axis]
    return longer if all(low <= angle <= high for _, angle in longer) else points


def _carry_out(twin: Twin, paths: list[WirePaths], kinds: NDArray[np.str_], before: Floats) -> list[Reply]:
    """One move of every positioner, from its first frame to the last rotor at rest."""
    ids = [int(i) for i in twin.plane.positioner_id]
    precise = {i for i, kind in zip(ids, kinds, strict=True) if kind == "correction"}
    for number in ids:
        for on, off in ((128, 129), (130, 131)):
            twin.send([(encode(number, on if number in precise else off, 1), b"")])
    replies = twin.run(TICK_S)
    replies += upload(twin, {i: p for i, p in zip(ids, paths, strict=True) if len(p[0]) > 1})
    for number, path in zip(ids, paths, strict=True):
        if len(path[0]) == 1:
            replies += go_to(twin, number, [axis[0][1] for axis in path])
    _send_all(twin, Command.START_TRAJECTORY)
    return replies + twin.run(max(_longest_s(path, at) for path, at in zip(paths, before, strict=True)))


def _longest_s(path: WirePaths, from_deg: Floats) -> float:
    """When a move has surely ended: at full speed and 0.25 s to reach it, precise ways and settling."""
    if len(path[0]) > 1:
        return max(axis[-1][0] for axis in path) + 2.0
    ways = [abs(axis[0][1] - x) for axis, x in zip(path, from_deg, strict=True)]
    return float(max(ways)) / FULL_SPEED_DEG_S + 2.0


def go_to(twin: Twin, number: int, wire_deg: list[float]) -> list[Reply]:
    """A go-to of both axes (30); nothing is waited for."""
    counts = [round(x * COUNTS_PER_DEG) for x in wire_deg]
    twin.send([(encode(number, Command.GO_TO_ABSOLUTE_POSITION, 1), struct.pack("<ii", *counts))])
    return []


def upload(twin: Twin, paths: dict[int, WirePaths]) -> list[Reply]:
    """Loads the trajectories of all, a frame of each in every tick: a mailbox holds 16 answers."""
    queues = {number: _trajectory_frames(number, axes) for number, axes in paths.items()}
    replies = []
    while any(queues.values()):
        twin.send([queue.pop(0) for queue in queues.values() if queue])
        replies += twin.run(TICK_S)
    refused = [decode(r.id) for r in replies if decode(r.id).code != 0]
    if refused:
        raise AssertionError(f"a legal trajectory was refused: {refused[0]}")
    return replies


def _trajectory_frames(number: int, axes: WirePaths) -> list[tuple[int, bytes]]:
    frames = [(encode(number, Command.SEND_NEW_TRAJECTORY, 1), struct.pack("<II", *map(len, axes)))]
    for points in axes:
        for time_s, angle_deg in points:
            data = struct.pack("<iI", round(angle_deg * COUNTS_PER_DEG), round(time_s / TICK_S))
            frames.append((encode(number, Command.SEND_TRAJECTORY_DATA, 2), data))
    return [*frames, (encode(number, Command.TRAJECTORY_DATA_END, 3), b"")]


def _send_all(twin: Twin, command: Command) -> None:
    twin.send([(encode(0, command, 0), b"")])


def _collided(replies: list[Reply]) -> dict[int, float]:
    """When each positioner first said that it collided (frame 18)."""
    found: dict[int, float] = {}
    for reply in replies:
        identifier = decode(reply.id)
        if identifier.command == Command.COLLISION_DETECTED:
            found.setdefault(identifier.positioner, reply.time_s)
    return found


# -- what a motor shows of its load ---------------------------------------------------------------


def cruise(plane: FocalPlane, *, axis: int, seed: int, ripple: bool = True) -> Floats:
    """Raw load beyond the model of each unit, every tick of a second at 2000 rpm, Nm: (units, ticks).

    Units and temperatures of a `plane` are drawn from the `seed`; `axis`: 0 alpha, 1 beta. From nothing but
    what the firmware has: J e'' + T - T_ff + c e', differences for derivatives; positive resists. The
    feedforward is that of the last tick's drag, learnt for two seconds before. Without `ripple` what repeats
    with the rotor's turn in that second, orders 1, 2 and 4, is taken off.
    """
    rng = np.random.default_rng([seed, 0xC4])
    units = greased(draw_units(plane, seed), rng)
    start = np.tile([20.0, 20.0], (len(plane), 1))
    twin = Twin(plane, units, seed=seed, threads=1, neighbours=False, start_deg=start)
    for number in plane.positioner_id:
        go_to(twin, int(number), [100.0, 100.0])
    twin.run(3.0)
    scopes = [twin.scope(row, axis) for row in range(len(plane))]
    twin.run(1.0)
    logs = [scope.take() for scope in scopes]
    loads = [_load_Nm(log, units.firmware[row, axis]) for row, log in enumerate(logs)]
    if not ripple:
        loads = [
            load - ripple_of(load, log["motor_rad"][1:-1]) for load, log in zip(loads, logs, strict=True)
        ]
    return np.array(loads)


RIPPLE_ORDERS = (1, 2, 4)
"""Of the rotor's turn, all that cogging and hall sensors have; fl_ripple.h learns 1 and 2."""


def ripple_of(load_Nm: Floats, rotor_rad: Floats) -> Floats:
    """The part of a load (T,) that repeats with the angle of the rotor (T,), by least squares; Nm."""
    waves = [f(order * rotor_rad) for order in RIPPLE_ORDERS for f in (np.sin, np.cos)]
    design = np.column_stack([*waves, np.ones_like(rotor_rad)])
    found = np.linalg.lstsq(design, load_Nm, rcond=None)[0]
    part: Floats = design[:, :-1] @ found[:-1]
    return part


def _load_Nm(log: Records, firmware: Records) -> Floats:
    error = deg_to_rad(log["tracking_deg"])
    torque = log["voltage"] * float(firmware["torque_per_volt"] * firmware["u_dc"])
    beyond = torque - log["feedforward_Nm"]
    bend = (error[2:] - 2.0 * error[1:-1] + error[:-2]) / TICK_S**2
    rate = (error[2:] - error[:-2]) / (2.0 * TICK_S)
    # a torque acts over the tick that follows its sample
    drive = 0.5 * (beyond[1:-1] + beyond[:-2])
    load: Floats = float(firmware["inertia"]) * bend + drive + float(firmware["drag"]) * rate
    return load
