"""How long the event loop is kept from listening while a field is observed.

    python benchmarks/array/loop_lag.py [--positioners N] [--seed S] [--out FILE.json]

A task asks for the loop every two milliseconds and notes by how much it is late: while an image is reduced,
a field is planned, a plan verified, a move recorded. Wall time, so: on an idle machine. The twin computes in
the same loop, in slices; a real bus does not.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import tempfile
import time
from pathlib import Path

import numpy as np

import fiberloom as fl
from fiberloom.targets import random_targets

EVERY_S = 0.002


async def observe(plane: fl.FocalPlane, seed: int, out: Path) -> np.ndarray:
    """Lags in s during one observation with two corrections."""
    field = fl.Field.twin(plane, seed=seed)
    await field.calibrate()
    targets = random_targets(plane, 4 * len(plane), seed)
    lags: list[tuple[float, float]] = []

    async def listen() -> None:
        while True:
            before_s = time.monotonic()
            await asyncio.sleep(EVERY_S)
            lags.append((time.monotonic() - before_s - EVERY_S, before_s))

    listener = asyncio.ensure_future(listen())
    try:
        await field.observe(targets, corrections=2, out=out)
    finally:
        listener.cancel()
    return np.array(lags)


def main() -> None:
    """Prints percentiles of the lag."""
    parser = argparse.ArgumentParser(description="lag of the event loop")
    parser.add_argument("--positioners", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    plane = fl.FocalPlane.of("sdssv", seed=given.seed, n=given.positioners)
    with tempfile.TemporaryDirectory() as folder:
        lags = asyncio.run(observe(plane, given.seed, Path(folder)))
    lag_ms = 1e3 * lags[:, 0]
    # by time, not by number: a lag of a second is one sample and a thousand moments
    weights = EVERY_S + lags[:, 0]
    order = np.argsort(lag_ms)
    shares = np.cumsum(weights[order]) / weights.sum()
    p50, p99, p999 = (float(lag_ms[order][np.searchsorted(shares, q)]) for q in (0.5, 0.99, 0.999))
    figures = {"p50_ms": p50, "p99_ms": p99, "p99.9_ms": p999, "worst_ms": float(lag_ms.max())}
    figures["p99_of_samples_ms"] = float(np.percentile(lag_ms, 99))
    print(f"{given.positioners} positioners: " + ", ".join(f"{k} {v:.1f}" for k, v in figures.items()))
    if given.out:
        given.out.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
