"""Identified quantities as records: for JSON, for ECSV, for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fiberloom.calibration.bench.estimate import Estimate
from fiberloom.instruments import FocalPlane
from fiberloom.report.outputs import marks
from fiberloom.typing import Floats


def estimate_records(
    plane: FocalPlane, seed: int, estimates: Sequence[Estimate], truth: Mapping[str, Floats]
) -> dict[str, Any]:
    """The content of a result file: a record for each positioner and quantity.

    `plane` and `seed` mark the file; `estimates` have a row for each positioner of the plane;
    `truth`: (N,) true values by the names of estimates, in their units (uNm, mm, deg, ... as the
    estimate says); empty where none are known.
    """
    positioners = [
        {
            "positioner_id": int(number),
            "estimates": {e.name: e.record(row) | _truth(e, row, truth) for e in estimates},
        }
        for row, number in enumerate(plane.positioner_id)
    ]
    return marks(plane, seed) | {"bench": "twin", "positioners": positioners}


def _truth(e: Estimate, row: int, truth: Mapping[str, Floats]) -> dict[str, float]:
    if e.name not in truth or e.reason[row]:
        return {}
    true = float(truth[e.name][row])
    off = float(e.value[row]) - true
    if e.unit == "rad":
        off = float(np.angle(np.exp(1j * off)))
    return {"true": true, "off_by_se": off / float(e.standard_error[row])}


def estimate_rows(content: Mapping[str, Any]) -> list[dict[str, Any]]:
    """One line for each positioner and quantity of `estimate_records`."""
    rows = []
    for positioner in content["positioners"]:
        for name, record in positioner["estimates"].items():
            row = {"positioner_id": positioner["positioner_id"], "quantity": name}
            row |= {key: record.get(key) for key in ("unit", "value", "standard_error", "n")}
            row |= {key: record[key] for key in ("true", "off_by_se") if key in record}
            rows.append(row | {"reason": record.get("reason", "")})
    return rows
