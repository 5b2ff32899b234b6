"""The statistical twin: what a standstill position costs, beside the full physics. JSON with --out."""

import argparse
import asyncio
import json
import time
from pathlib import Path

import numpy as np

from fiberloom.bus import Client
from fiberloom.studies.years import Years
from fiberloom.twin import StatisticalTwin, Twin, TwinTransport, bench_units


def cpu_s(work):
    """CPU time of a call, best of three."""
    best = np.inf
    for _ in range(3):
        begun = time.process_time()
        work()
        best = min(best, time.process_time() - begun)
    return best


def standstill_us():
    """Many moves of some units at once; microseconds a position of both axes."""
    plane, units = bench_units("sdssv", 0, range(20))
    twin = StatisticalTwin(plane, units)
    wires = np.random.default_rng(0).uniform(5, 175, (20, 2, 5000))
    return 1e6 * cpu_s(lambda: twin.stand(wires)) / 1e5


def years_us(n):
    """One move after the other with wear and ailments; microseconds a positioner and move."""
    plane, units = bench_units("sdssv", 0, range(n))
    years = Years(plane, units, seed=0)
    wires = np.random.default_rng(0).uniform(5, 175, (100, n, 2))

    def hundred():
        for wire in wires:
            years.visit(wire)

    return 1e6 * cpu_s(hundred) / (100 * n)


def physics_us():
    """Precise moves by about 60 deg with firmware and physics; microseconds a positioner and move."""
    plane, units = bench_units("sdssv", 0, range(16))
    twin = Twin(plane, units, threads=1, neighbours=False)
    client = Client(TwinTransport(twin))

    async def moves():
        ids = await client.discover()
        await client.set_precise_moves(ids, on=True)
        await client.set_speed(ids, 2000.0, 2000.0)
        begun = time.process_time()
        for goal in (60.0, 120.0, 60.0, 120.0):
            moved = await client.goto(ids, goal, goal)
            await client.wait_until_done(moved.ok_ids, timeout_s=60.0)
        return (time.process_time() - begun) / (4 * 16)

    return 1e6 * asyncio.run(moves())


def main():
    """Prints and writes the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    out = parser.parse_args().out
    figures = {
        "physics_us_per_move": physics_us(),
        "standstill_us_per_move": standstill_us(),
        "years_us_per_move_50_units": years_us(50),
        "years_us_per_move_500_units": years_us(500),
    }
    for name, value in figures.items():
        print(f"{name:32s} {value:10.2f}")
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
