"""Spots of light in an image: found in C++ at the photon limit, kept as arrays, written as CSV.

Pixel coordinates: the centre of the first pixel is (0, 0), x runs along a row.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from enum import IntFlag
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiberloom._core import metrology as _core
from fiberloom.errors import InputError
from fiberloom.richtext import html_rows
from fiberloom.tables import read_table
from fiberloom.timing import part
from fiberloom.typing import Array, Flags, Floats
from fiberloom.wholefile import whole

CSV_COLUMNS = ("x_px", "y_px", "x_err_px", "y_err_px", "flux_e", "flags")
_NOT_MEASURED = np.zeros(0)


class Flag(IntFlag):
    """What a user of a spot must know; the same bits as in the C++ header."""

    SATURATED = 1
    """Pixels at the saturation level, left out of the fit."""
    BLENDED = 2
    """Another spot within two FWHM."""
    TRUNCATED = 4
    """The edge of the image cuts the fitted region."""
    COSMIC = 8
    """Pixels that are not the spot's (cosmic ray, hot, dead), left out."""
    POOR_SHAPE = 16
    """Residuals larger than noise and profile explain."""
    NOT_FOUND = 32
    """Guided mode: nothing at the expected position."""
    SHARED = 64
    """Guided mode: two expected positions found the same spot."""


@dataclass(frozen=True)
class Profile:
    """The shape of the spots of one camera, measured in one image and good for the next ones."""

    packed: Floats = field(default_factory=lambda: _NOT_MEASURED)

    @property
    def measured(self) -> bool:
        """False for the empty profile, which asks for a measurement."""
        return len(self.packed) > 0 and self.n_spots > 0

    @property
    def n_spots(self) -> int:
        """How many spots it was measured on."""
        return int(self.packed[-1])

    @property
    def misfit(self) -> float:
        """Rms of what the profile leaves over beyond noise, as a share of the pixel's light."""
        return float(self.packed[-2])

    def fwhm_px(self, xy_px: ArrayLike) -> Floats:
        """FWHM (geometric mean of the two axes) at positions (n, 2) in the image."""
        return _core.fwhm(self.packed, np.ascontiguousarray(xy_px, dtype=np.float64))[0]


