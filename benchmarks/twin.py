"""What the twin costs: 1000 axes with the real firmware in the loop, all moving.

    python benchmarks/twin.py [--axes 1000] [--seconds 0.5] [--out build/bench/twin.json]

CPU time, the best of several runs, because other work on the machine disturbs it less than wall
time. The real-time factor is simulated seconds over CPU seconds on one core; with two threads it is
over wall seconds, and means something on an idle machine only.
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

GOTO = 30

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


def best(times):
    """Least CPU and wall time of several runs."""
    return min(t[0] for t in times), min(t[1] for t in times)


def timed(action, repeats):
    """(CPU s, wall s) of each of several calls."""
    out = []
    for _ in range(repeats):
        cpu, wall = time.process_time(), time.perf_counter()
        action()
        out.append((time.process_time() - cpu, time.perf_counter() - wall))
    return out


def moving_twin(plane, units, **options):
    """Every axis on a long way at 2000 rpm, past its acceleration."""
    twin = Twin(plane, units, seed=1, start_deg=(20.0, 60.0), **options)
    goal = struct.pack("<ii", int(300 * COUNTS_PER_DEG), int(175 * COUNTS_PER_DEG))
    twin.send((encode(int(i), GOTO, 1), goal) for i in plane.positioner_id)
    twin.run(0.4)
    return twin


def whole(plane, units, seconds, repeats, **options):
    """Plant, firmware and, if asked for, neighbours."""
    twin = moving_twin(plane, units, **options)
    return best(timed(lambda: twin.run(seconds), repeats))


def plant_only(units, seconds, repeats, kernel):
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
    return best(timed(lambda: plant.advance(round(seconds / core.TICK_S)), repeats))


def idle(plane, units, seconds, repeats):
    """Everybody at rest."""
    twin = Twin(plane, units, seed=1, threads=1)
    twin.run(0.1)
    return best(timed(lambda: twin.run(seconds), repeats))


def row(name, cpu_wall, axes, seconds, threads=1):
    """One line of the table."""
    cpu, wall = cpu_wall
    scale = axes / 1000.0
    return {
        "case": name,
        "threads": threads,
        "cpu_s_per_axis_s": cpu / seconds / axes,
        "ns_per_axis_tick": cpu / seconds / axes * core.TICK_S * 1e9,
        "real_time_factor_1000_axes": scale * seconds / (cpu if threads == 1 else wall),
    }


def measure(axes, seconds, repeats):
    """All cases."""
    plane = generate(load_instrument("sdssv"), seed=1, n_positioners=axes // 2)
    units = draw_units(plane, seed=1)
    rows = []
    for kernel in core.KERNELS:
        alone = plant_only(units, seconds, repeats, kernel)
        rows.append(row(f"plant, {kernel}", alone, axes, seconds))
        both = whole(plane, units, seconds, repeats, kernel=kernel, threads=1, neighbours=False)
        rows.append(row(f"plant and firmware, {kernel}", both, axes, seconds))
    for threads in (1, 2):
        all_of_it = whole(plane, units, seconds, repeats, threads=threads, neighbours=True)
        rows.append(row("with neighbours", all_of_it, axes, seconds, threads))
    rows.append(row("everybody at rest", idle(plane, units, 100.0, 2), axes, 100.0))
    return rows


def firmware_cost_ns(rows):
    """What a tick of the firmware costs: the whole without the plant, best kernel."""
    cost = {r["case"]: r["ns_per_axis_tick"] for r in rows}
    kernel = core.KERNELS[-1]
    return cost[f"plant and firmware, {kernel}"] - cost[f"plant, {kernel}"]


def show(report):
    """The table on the terminal."""
    print(f"{report['axes']} axes, {report['machine']}, load {report['load']:.1f}")
    print(f"{'':34s}{'threads':>8s}{'ns/axis-tick':>14s}{'x real time':>13s}")
    for r in report["rows"]:
        factor = r["real_time_factor_1000_axes"]
        print(f"{r['case']:34s}{r['threads']:8d}{r['ns_per_axis_tick']:14.1f}{factor:13.1f}")
    print(f"of which the firmware's tick: {report['firmware_ns_per_axis_tick']:.0f} ns an axis")
    print("peers, plant only, one core of a faster machine:")
    for name, factor in PEERS.items():
        print(f"  {factor:>15s}  {name}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--axes", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=0.5, help="simulated, for each run")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path("build/bench/twin.json"))
    args = parser.parse_args()
    rows = measure(args.axes, args.seconds, args.repeats)
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
