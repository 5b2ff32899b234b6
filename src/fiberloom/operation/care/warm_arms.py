"""Arms as long as the temperature of an observation makes them, and what the observation shows of that."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.calibration.adaptive.expansion import (
    KnownExpansion,
    NightGrowth,
    grown,
    growth_seen,
    learnt_expansion,
)
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.instruments.arms import L_ALPHA
from fiberloom.operation.care.thermometer import Felt, felt, has_thermometer
from fiberloom.operation.source import Source
from fiberloom.store import Run, Store
from fiberloom.store.parts import pack
from fiberloom.typing import Flags, Floats

TEMPERATURE = "temperature"
"""Name of the part of a run that keeps it."""
_PPM = 1e6
_SURE = 4.0
"""Standard errors."""


NOT_ASKED = Felt(None, "the positioners were not asked for their temperature")
"""Before they are."""


@dataclass
class WarmArms:
    """Arms of a field at the temperature of one observation."""

    calibrated: FocalPlane
    """The layout with the arms of the calibration."""
    maps: TransmissionMaps
    """Of the calibration."""
    measured_C: float | None
    """Temperature at which the arms were measured; None: it was not noted."""
    expansion: KnownExpansion
    layout: str
    """Mark of the layout: observations of another array show nothing."""
    felt: Felt = NOT_ASKED
    seen: tuple[float, float] = (np.nan, np.nan)
    """Growth against the calibration that the blind move has shown, a ratio, and its standard error."""

    @classmethod
    def of(
        cls, calibrated: FocalPlane, maps: TransmissionMaps, measured_C: float | None, layout: str
    ) -> WarmArms | None:
        """With what the instrument says of its expansion; None where it does not, or has no thermometer.

        `calibrated`: the layout with the arms in use; `maps`: of the transmissions; `measured_C`: at which
        the arms were measured, deg C; `layout`: mark of the array.
        """
        expansion = calibrated.instrument.expansion
        if expansion is None or not has_thermometer(calibrated.instrument):
            return None
        return cls(calibrated, maps, measured_C, KnownExpansion.nominal(expansion), layout)

    def learn(self, file: Path) -> None:
        """Takes the expansion from the observations of a store, where they show it better."""
        if file.exists():
            with Store.read(file) as store:
                self.expansion = learnt_expansion(self.expansion, nights_of(store, self.layout))

    async def feel(self, source: Source) -> None:
        """Asks the positioners of `source` for their temperature."""
        hardware = await source.open()
        client = Client(hardware.bus)
        try:
            await client.discover()
            self.felt = await felt(client, self.calibrated.instrument)
        finally:
            await hardware.bus.close()

    @property
    def growth(self) -> float:
        """Of the arms against the calibration, a ratio; 0 where a temperature is not known."""
        if self.felt.at_C is None or self.measured_C is None:
            return 0.0
        return self.expansion.per_K * (self.felt.at_C - self.measured_C)

    @property
    def why_not(self) -> str:
        """Why arms are taken as they were measured; empty: they are not."""
        if self.felt.at_C is None:
            return self.felt.why
        return "the temperature at which they were measured was not noted" if self.measured_C is None else ""

    @property
    def contradiction(self) -> str:
        """What the blind move has shown against the temperature; empty: nothing."""
        seen, sigma = self.seen
        off = seen - self.growth
        if not (abs(off) > _SURE * sigma and abs(off) > abs(seen)):
            return ""
        return (
            f"arms are {_PPM * off:+.0f} ppm ({_PPM * sigma:.0f}) off what the temperature makes of them, "
            f"and {_PPM * seen:+.0f} as measured: the thermometers or the instrument's expansion are wrong"
        )

    def grown(self, plane: FocalPlane) -> FocalPlane:
        """The layout of a `plane` at this temperature."""
        return grown(plane, self.growth)

    def look(self, wire_deg: Floats, xy_mm: Floats, counted: Flags) -> None:
        """Takes what a move shows; the first one that shows anything counts.

        `wire_deg`: (N, 2) as reported, deg; `xy_mm`: (N, 2) metrology fibres in its image; `counted`: (N,).
        """
        if np.isfinite(self.seen[0]):
            return
        angles_deg = self.maps.to_output(wire_deg)
        self.seen = growth_seen(self.calibrated, angles_deg, xy_mm, counted)

    def record(self, run: Run) -> None:
        """Notes temperature and growth in the store, for the nights that follow."""
        run.record_part(
            TEMPERATURE, pack(self.summary() | {"layout": self.layout, "calibration": self._mark()})
        )

    def summary(self) -> dict[str, Any]:
        """Entries of summary.json; ppm of the arms' length."""
        growth, sigma = (_PPM * value if np.isfinite(value) else None for value in self.seen)
        return {
            "at_C": self.felt.at_C,
            "arms_measured_C": self.measured_C,
            "arms_grown_ppm": _PPM * self.growth,
            "expansion_ppm_K": _PPM * self.expansion.per_K,
            "expansion_sd_ppm_K": _PPM * self.expansion.sd_per_K,
            "nights": self.expansion.nights,
            "arms_seen_ppm": growth,
            "arms_seen_sd_ppm": sigma,
            "why_not": self.why_not,
            "contradiction": self.contradiction,
        }

    def _mark(self) -> str:
        digest = hashlib.sha256()
        plane, maps = self.calibrated, self.maps
        lengths = (plane.arms[:, L_ALPHA], plane.points[METROLOGY])
        for values in (*lengths, maps.positioner_id, maps.wire_deg, maps.output_deg):
            digest.update(np.ascontiguousarray(values).tobytes())
        return digest.hexdigest()[:16]


def nights_of(store: Store, layout: str) -> list[NightGrowth]:
    """What the observations of a store have shown of the arms of the array with the mark `layout`."""
    heads = [part.head for _, part in sorted(store.parts_named(TEMPERATURE).items())]
    return [
        NightGrowth(
            head["at_C"], head["arms_seen_ppm"] / _PPM, head["arms_seen_sd_ppm"] / _PPM, head["calibration"]
        )
        for head in heads
        if head["layout"] == layout and head["at_C"] is not None and head["arms_seen_ppm"] is not None
    ]