@dataclass(frozen=True)
class SpotSettings:
    """What detection and fit need to know of the camera."""

    gain_e_adu: float = 1.0
    """Electrons per digital unit. Wrong by a third it costs 1 % of the precision, and it scales
    the errors of bright spots with its square root."""
    saturation_adu: float = np.inf
    """Pixels at or above are not used."""
    threshold: float = 6.0
    """Brightest pixel of the faintest spot, in units of the noise of the background."""
    fwhm_px: float = 0.0
    """A hint for images without a spot that tells; 0: none. The image decides."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.gain_e_adu) and self.gain_e_adu > 0):
            raise InputError(f"gain {self.gain_e_adu} e-/ADU: must be above 0")
        if not self.threshold >= 3:
            raise InputError(
                f"threshold {self.threshold}: must be at least 3 times the noise, "
                "or every frame is full of spots"
            )


@dataclass(frozen=True)
class Spots:
    """n spots of light in an image, as arrays over spots. Made by `centroid`.

    Pixel coordinates: the centre of the first pixel is (0, 0), x runs along a row.

    Examples
    --------
    >>> import numpy as np
    >>> import fiberloom as fl
    >>> y, x = np.mgrid[:64, :64]
    >>> noise = np.random.default_rng(0).normal(100.0, 3.0, (64, 64))
    >>> spots = fl.centroid(noise + 5000.0 * np.exp(-((x - 30.25) ** 2 + (y - 20.5) ** 2) / 4.0))
    >>> spots.xy_px.round(1).tolist(), bool(spots.x_err_px[0] < 0.01)
    ([[30.2, 20.5]], True)
    """

    x_px: Floats
    """(n,) position."""
    y_px: Floats
    covariance_px2: Floats
    """(n, 2, 2)."""
    flux_e: Floats
    flux_err_e: Floats
    background_adu: Floats
    chi2: Floats
    """Per degree of freedom."""
    flags: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.x_px)

    def __repr__(self) -> str:
        n = len(self)
        return f"Spots({n} spot{'' if n == 1 else 's'}, {int(np.count_nonzero(self.flags))} flagged)"

    def _repr_html_(self) -> str:
        rows = [
            {
                "x [px]": float(self.x_px[k]),
                "y [px]": float(self.y_px[k]),
                "error [px]": float(np.hypot(self.x_err_px[k], self.y_err_px[k])),
                "flux [e]": float(self.flux_e[k]),
                "flags": str(Flag(int(self.flags[k])).name or "-"),
            }
            for k in range(min(len(self), 5))
        ]
        return html_rows(repr(self), rows)

    @property
    def xy_px(self) -> Floats:
        """Positions (n, 2)."""
        return np.column_stack([self.x_px, self.y_px])

    @property
    def x_err_px(self) -> Floats:
        """Standard error of x."""
        return np.sqrt(self.covariance_px2[:, 0, 0])

    @property
    def y_err_px(self) -> Floats:
        """Standard error of y."""
        return np.sqrt(self.covariance_px2[:, 1, 1])

    def has(self, flag: Flag) -> Flags:
        """Which spots carry a flag.

        Parameters
        ----------
        flag : Flag
            E.g. ``Flag.SATURATED``, of fiberloom.metrology.

        Returns
        -------
        (n,) bool

        Examples
        --------
        >>> import numpy as np
        >>> import fiberloom as fl
        >>> from fiberloom.metrology import Flag
        >>> noise = np.random.default_rng(0).normal(100.0, 3.0, (64, 64))
        >>> fl.centroid(noise).has(Flag.SATURATED)
        array([], dtype=bool)
        """
        flagged: Flags = (self.flags & np.uint32(flag)) != 0
        return flagged

    def select(self, which: ArrayLike) -> Spots:
        """Some of the spots.

        Parameters
        ----------
        which : array_like
            Rows or a mask.

        Returns
        -------
        Spots

        Examples
        --------
        >>> import numpy as np
        >>> import fiberloom as fl
        >>> noise = np.random.default_rng(0).normal(100.0, 3.0, (64, 64))
        >>> spots = fl.centroid(noise)
        >>> spots.select(spots.flags == 0)
        Spots(0 spots, 0 flagged)
        """
        return Spots(*(getattr(self, f.name)[which] for f in fields(self)))


@dataclass(frozen=True)
class Found:
    """What one image gave."""

    spots: Spots
    profile: Profile
    background_adu: float
    noise_adu: float


@part("centroids")
def find_spots(
    image: Array,
    settings: SpotSettings | None = None,
    *,
    profile: Profile | None = None,
    fits_bytes: bool = False,
) -> Found:
    """Every spot in an `image` (uint16, float32 or float64, in adu), from the top.

    The image is read where it lies. `settings`: detector and threshold, defaults when None. `profile`
    of an earlier image of the same camera saves its measurement. `fits_bytes`: see
    `CameraImage.fits_bytes`.
    """
    s = settings or SpotSettings()
    result = _core.find_spots(_pixels(image), fits_bytes, _settings(s), (profile or Profile()).packed)
    return _found(result, s)


@part("centroids")
def find_expected(
    image: Array,
    expected_xy_px: ArrayLike,
    radius_px: float,
    settings: SpotSettings | None = None,
    *,
    profile: Profile | None = None,
    fits_bytes: bool = False,
) -> Found:
    """One spot per expected position, the nearest within `radius_px`; see Flag.NOT_FOUND.

    `image` in adu and `fits_bytes` as in `find_spots`; `expected_xy_px` (n, 2); `settings`: detector
    and threshold, defaults when None; `profile` of an earlier image of the same camera saves its
    measurement.
    """
    s = settings or SpotSettings()
    expected = np.ascontiguousarray(expected_xy_px, dtype=np.float64)
    if expected.ndim != 2 or expected.shape[1] != 2 or not np.isfinite(expected).all():
        raise InputError("expected positions: an array (n, 2) of finite pixel coordinates")
    if not radius_px > 0:
        raise InputError(f"search radius {radius_px} px: must be above 0")
    packed = (profile or Profile()).packed
    result = _core.find_expected(_pixels(image), fits_bytes, _settings(s), packed, expected, radius_px)
    return _found(result, s)


def _settings(s: SpotSettings) -> _core.Settings:
    return _core.Settings(s.gain_e_adu, s.saturation_adu, s.threshold, s.fwhm_px)


def _pixels(image: Array) -> Array:
    if image.ndim != 2:
        raise InputError(f"image: {image.ndim} dimensions, 2 are needed")
    if min(image.shape) < 8:
        raise InputError(f"image: {image.shape[1]} x {image.shape[0]} px is too small, 8 x 8 needed")
    return image


def _found(result: tuple[Any, ...], s: SpotSettings) -> Found:
    table, flags, packed, background, noise = result
    x, y, xx, xy, yy, flux, flux_err, level, chi2 = table.T.copy()
    covariance = np.stack([np.stack([xx, xy], 1), np.stack([xy, yy], 1)], 1)
    gain = s.gain_e_adu
    spots = Spots(x, y, covariance, gain * flux, gain * flux_err, level, chi2, flags)
    return Found(spots, Profile(packed), background, noise)


def write_spots(spots: Spots, path: Path, comments: dict[str, object] | None = None) -> None:
    """CSV with `CSV_COLUMNS`; comments as `# key: value` lines above the header."""
    rows = np.column_stack(
        [spots.x_px, spots.y_px, spots.x_err_px, spots.y_err_px, spots.flux_e, spots.flags]
    )
    with whole(path) as part, part.open("w", encoding="utf-8") as out:
        for key, value in (comments or {}).items():
            out.write(f"# {key}: {value}\n")
        out.write(",".join(CSV_COLUMNS) + "\n")
        for row in rows:
            out.write("{:.5f},{:.5f},{:.5f},{:.5f},{:.1f},{:.0f}\n".format(*row))


MOST_ERROR_PX = 1e4
"""A position that is less certain is none."""


def read_spots(path: str | Path) -> Spots:
    """Spots of a table with at least x_px, y_px; what is missing is taken as 0.01 px, flux 1."""
    table = read_table(path)
    table.require("x_px", "y_px")
    n = len(table)

    def column(name: str, default: float) -> Floats:
        return table.numbers(name) if name in table else np.full(n, default)

    x_err, y_err = column("x_err_px", 0.01), column("y_err_px", 0.01)
    for name, error in (("x_err_px", x_err), ("y_err_px", y_err)):
        for row in np.flatnonzero(~((error > 0.0) & (error < MOST_ERROR_PX))).tolist():
            raise table.error(row, name, f"= {error[row]:g}: must be above 0 and below {MOST_ERROR_PX:g} px")
    flags = table.integers("flags") if "flags" in table else np.zeros(n, dtype=np.int64)
    for row in np.flatnonzero((flags < 0) | (flags > sum(Flag))).tolist():
        raise table.error(row, "flags", f"= {flags[row]}: must be a sum of 1, 2, 4, ... up to {sum(Flag)}")
    covariance = np.zeros((n, 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = x_err**2, y_err**2
    unknown = np.full(n, np.nan)
    return Spots(
        table.numbers("x_px"), table.numbers("y_px"), covariance, column("flux_e", 1.0),
        unknown, unknown, unknown, flags.astype(np.uint32),
    )  # fmt: skip
