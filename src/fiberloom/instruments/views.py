"""What follows at once from the arrays of a focal plane, and a mark that changes with any of them."""

import hashlib
from collections.abc import Iterable
from typing import Any

import numpy as np

from fiberloom.instruments.arms import ALPHA_OFF, BETA_OFF, CENTRE, L_ALPHA
from fiberloom.instruments.axis import Ranges
from fiberloom.instruments.model import METROLOGY, Instrument
from fiberloom.typing import Array, Floats, Ints
from fiberloom.units import AXES


class Views:
    """Of a `FocalPlane`, which has these."""

    instrument: Instrument
    positioner_id: Ints
    arms: Floats
    points: dict[str, Floats]
    ranges: Ranges | None

    @property
    def n(self) -> int:
        """Number of positioners."""
        return len(self.positioner_id)

    @property
    def centres_mm(self) -> Floats:
        """(N, 2) alpha axes."""
        return self.arms[:, CENTRE]

    @property
    def l_alpha_mm(self) -> Floats:
        """(N,) from the alpha to the beta axis."""
        return self.arms[:, L_ALPHA]

    @property
    def l_beta_mm(self) -> Floats:
        """(N,) from the beta axis to the metrology fibre."""
        return np.asarray(np.hypot(*self.points[METROLOGY].T), dtype=np.float64)

    @property
    def metrology_phi_rad(self) -> Floats:
        """(N,) direction of the metrology fibre in the frame of its beta arm."""
        return np.arctan2(self.points[METROLOGY][:, 1], self.points[METROLOGY][:, 0])

    @property
    def alpha_off_rad(self) -> Floats:
        """(N,) direction in the focal plane of alpha = 0."""
        return self.arms[:, ALPHA_OFF]

    @property
    def beta_off_rad(self) -> Floats:
        """(N,) direction of beta = 0 against the alpha arm."""
        return self.arms[:, BETA_OFF]

    @property
    def collision_buffer_mm(self) -> float:
        """Radius of the beta arm's capsule."""
        return self.instrument.bodies.collision_buffer_mm

    @property
    def beta_segment_mm(self) -> tuple[float, float]:
        """Centre line of that capsule, from and to along the arm."""
        return self.instrument.bodies.beta_segment_mm

    @property
    def park_deg(self) -> Floats:
        """(N, 2) folded: where positioners wait, within the range of each."""
        folded = np.tile(self.instrument.positioner.park_deg, (self.n, 1))
        return (
            folded if self.ranges is None else np.clip(folded, *np.moveaxis(self.ranges.targets_deg, -1, 0))
        )

    @property
    def limits_deg(self) -> Floats:
        """[[alpha_min, alpha_max], [beta_min, beta_max]] for targets, of the nominal positioner."""
        return np.array([axis.target_range_deg for axis in self.instrument.axes])

    @property
    def hard_stops_deg(self) -> Floats:
        """[[alpha_min, alpha_max], [beta_min, beta_max]] of the nominal positioner's mechanism."""
        return np.array([axis.hard_stop_deg for axis in self.instrument.axes])

    def limits_of(self, rows: Ints | None = None) -> Floats:
        """(n, 2, 2) deg: as `limits_deg`, of positioners by row; of all when left out."""
        return self._own_or_nominal("targets_deg", self.limits_deg, rows)

    def stops_of(self, rows: Ints | None = None) -> Floats:
        """(n, 2, 2) deg: as `hard_stops_deg`, of positioners by row; of all when left out."""
        return self._own_or_nominal("stops_deg", self.hard_stops_deg, rows)

    def _own_or_nominal(self, name: str, nominal: Floats, rows: Ints | None) -> Floats:
        if self.ranges is not None:
            own = self.ranges.arrays[name]
            return own if rows is None else own[rows]
        return np.broadcast_to(nominal, (self.n if rows is None else len(rows), 2, 2))

    @property
    def science_fibres(self) -> tuple[str, ...]:
        """Fibres that targets can ask for."""
        return self.instrument.science_fibres


def marked_text(instrument: Instrument) -> str:
    """JSON of what makes another array of an `instrument`: without `care`, `expansion`, `drive`, `sky`, and
    keys younger than the marks of old files where they are not set.
    """
    axes: dict[str, Any] = {
        name: {"steps_per_turn"} if axis.steps_per_turn is None else set()
        for name, axis in zip(AXES, instrument.axes, strict=True)
    }
    layout = {name for name in ("modules", "dots") if getattr(instrument.layout, name) is None}
    without: dict[str, Any] = {"care": True, "expansion": True, "drive": True, "sky": True, "layout": layout}
    return instrument.model_dump_json(exclude=without | axes)


def mark_of(text: str, arrays: Iterable[tuple[str, Any]]) -> str:
    """16 hex digits of a text and of arrays, in their order; what is no array is passed over."""
    digest = hashlib.sha256(text.encode())
    for name, values in arrays:
        if isinstance(values, np.ndarray):
            _feed(digest, name, values)
    return digest.hexdigest()[:16]


def _feed(digest: "hashlib._Hash", name: str, values: Array) -> None:
    # rounded to 1e-9 so that deg in a file and back is the same; adding 0.0 makes -0.0 to 0.0
    plain = np.ascontiguousarray(values.round(9) + 0.0 if values.dtype.kind == "f" else values)
    digest.update(name.encode())
    if plain.dtype.kind == "U":
        digest.update("\0".join(plain).encode())
    else:
        digest.update(plain.astype(plain.dtype.newbyteorder("<")).tobytes())
