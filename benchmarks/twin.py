"""What the twin costs: 1000 axes with the real firmware in the loop, all moving.

    python benchmarks/twin.py [--axes 1000] [--seconds 8] [--scale 500 20000] [--out build/bench/twin.json]

A move of 8 s in parts of half a second: the median part and the slowest one, for what costs more the longer
a motor cruises is no noise. No arms touch, but in the case that says so. In a planned field every positioner
goes its own way from one random place to another, close to its neighbours, and many wait for a while. Slice:
for how many ticks of 0.5 ms groups of positioners run without waiting for each other, on average. CPU time,
because other work on the machine disturbs it less than wall time. The plant takes even steps of 50 us, but in
cases of adaptive ones, which a twin takes unless told otherwise. The real-time factor is simulated seconds
over CPU seconds on one core; with two threads it is over wall seconds, and means something on an idle machine
only; "at best" is that of threads that share the CPU time evenly and always have a core of their own.

Then the same for more axes, in twins of 4000 at most (a bus has 2047 addresses), with the exponent by which
the cost grows; and two peers in the same run, plant only: plain C by gcc, and numba where it is installed
(pip install 'fiberloom[peers]'). Below plain C the least time in which a core of this clock can issue its
arithmetic. The clock is that of a fixed loop on each core, alone and all at once: other work shows there.
"""

import argparse
import json
import os
import platform
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from peers.issue import bound_ns, clocks_GHz

from fiberloom._core import twin as core
from fiberloom.bus.identifier import encode
from fiberloom.bus.trajectory import WireTrajectory
from fiberloom.instruments import generate, load_instrument
from fiberloom.planning import plan, random_configuration
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.twin import ADAPTIVE
from fiberloom.twin.units import plain
from fiberloom.units import COUNTS_PER_DEG
from fiberloom.version import __version__

GOTO, NEW, POINT, END, START = 30, 10, 11, 12, 14

PEERS = Path(__file__).parent / "peers"
PEER_TICKS = 2000
MOST_AXES = 4000
"""Of one twin: positioners of a bus have numbers up to 2047."""
PAPER_POSITIONERS = 100_000
"""Reckoned, not run."""
PART_S = 0.5
NEEDS = "cannot run here: C needs gcc, numba pip install 'fiberloom[peers]'"
EVEN = 10
"""Substeps of the plant in a tick: 50 us, whatever an axis does."""
APART, TOUCHING = (20.0, 178.0), (20.0, 60.0)
"""Where all arms begin, deg: folded, none touches; and 28 overlap."""


class Run(NamedTuple):
    """What a case took."""

    parts_s: np.ndarray
    """(parts, 2): CPU s and wall s of each."""
    slice_ticks: float | None = None
    """Mean length of the slices in which groups of positioners run alone; None where there is no twin."""


def timed(action, repeats):
    """(CPU s, wall s) of each of several calls."""
    out = []
    for _ in range(repeats):
        cpu, wall = time.process_time(), time.perf_counter()
        action()
        out.append((time.process_time() - cpu, time.perf_counter() - wall))
    return np.array(out)


def by_goto(twin, plane):
    """All axes on a long way at 2000 rpm."""
    goal = struct.pack("<ii", int(300 * COUNTS_PER_DEG), int(120 * COUNTS_PER_DEG))
    twin.send((encode(int(i), GOTO, 1), goal) for i in plane.positioner_id)


def by_trajectory(twin, plane):
    """The same at 1900 rpm and back, by a point a second."""
    time_s = np.arange(0.0, 24.0)
    out_deg = 11.0 * np.where(time_s < 12.0, time_s, 23.0 - time_s)
    for number in map(int, plane.positioner_id):
        frames = [(encode(number, NEW, 1), struct.pack("<II", len(time_s), len(time_s)))]
        for start_deg, sign in zip(APART, (1.0, -0.25), strict=True):
            points = np.stack([(start_deg + sign * out_deg) * COUNTS_PER_DEG, time_s / core.TICK_S], axis=1)
            frames += [
                (encode(number, POINT, 1), struct.pack("<iI", *row)) for row in points.astype(int).tolist()
            ]
        twin.send([*frames, (encode(number, END, 1), b"")])
    twin.run(0.1)
    twin.send([(encode(0, START, 0), b"")])


