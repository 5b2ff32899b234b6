"""Checks of this machine and of what is on record: disk, clock, calibration, owner."""

from __future__ import annotations

import shutil
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.calibration.transmission.nominal import NOMINAL
from fiberloom.instruments import FocalPlane
from fiberloom.operation.session.array_lock import state_of
from fiberloom.operation.session.doctor.findings import DoctorFinding, DoctorLimits, note, numbers, ok, wrong
from fiberloom.operation.session.states import SessionState
from fiberloom.store.arrays import ArrayBook
from fiberloom.units import GEAR

S_PER_DAY = 86400.0
BUILT = datetime(2025, 1, 1, tzinfo=UTC)
"""A clock before this has never been set."""


def check_disk(store: str, limits: DoctorLimits) -> DoctorFinding:
    """Room where the store is."""
    if "://" in store:
        return ok("disk", f"the store is a database elsewhere: {store.split('@')[-1]}")
    folder = Path(store).resolve().parent
    free_mb = shutil.disk_usage(folder).free / 1e6
    if free_mb < limits.disk_mb:
        text = f"{free_mb:.0f} MB free in {folder}, at least {limits.disk_mb:.0f} are wanted: remove old runs"
        return wrong("disk", "disk full", text)
    return ok("disk", f"{free_mb / 1e3:.1f} GB free in {folder}")


def check_clock(book: ArrayBook, limits: DoctorLimits, now: datetime | None = None) -> DoctorFinding:
    """This machine's clock (`now`: instead of it) against what is on record: time does not go back."""
    now = datetime.now(UTC) if now is None else now
    row = book.state()
    ahead_s = max((when - now).total_seconds() for when in (row.since, row.heartbeat or row.since))
    if now < BUILT:
        return wrong("clock", "clock off", f"{now:%Y-%m-%d %H:%M} UTC: the clock was never set; set it (NTP)")
    if ahead_s > limits.clock_s:
        text = f"the last record is {ahead_s:.0f} s in the future: the clock was set back; set it (NTP)"
        return wrong("clock", "clock off", text)
    return ok("clock", f"{now.isoformat(timespec='seconds')}")


def check_owner(book: ArrayBook) -> DoctorFinding:
    """Which process has it, and in which state it was left."""
    row = book.state()
    if row.owned:
        text = f"{row.owner} has the array ({row.state}); wait for its end, or `fiberloom stop`"
        return wrong("owner", "gateway in use", text)
    state = state_of(row)
    if state is SessionState.LOCKED:
        return wrong("owner", "locked", f"{row.text}; `fiberloom recover`")
    if row.stale:
        return note("owner", "owner gone", f"{row.owner} has ended while the array was {row.state}")
    return ok("owner", f"none; the array is {state}")


def check_exclusions(book: ArrayBook, plane: FocalPlane) -> DoctorFinding:
    """Which must not be moved."""
    ids = [e.positioner_id for e in book.exclusions()]
    strange = sorted(set(ids) - set(plane.positioner_id.tolist()))
    if strange:
        text = f"excluded, but not in the layout: {numbers(strange)}"
        return note("exclusions", "not in the layout", text)
    return ok("exclusions", numbers(ids) if ids else "none")


def check_calibration(plane: FocalPlane, maps: TransmissionMaps, limits: DoctorLimits) -> DoctorFinding:
    """Whose, and how old."""
    about = maps.provenance
    if about.note == NOMINAL:
        text = "none given: the nominal ratio is used; `fiberloom calibrate transmission`, then --calibration"
        return note("calibration", "not calibrated", text)
    if about.gear != float(plane.instrument.alpha.gear or GEAR):
        text = f"made for a gear of {about.gear:g}, the layout has {plane.instrument.alpha.gear:g}"
        return wrong("calibration", "calibration of other units", text)
    try:
        age_days = (datetime.now(UTC) - datetime.fromisoformat(about.utc)).total_seconds() / S_PER_DAY
    except ValueError:
        return note("calibration", "age not known", f"made at '{about.utc}'")
    if age_days > limits.calibration_days:
        text = f"{age_days:.0f} days old, at most {limits.calibration_days:.0f}: calibrate again"
        return wrong("calibration", "calibration old", text)
    if about.config_hash and about.config_hash != plane.config_hash():
        text = f"made with another layout ({about.config_hash}; this one is {plane.config_hash()})"
        return note("calibration", "another layout", text)
    return ok("calibration", f"{len(maps)} positioners, {max(age_days, 0.0):.1f} days old")


def check_misses(maps: TransmissionMaps, miss_mm: np.ndarray, limit_mm: float) -> DoctorFinding:
    """Whether the maps are those of these units: fibres are seen where the motors say.

    `maps`: in use; `miss_mm`: (n,) how far off the fibres are that are seen; `limit_mm`:
    from where the median is too far.
    """
    median_mm = float(np.median(miss_mm)) if len(miss_mm) else np.nan
    text = f"fibres are seen {1e3 * median_mm:.0f} um (median) from where the motors say"
    if len(miss_mm) >= 3 and median_mm > limit_mm and maps.provenance.note != NOMINAL:
        advice = (
            f"{text}, {1e3 * limit_mm:.0f} are usual: calibration or arms of other units? calibrate these"
        )
        return wrong("maps", "calibration of other units", advice)
    return ok("maps", text if len(miss_mm) else "not compared: no fibre is seen")
