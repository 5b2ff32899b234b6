"""From RA and Dec to mm: CPU seconds in a fresh process after the imports, and the drift table of SDSS-V.

`python -m benchmarks.sky [--repeats N] [--out FILE.json]`
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time
from pathlib import Path

N = 5000
N_DRIFT, TIMES = 500, 13
LIMITS_S = {"place": 0.02, "place and back": 0.05, "drift": 0.1}
FIELDS = [(0, 0), (0, 1), (0, 2), (0, 3), (0, 3.55), (30, 0), (30, 2), (30, 3), (60, 0), (60, 2), (60, 3)]
"""Declination, deg, and hour angle, h."""


def child() -> None:
    """The figures of one process."""
    import numpy as np

    from fiberloom.instruments import load_instrument
    from fiberloom.sky import Chain, SkyPointing, SkyTargets, SkyTime
    from fiberloom.sky.drift import beside

    model = load_instrument("sdssv")
    pointing = SkyPointing(213.7, 53.08, SkyTime.of("2024-04-26T06:00:00", "utc"))
    rng = np.random.default_rng(0)
    offsets = 1.4 * np.sqrt(rng.random(N)) * np.exp(2j * np.pi * rng.random(N))
    spread = beside(Chain(model, pointing), np.column_stack([offsets.real, offsets.imag]))
    colours = rng.choice([5400.0, 16600.0], N)
    targets = SkyTargets(
        spread.target_id,
        spread.ra_deg,
        spread.dec_deg,
        np.full(N, 2016.0),
        *rng.normal(0.0, 10.0, (2, N)),
        rng.random(N),
        wavelength_A=colours,
    )
    from fiberloom.sky import earth

    earth._content.cache_clear()  # as in a process that has made no field yet
    earth._table.cache_clear()
    begun = time.process_time()
    chain = Chain(model, pointing)
    seen = chain.place(targets)
    placed = time.process_time()
    chain.sky(seen.xy_mm, colours)
    back = time.process_time()
    some = targets.select(np.arange(N_DRIFT))
    for step in range(TIMES):
        chain.at(pointing.time.later(300.0 * step)).place(some)
    ended = time.process_time()
    print(json.dumps({"place": placed - begun, "place and back": back - begun, "drift": ended - back}))


def timings(repeats: int) -> dict[str, float]:
    """Median CPU seconds."""
    words = [sys.executable, "-c", "from benchmarks.sky.__main__ import child; child()"]
    runs = [
        json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout)
        for _ in range(repeats)
    ]
    return {name: statistics.median(run[name] for run in runs) for name in runs[0]}


def drift_table() -> list[str]:
    """Rows in Markdown: largest drift in the field before / after guiding, um."""
    from fiberloom.instruments import load_instrument
    from fiberloom.sky import Chain, SkyPointing, SkyTime
    from fiberloom.sky.drift import drift, field_grid, longest_s

    model, now = load_instrument("sdssv"), SkyTime.of("2024-04-26T06:00:00", "utc")
    lines = []
    for dec, hour_angle in FIELDS:
        ra = 150.0
        chain = None
        for step in range(8):
            try:
                chain = Chain(model, SkyPointing(ra, dec, now))
                ra = (ra + chain.view.hour_angle_deg - 15.0 * hour_angle) % 360.0
            except ValueError:  # below the horizon: try the other side
                ra = (ra + 45.0 * (step + 1)) % 360.0
        assert chain is not None
        grid = field_grid(chain)
        cells = [
            "{:.1f} / {:.1f}".format(*drift(chain, grid, 60.0 * m, "BOSS").largest_um) for m in (15, 30, 60)
        ]
        longest = [f"{longest_s(chain, grid, limit, 'BOSS') / 60.0:.0f}" for limit in (5.0, 10.0)]
        lines.append(f"| {dec} | {hour_angle} | {chain.airmass:.2f} | {' | '.join([*cells, *longest])} |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    found = timings(asked.repeats)
    what = {
        "place": f"{N} targets to mm",
        "place and back": f"{N} targets to mm and back",
        "drift": f"{N_DRIFT} targets at {TIMES} times",
    }
    for name, seconds in found.items():
        missed = "" if seconds <= LIMITS_S[name] else "  MISSED"
        print(f"{what[name]:<32}{seconds:7.4f} CPU s (at most {LIMITS_S[name]:g}){missed}")
    print("| dec | HA h | airmass | 15 min | 30 min | 60 min | 5 um min | 10 um min |")
    print("|--:|--:|--:|--:|--:|--:|--:|--:|")
    print("\n".join(drift_table()))
    if asked.out is not None:
        asked.out.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