def planned_field(plane, units):
    """Where arms begin, and a move that sends them along a plan to other random places, by the true gears."""
    start_deg = random_configuration(plane, seed=5)
    planned = plan(plane, start_deg, random_configuration(plane, seed=6), seed=1)

    def move(twin, plane):
        for robot in planned.robots:
            twin.send(upload_of(robot, units, int(plane.index_of(robot.positioner_id))))
        twin.run(0.1)
        twin.send([(encode(0, START, 0), b"")])

    return start_deg, move


def upload_of(robot, units, row):
    """Frames of a way of the plan."""
    wire_deg = [units.transmission(row, axis, robot.points_deg[:, axis])[0] for axis in (0, 1)]
    way = WireTrajectory.from_deg(robot.time_s, *wire_deg, (robot.corners(0), robot.corners(1)))
    number = robot.positioner_id
    yield encode(number, NEW, 1), struct.pack("<II", len(way.alpha), len(way.beta))
    for counts, ticks in np.concatenate([way.alpha, way.beta]).tolist():
        yield encode(number, POINT, 1), struct.pack("<iI", counts, ticks)
    yield encode(number, END, 1), b""


def moving(plane, units, seconds, start_deg=APART, move=by_goto, substeps=EVEN, **options):
    """Plant, firmware and, if asked for, neighbours."""
    twin = Twin(plane, units, seed=1, start_deg=start_deg, substeps=substeps, **options)
    move(twin, plane)
    twin.run(0.4)
    ticks, slices = twin._core.tick, twin._core.slices
    parts_s = timed(lambda: twin.run(PART_S), round(seconds / PART_S))
    return Run(parts_s, (twin._core.tick - ticks) / (twin._core.slices - slices))


def plant_only(units, seconds, kernel):
    """The same axes without firmware, coasting at 2000 rpm: no friction, so that they do not stop."""
    params = units.plant.ravel().copy()
    for name in ("coulomb_motor", "coulomb_gear", "viscous_motor", "viscous_gear", "cogging_2"):
        params[name] = 0.0
    params["flux_linkage"], params["coil_resistance"] = 1e-6, 1e3
    n = len(params)
    plant = core.Plant(plain(params), plain(units.gear.ravel()), np.full(n, 0.2), kernel=kernel)
    for axis in range(n):
        theta, _, gear, _ = plant.state(axis)
        plant.set_state(axis, theta, 209.0 * params["inertia_motor"][axis], gear)
    return Run(timed(lambda: plant.advance(round(PART_S / core.TICK_S)), round(seconds / PART_S)))


def idle(plane, units, seconds):
    """Everybody at rest."""
    twin = Twin(plane, units, seed=1, threads=1)
    twin.run(0.1)
    return Run(timed(lambda: twin.run(PART_S), round(seconds / PART_S)))


def row(name, run, axes, threads=1):
    """One line of the table."""
    (cpu, wall), slowest = np.median(run.parts_s, axis=0), run.parts_s[:, 0].max()
    ns = 1e9 * core.TICK_S / PART_S / axes
    return {
        "case": name,
        "threads": threads,
        "cpu_s_per_axis_s": cpu / PART_S / axes,
        "ns_per_axis_tick": cpu * ns,
        "slowest_ns_per_axis_tick": slowest * ns,
        "real_time_factor_1000_axes": axes / 1000.0 * PART_S / (cpu if threads == 1 else wall),
        "at_best_1000_axes": axes / 1000.0 * PART_S / cpu * threads,
        "ticks_per_slice": run.slice_ticks,
    }


