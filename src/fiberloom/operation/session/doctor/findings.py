"""What a doctor says."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any


class Verdict(StrEnum):
    """Of one check."""

    OK = "ok"
    NOTE = "note"  # worth knowing, nothing to do
    WRONG = "wrong"


@dataclass(frozen=True)
class DoctorFinding:
    """One thing that was looked at."""

    check: str
    verdict: Verdict
    trouble: str
    """Name of the trouble, e.g. `gateway in use`; empty where there is none."""
    text: str
    """What was found, and what to do."""

    def as_row(self) -> dict[str, Any]:
        """As it is printed."""
        return {"check": self.check, "verdict": str(self.verdict), "trouble": self.trouble, "text": self.text}


@dataclass(frozen=True)
class DoctorLimits:
    """From where on something is wrong."""

    disk_mb: float = 500.0
    """Free space below which a disk counts as full."""
    calibration_days: float = 180.0
    """Age from which a calibration is old."""
    clock_s: float = 2.0
    """By which clocks may differ."""


def ok(check: str, text: str) -> DoctorFinding:
    """Nothing wrong."""
    return DoctorFinding(check, Verdict.OK, "", text)


def note(check: str, trouble: str, text: str) -> DoctorFinding:
    """Worth knowing."""
    return DoctorFinding(check, Verdict.NOTE, trouble, text)


def wrong(check: str, trouble: str, text: str) -> DoctorFinding:
    """Something to be done before anything moves."""
    return DoctorFinding(check, Verdict.WRONG, trouble, text)


def numbers(positioners: list[int], most: int = 8) -> str:
    """Numbers of positioners in a line, the first ones of many."""
    first = ", ".join(map(str, positioners[:most]))
    return first if len(positioners) <= most else f"{first} and {len(positioners) - most} more"
