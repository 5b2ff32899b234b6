"""What a unit's acceptance says of itself: records for machines, a head for the page that is signed."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from fiberloom.calibration.bench.acceptance import AcceptanceSettings, Check, UnitVerdict
from fiberloom.instruments import FocalPlane
from fiberloom.report.outputs import marks

BLANK = "______________"


@dataclass(frozen=True)
class Paperwork:
    """Who measured what with what."""

    plane: FocalPlane
    seed: int
    settings: AcceptanceSettings
    close_up_um: float
    """Two-dimensional rms of the camera close up."""
    serial: str = ""
    engineer: str = ""


def page_name(verdict: UnitVerdict, serial: str = "") -> str:
    """File name of a unit's report: with its serial number where it has one, else its positioner's."""
    plain = re.sub(r"[^A-Za-z0-9._-]+", "-", serial).strip("-.")
    return f"acceptance-{plain or verdict.positioner_id}.html"


def unit_record(verdict: UnitVerdict, serial: str) -> dict[str, Any]:
    """One unit of acceptance.json."""
    return {
        "positioner_id": verdict.positioner_id,
        "serial": serial,
        "accepted": verdict.passed,
        "verdict": verdict.word,
        "not_measured": list(verdict.missing),
        "reason": verdict.reason,
        "report": page_name(verdict, serial),
        "checks": [asdict(c) | {"verdict": c.verdict} | _finite(c) for c in verdict.checks],
    }


def _finite(check: Check) -> dict[str, Any]:
    """JSON has no infinity: a target that was never seen has no distance."""
    bad = check.value is not None and not np.isfinite(check.value)
    return {"value": None} if bad else {}


def page_head(verdict: UnitVerdict, papers: Paperwork, firmware: str) -> dict[str, Any]:
    """What identifies the unit and the run, in the order of the page."""
    plane, settings = papers.plane, papers.settings
    instrument, run = plane.instrument, marks(plane, papers.seed)
    requirements = "" if instrument.acceptance is None else instrument.acceptance.source
    return {
        "Unit": f"positioner {verdict.positioner_id}, hole {plane.hole[verdict.row]}",
        "Serial number": papers.serial or BLANK,
        "Engineer": papers.engineer or BLANK,
        "Instrument": f"{instrument.name}: {instrument.description}",
        "Requirements": requirements or instrument.name,
        "Measured": run["utc"],
        "Bench": f"twin, seed {papers.seed}; camera {instrument.metrology.noise_rms_um:g} µm, "
        f"close up {papers.close_up_um:g} µm rms",
        "Procedure": f"{settings.n_points} points per axis and direction; {settings.n_targets} targets of "
        f"{settings.n_moves} moves; 3 x {settings.visits} visits per axis",
        "fiberloom": run["version"],
        "Firmware": firmware,
        "Configuration": run["config_hash"],
    }