def measure(axes, seconds):
    """All cases."""
    plane = generate(load_instrument("sdssv"), seed=1, n_positioners=axes // 2)
    units = draw_units(plane, seed=1)
    rows = []
    for kernel in core.KERNELS:
        rows.append(row(f"plant, {kernel}", plant_only(units, seconds, kernel), axes))
        both = moving(plane, units, seconds, kernel=kernel, threads=1, neighbours=False)
        rows.append(row(f"plant and firmware, {kernel}", both, axes))
    along = moving(plane, units, seconds, move=by_trajectory, threads=1, neighbours=False)
    rows.append(row("along trajectories", along, axes))
    for name, steps in (("with neighbours", EVEN), ("the same in adaptive steps", ADAPTIVE)):
        for threads in (1, 2):
            all_of_it = moving(plane, units, seconds, threads=threads, neighbours=True, substeps=steps)
            rows.append(row(name, all_of_it, axes, threads))
    start_deg, along_plan = planned_field(plane, units)
    for threads in (1, 2):
        options = {"threads": threads, "neighbours": True, "substeps": ADAPTIVE}
        planned = moving(plane, units, seconds, start_deg, along_plan, **options)
        rows.append(row("adaptive, in a planned field", planned, axes, threads))
    close = moving(plane, units, seconds, TOUCHING, threads=1, neighbours=True)
    rows.append(row("with neighbours, 28 contacts", close, axes))
    rows.append(row("everybody at rest", idle(plane, units, seconds), axes))
    return rows


def scale(numbers, seconds):
    """The cost with firmware and neighbours for each number of axes, one thread."""
    out = []
    for axes in numbers:
        parts = [MOST_AXES] * (axes // MOST_AXES) + [axes % MOST_AXES] * (axes % MOST_AXES > 0)
        cpu_s = 0.0
        for part in parts:
            plane = generate(load_instrument("sdssv"), seed=1, n_positioners=part // 2)
            units = draw_units(plane, seed=1)
            cpu_s += np.median(moving(plane, units, seconds, threads=1).parts_s, axis=0)[0]
        out.append(
            {
                "axes": axes,
                "twins": len(parts),
                "ns_per_axis_tick": 1e9 * core.TICK_S / PART_S / axes * cpu_s,
                "real_time_factor": PART_S / cpu_s,
                "bytes_per_axis": bytes_per_axis(plane, units),
            }
        )
    return out


def on_paper(rows, larger, power):
    """Cores that keep up with real time, and memory: from the most axes measured, with the growth found."""
    last, axes = larger[-1], 2 * PAPER_POSITIONERS
    grown = (axes / last["axes"]) ** (power - 1.0)
    cost_ns = {r["case"]: r["ns_per_axis_tick"] for r in rows if r["threads"] == 1}
    adaptive = cost_ns["the same in adaptive steps"] / cost_ns["with neighbours"]
    cores = 1e-9 * grown * last["ns_per_axis_tick"] * axes / core.TICK_S
    return {
        "positioners": PAPER_POSITIONERS,
        "twins": -(-axes // MOST_AXES),
        "cores": cores,
        "cores_adaptive": adaptive * cores,
        "GiB": axes * last["bytes_per_axis"] / 2**30,
    }


def bytes_per_axis(plane, units):
    """Of the twin in a move, all that it holds; the firmware's own state is not in it."""
    twin = Twin(plane, units, seed=1, start_deg=APART, threads=1)
    by_goto(twin, plane)
    twin.run(0.4)
    return twin._core.bytes_per_positioner // 2


def exponent(rows):
    """By which power of their number the cost of axes grows."""
    axes = np.log([r["axes"] for r in rows])
    cost = np.log([r["axes"] * r["ns_per_axis_tick"] for r in rows])
    return float(np.polyfit(axes, cost, 1)[0])


def peers(axes, clocks):
    """ns per axis-tick of other ways to compute the plant; None where one cannot run here."""
    with tempfile.TemporaryDirectory() as folder:
        out = {}
        source, clock_GHz = (PEERS / "plant.c").read_text(), max(clocks.get("alone", [1.0]))
        for real in ("double", "float"):
            program = Path(folder) / real
            build = ["gcc", "-O3", "-march=native", "-ffast-math", f"-DREAL={real}"]
            made = answer([*build, PEERS / "plant.c", "-o", program, "-lm"])
            out[f"plain C by gcc, {real}"] = None if made is None else number([program, axes, PEER_TICKS])
            out[f"its bound by issue, {real}"] = bound_ns(source, real, clock_GHz)
        for real in ("float64", "float32"):
            command = [sys.executable, PEERS / "numba_plant.py", axes, PEER_TICKS, real]
            out[f"numba, {real}"] = number(command)
    return out


def answer(command):
    """What a program prints; None where it fails or is not there."""
    try:
        done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout


def number(command):
    """The number that a program prints; None where it prints none."""
    text = answer(command)
    return float(text) if text else None


def firmware_cost_ns(rows):
    """What a tick of the firmware costs: the whole without the plant, best kernel."""
    cost = {r["case"]: r["ns_per_axis_tick"] for r in rows}
    kernel = core.KERNELS[-1]
    return cost[f"plant and firmware, {kernel}"] - cost[f"plant, {kernel}"]


def show(report):
    """The table on the terminal."""
    print(f"{report['axes']} axes, {report['machine']}, load {report['load']:.1f}")
    names = (
        ("threads", 8),
        ("ns/axis-tick", 14),
        ("slowest", 9),
        ("x real time", 13),
        ("at best", 9),
        ("slice", 7),
    )
    print(f"{'':34s}" + "".join(f"{name:>{width}s}" for name, width in names))
    for r in report["rows"]:
        factor, at_best = r["real_time_factor_1000_axes"], r["at_best_1000_axes"]
        ns, slowest = r["ns_per_axis_tick"], r["slowest_ns_per_axis_tick"]
        ticks = "" if r["ticks_per_slice"] is None else f"{r['ticks_per_slice']:7.1f}"
        print(f"{r['case']:34s}{r['threads']:8d}{ns:14.1f}{slowest:9.1f}{factor:13.1f}{at_best:9.1f}{ticks}")
    print(f"of which the firmware's tick: {report['firmware_ns_per_axis_tick']:.0f} ns an axis")
    print("more axes, with neighbours, one thread:")
    for r in report["scale"]:
        print(
            f"  {r['axes']:6d} axes in {r['twins']}: {r['ns_per_axis_tick']:6.1f} ns/axis-tick, "
            f"{r['real_time_factor']:5.2f} x real time, {r['bytes_per_axis']} bytes an axis"
        )
    if report["exponent"] is not None:
        print(f"  growth with the power {report['exponent']:.3f}")
        paper = report["on_paper"]
        print(
            f"  on paper, {paper['positioners']} positioners in {paper['twins']} twins: "
            f"real time on {paper['cores']:.1f} cores, {paper['cores_adaptive']:.1f} in adaptive steps; "
            f"{paper['GiB']:.2f} GiB"
        )
    print("peers, plant only:")
    for name, ns in report["peers_ns_per_axis_tick"].items():
        factor = NEEDS if ns is None else f"{ns:6.1f} ns/axis-tick, {5e2 / ns:5.1f} x"
        print(f"  {name:26s} {factor}")
    show_clocks(report["clocks_GHz"])


def show_clocks(clocks):
    """What each core makes of a fixed loop."""
    columns = (clocks.get(name, []) for name in ("cores", "alone", "together"))
    for core_number, alone, together in zip(*columns, strict=True):
        print(f"core {core_number}: {alone:.2f} GHz alone, {together:.2f} GHz when all are busy")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--axes", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=8.0, help="simulated, for each case")
    numbers = [500, 1000, 2000, 4000, 10000, 20000]
    parser.add_argument("--scale", type=int, nargs="*", default=numbers, help="numbers of axes")
    parser.add_argument("--out", type=Path, default=Path("build/bench/twin.json"))
    args = parser.parse_args()
    rows, larger = measure(args.axes, args.seconds), scale(args.scale, args.seconds / 2)
    clocks, power = clocks_GHz(), exponent(larger) if len(larger) > 1 else None
    report = {
        "version": __version__,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "load": os.getloadavg()[0],
        "axes": args.axes,
        "kernels": core.KERNELS,
        "firmware_ns_per_axis_tick": firmware_cost_ns(rows),
        "rows": rows,
        "scale": larger,
        "exponent": power,
        "on_paper": None if power is None else on_paper(rows, larger, power),
        "clocks_GHz": clocks,
        "peers_ns_per_axis_tick": peers(args.axes, clocks),
    }
    show(report)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
