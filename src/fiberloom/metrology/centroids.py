"""Spots of an image in one call."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fiberloom.metrology.images import CameraImage, read_image
from fiberloom.metrology.spots import Spots, SpotSettings, find_spots
from fiberloom.typing import Array

_READ_AS_THEY_ARE = (np.uint16, np.float32, np.float64)


def centroid(
    image: str | Path | Array,
    *,
    gain_e_adu: float | None = None,
    saturation_adu: float | None = None,
    threshold: float = 6.0,
) -> Spots:
    """Every spot of light in an image, at the photon limit.

    Parameters
    ----------
    image : str, Path or numpy.ndarray
        A FITS file, or pixels (rows, columns) of any number type.
    gain_e_adu : float, optional
        Electrons per digital unit; the header's when left out, else 1.
    saturation_adu : float, optional
        Pixels at or above are not used; the header's when left out, else what the pixels can hold.
    threshold : float
        Brightest pixel of the faintest spot, in sigmas of the background's noise; at least 3.

    Returns
    -------
    Spots
        From the top of the image; the centre of the first pixel is (0, 0). Positions and their
        covariances in px, fluxes in electrons.

    Raises
    ------
    InputError
        No such file, no image in it, fewer than 8 x 8 pixels, or a number out of its range.

    Examples
    --------
    >>> import numpy as np
    >>> import fiberloom as fl
    >>> y, x = np.mgrid[:64, :64]
    >>> noise = np.random.default_rng(0).normal(100.0, 3.0, (64, 64))
    >>> spots = fl.centroid(noise + 5000.0 * np.exp(-((x - 30.25) ** 2 + (y - 20.5) ** 2) / 4.0))
    >>> spots
    Spots(1 spot, 0 flagged)
    >>> bool(abs(spots.x_px[0] - 30.25) < 0.02)
    True
    """
    if isinstance(image, str | Path):
        taken = read_image(image, gain_e_adu=gain_e_adu, saturation_adu=saturation_adu)
    else:
        taken = _of_array(np.asarray(image), gain_e_adu, saturation_adu)
    settings = SpotSettings(taken.gain_e_adu, taken.saturation_adu, threshold)
    return find_spots(taken.pixels, settings, fits_bytes=taken.fits_bytes).spots


def _of_array(pixels: Array, gain_e_adu: float | None, saturation_adu: float | None) -> CameraImage:
    if pixels.dtype not in _READ_AS_THEY_ARE:
        pixels = pixels.astype(np.float64)
    full = 65535.0 if pixels.dtype == np.uint16 else np.inf
    return CameraImage(
        np.ascontiguousarray(pixels),
        gain_e_adu=1.0 if gain_e_adu is None else gain_e_adu,
        saturation_adu=full if saturation_adu is None else saturation_adu,
    )
