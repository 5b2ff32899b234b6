"""The table of the comparison: a row per array, buffer and planner."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

Line = dict[str, Any]
HEAD = (
    "| array | buffer mm | planner | pairs, all arrive | fail, of | motion s, median / worst "
    "| over the bound | CPU s | least gap um | before smoothing | not safe |",
    "|---|--:|---|--:|--:|--:|--:|--:|--:|--:|--:|",
)
"""Gaps are beyond the buffers; `not safe`: pairs whose paths our verifier refuses."""

LEAST_GROWTH = 2
"""A power is fitted where the largest array has so many times the positioners of the smallest."""


def row(array: str, buffer_mm: float, who: str, lines: list[Line]) -> Line:
    """All pairs of one planner on one array."""
    solved = [line for line in lines if not line["failed"]]
    out: Line = {"array": array, "buffer_mm": buffer_mm, "who": who, "pairs": len(lines)}
    out["solved"] = len(solved)
    out["failed"] = sum(len(line["failed"]) for line in lines)
    out["of"] = sum(line["positioners"] for line in lines)
    out["positioners"] = lines[0]["positioners"]
    out["motion_s"] = spread(line["motion_s"] for line in solved)
    out["ratio"] = spread(line["motion_s"] / line["bound_s"] for line in solved)
    # what fails costs as well; what was stopped at its limit has cost that, what died does not tell
    out["cpu_s"] = spread(line["cpu_s"] for line in lines if line["cpu_s"] > 0.0)
    out["smooth_cpu_s"] = spread(line["smooth_cpu_s"] for line in solved if "smooth_cpu_s" in line)
    for key in ("gap_um", "raw_gap_um"):
        out[key] = min((line[key] for line in lines if key in line), default=None)
    out["unsafe"] = sum(not line["verified"] for line in lines if "motion_s" in line)
    return out


def spread(values: Iterable[float]) -> dict[str, float] | None:
    """Median and worst; None of nothing."""
    found = list(values)
    return {"median": float(np.median(found)), "worst": max(found)} if found else None


def show(one: Line) -> str:
    """One row of the table."""
    cells = [one["array"], f"{one['buffer_mm']:g}", one["who"], f"{one['solved']} of {one['pairs']}"]
    cells.append(f"{one['failed']} of {one['of']}")
    for key, form in (("motion_s", ".1f"), ("ratio", ".3f"), ("cpu_s", ".2f")):
        value = one[key]
        cells.append("-" if value is None else f"{value['median']:{form}} / {value['worst']:{form}}")
    cells += ["-" if one[key] is None else f"{one[key]:+.1f}" for key in ("gap_um", "raw_gap_um")]
    return "| " + " | ".join([*cells, str(one["unsafe"])]) + " |"


def smoothing(rows: list[Line]) -> list[str]:
    """How much of kaiju's CPU time goes into smoothing and thinning its paths."""
    return [
        f"{one['who']}, {one['array']}, {one['buffer_mm']:g} mm: {one['smooth_cpu_s']['median']:.2f} of its "
        f"{one['cpu_s']['median']:.2f} CPU s are smoothing (medians)"
        for one in rows
        if one["smooth_cpu_s"]
    ]


def growth(rows: list[Line]) -> list[str]:
    """How CPU time grows with the number of positioners, on the generated arrays: the fitted power."""
    out = []
    for who in dict.fromkeys(one["who"] for one in rows):
        for buffer_mm in dict.fromkeys(one["buffer_mm"] for one in rows):
            sizes = [
                one
                for one in rows
                if (one["who"], one["buffer_mm"]) == (who, buffer_mm)
                and one["cpu_s"]
                and one["solved"]  # else it may be no more than the limit
                and one["array"].startswith("hexagon")
            ]
            numbers = [one["positioners"] for one in sizes]
            if len(sizes) > 1 and max(numbers) >= LEAST_GROWTH * min(numbers):
                power = exponent([(one["positioners"], one["cpu_s"]["median"]) for one in sizes])
                out.append(f"{who}, {buffer_mm:g} mm: median CPU s grow as N^{power:.2f}, N = {numbers}")
    return out


def exponent(points: list[tuple[float, float]]) -> float:
    """Slope of log CPU s against log N, least squares."""
    numbers, cpu_s = np.log(np.array(points, dtype=np.float64)).T
    return float(np.polyfit(numbers, cpu_s, 1)[0])


def why(lines: list[Line]) -> list[str]:
    """Who does not arrive, and why; of many the first."""
    out = []
    for line in lines:
        if line["failed"]:
            first = list(line["failed"].items())[:5]
            told = "; ".join(f"{number}: {reason}" for number, reason in first)
            more = f"; and {len(line['failed']) - 5} more" if len(line["failed"]) > 5 else ""
            out.append(
                f"{line['who']}, {line['array']}, {line['buffer_mm']:g} mm, seed {line['seed']}: {told}{more}"
            )
    return out
