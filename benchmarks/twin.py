"""What the twin costs: 1000 axes with the real firmware in the loop, all moving.

    python benchmarks/twin.py [--axes 1000] [--seconds 8] [--out build/bench/twin.json]

A move of 8 s in slices of half a second: the median slice and the slowest one, for what costs more the longer
a motor cruises is no noise. No arms touch, but in the case that says so. CPU time, because other work on the
machine disturbs it less than wall time. The real-time factor is simulated seconds over CPU seconds on one
core; with two threads it is over wall seconds, and means something on an idle machine only.
"""

import argparse
import json
import os
import platform
import struct
import time
from pathlib import Path

import numpy as np

from fiberloom._core import twin as core
from fiberloom.bus.identifier import encode
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.units import plain
from fiberloom.units import COUNTS_PER_DEG
from fiberloom.version import __version__

GOTO, NEW, POINT, END, START = 30, 10, 11, 12, 14

# Real-time factor for 1000 axes on one core of another, faster machine (Zen 5, AVX-512), measured
# for this project; plant only, without firmware, hall sensors, bus or neighbours.
PEERS = {
    "scipy solve_ivp, CVODE, motulator, gym-electric-motor, PathSim, pydrake": "0.001 to 0.02",
    "MuJoCo, 1000 hinges with a callback": "0.25 to 0.3",
    "scalar C, libm sincos, RK4 / DKD": "0.65 / 1.43",
    "numpy, structure of arrays": "0.7 to 0.9",
    "jax on the CPU": "1.0 to 5.3",
    "numba, structure of arrays, polynomial sincos, f64 / f32": "10 / 18",
    "C auto-vectorised over axes, f64 (AVX2 build)": "28 (16)",
}


SLICE_S = 0.5
APART, TOUCHING = (20.0, 178.0), (20.0, 60.0)
"""Where all arms begin, deg: folded, none touches; and 28 overlap."""


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


def moving(plane, units, seconds, start_deg=APART, move=by_goto, **options):
    """Plant, firmware and, if asked for, neighbours: (CPU s, wall s) of each slice."""
    twin = Twin(plane, units, seed=1, start_deg=start_deg, **options)
    move(twin, plane)
    twin.run(0.4)
    return timed(lambda: twin.run(SLICE_S), round(seconds / SLICE_S))


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
    return timed(lambda: plant.advance(round(SLICE_S / core.TICK_S)), round(seconds / SLICE_S))


def idle(plane, units, seconds):
    """Everybody at rest."""
    twin = Twin(plane, units, seed=1, threads=1)
    twin.run(0.1)
    return timed(lambda: twin.run(SLICE_S), round(seconds / SLICE_S))


def row(name, slices, axes, threads=1):
    """One line of the table."""
    (cpu, wall), slowest = np.median(slices, axis=0), slices[:, 0].max()
    ns = 1e9 * core.TICK_S / SLICE_S / axes
    return {
        "case": name,
        "threads": threads,
        "cpu_s_per_axis_s": cpu / SLICE_S / axes,
        "ns_per_axis_tick": cpu * ns,
        "slowest_ns_per_axis_tick": slowest * ns,
        "real_time_factor_1000_axes": axes / 1000.0 * SLICE_S / (cpu if threads == 1 else wall),
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
    for threads in (1, 2):
        all_of_it = moving(plane, units, seconds, threads=threads, neighbours=True)
        rows.append(row("with neighbours", all_of_it, axes, threads))
    close = moving(plane, units, seconds, TOUCHING, threads=1, neighbours=True)
    rows.append(row("with neighbours, 28 contacts", close, axes))
    rows.append(row("everybody at rest", idle(plane, units, seconds), axes))
    return rows


def firmware_cost_ns(rows):
    """What a tick of the firmware costs: the whole without the plant, best kernel."""
    cost = {r["case"]: r["ns_per_axis_tick"] for r in rows}
    kernel = core.KERNELS[-1]
    return cost[f"plant and firmware, {kernel}"] - cost[f"plant, {kernel}"]


def show(report):
    """The table on the terminal."""
    print(f"{report['axes']} axes, {report['machine']}, load {report['load']:.1f}")
    print(f"{'':34s}{'threads':>8s}{'ns/axis-tick':>14s}{'slowest':>9s}{'x real time':>13s}")
    for r in report["rows"]:
        factor = r["real_time_factor_1000_axes"]
        ns, slowest = r["ns_per_axis_tick"], r["slowest_ns_per_axis_tick"]
        print(f"{r['case']:34s}{r['threads']:8d}{ns:14.1f}{slowest:9.1f}{factor:13.1f}")
    print(f"of which the firmware's tick: {report['firmware_ns_per_axis_tick']:.0f} ns an axis")
    print("peers, plant only, one core of a faster machine:")
    for name, factor in PEERS.items():
        print(f"  {factor:>15s}  {name}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--axes", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=8.0, help="simulated, for each case")
    parser.add_argument("--out", type=Path, default=Path("build/bench/twin.json"))
    args = parser.parse_args()
    rows = measure(args.axes, args.seconds)
    report = {
        "version": __version__,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "load": os.getloadavg()[0],
        "axes": args.axes,
        "kernels": core.KERNELS,
        "firmware_ns_per_axis_tick": firmware_cost_ns(rows),
        "rows": rows,
        "peers_real_time_factor_1000_axes": PEERS,
    }
    show(report)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
