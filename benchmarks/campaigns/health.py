"""Health over positioner-years: share of faults found, delay in moves, false alarms. JSON out.

    python benchmarks/campaigns/health.py --units 1000 --fields 8000 --workers 2 --out health.json

A year is 8000 fields of a blind move and two corrections (24 000 moves). Goes on where it was killed
(`--folder`).
"""

import argparse
import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.studies.campaign import Campaign, run
from fiberloom.studies.health import TrialSettings, health_trial
from fiberloom.twin.faults.ailments import KINDS, AilmentModel
from fiberloom.version import __version__

CHUNK = 250


def main() -> None:
    """Run what the command line asks for."""
    asked = arguments()
    settings = TrialSettings(fields=asked.fields, ailments=AilmentModel(rate_per_year=asked.rate))
    campaign = Campaign("health", health_trial, asked.units, asked.seed, settings, chunk=CHUNK)
    rows = run(campaign, asked.folder, workers=asked.workers)
    report = {"version": __version__, "units": asked.units, "fields": asked.fields}
    report |= {"seed": asked.seed, "rate_per_year": asked.rate}
    report |= {"false_alarms": false_alarms(rows), "ailments": [found(rows, kind) for kind in KINDS]}
    print("\n".join(table(report)))
    if asked.out:
        asked.out.write_text(json.dumps(report, indent=1) + "\n")


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--units", type=int, default=250)
    parser.add_argument("--fields", type=int, default=600)
    parser.add_argument("--rate", type=float, default=0.5, help="ailments per unit and 24 000 moves")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--folder", type=Path, help="keeps finished chunks")
    parser.add_argument("--out", type=Path, help="JSON file")
    return parser.parse_args()


def false_alarms(rows: dict[str, np.ndarray]) -> dict[str, Any]:
    """Certain findings about units that nothing ailed."""
    moves, count = int(rows["healthy_moves"].sum()), int(rows["false"].sum())
    names = Counter(rows["false_name"][rows["false"] > 0].tolist())
    return {"count": count, "healthy_moves": moves, "per_million": 1e6 * count / moves, "names": names}


def found(rows: dict[str, np.ndarray], kind: str) -> dict[str, Any]:
    """One row of the table."""
    ill = rows["truth"] == kind
    seen = ill & (rows["found"] >= 0)
    delay = (rows["found"] - rows["onset"])[seen]
    return {
        "ailment": str(kind),
        "ill": int(ill.sum()),
        "found": int(seen.sum()),
        "share": float(seen.sum() / max(ill.sum(), 1)),
        "delay_moves_median": float(np.median(delay)) if len(delay) else None,
        "delay_moves_p90": float(np.percentile(delay, 90)) if len(delay) else None,
        "named_last": Counter(rows["last"][seen].tolist()),
    }


def table(report: dict[str, Any]) -> list[str]:
    """Markdown."""
    out = [
        "| ailment | ill | found | delay in moves, median / 90 % | called at last |",
        "|---|--:|--:|--:|---|",
    ]
    for row in report["ailments"]:
        delay = (
            "-" if row["found"] == 0 else f"{row['delay_moves_median']:.0f} / {row['delay_moves_p90']:.0f}"
        )
        names = ", ".join(f"{name} {n}" for name, n in row["named_last"].most_common())
        out.append(f"| {row['ailment']} | {row['ill']} | {row['found']} | {delay} | {names} |")
    false = report["false_alarms"]
    rate = f"{false['per_million']:.2f} per million moves"
    out.append(f"false alarms: {false['count']} in {false['healthy_moves']} moves of healthy units: {rate}")
    return out


if __name__ == "__main__":
    main()
