"""Detection and centroids; px, ADU. See fiberloom.metrology."""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy
import numpy.typing
from numpy.typing import NDArray


COLUMNS: str = ...

class Settings:
    """What is known of the camera, and what counts as a spot."""

    def __init__(self, gain_e_adu: float, saturation_adu: float, threshold: float, fwhm_px: float) -> None:
        """
        threshold: brightest pixel over the noise. fwhm_px: a hint for the first look, 0 for none.
        """

def find_spots(image: numpy.typing.NDArray[Any], fits: bool, settings: Settings, profile: numpy.typing.NDArray[numpy.float64]) -> tuple[numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.uint32], numpy.typing.NDArray[numpy.float64], float, float]:
    """
    Table (N, 9), flags (N,), profile, background and noise in ADU. The image is uint16, float32 or float64, or with `fits` the bytes of a FITS file as uint16 or uint32. profile: empty, or one that this function returned.
    """

def find_expected(image: numpy.typing.NDArray[Any], fits: bool, settings: Settings, profile: numpy.typing.NDArray[numpy.float64], expected_xy_px: numpy.typing.NDArray[numpy.float64], radius_px: float) -> tuple[numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.uint32], numpy.typing.NDArray[numpy.float64], float, float]:
    """As find_spots, one row per expected position."""

def fwhm(profile: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], xy_px: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order='C', device='cpu', writable=False)]) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,))]]:
    """FWHM of the profile at positions."""

def render_spots(image: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu')], spots: Annotated[NDArray[numpy.float64], dict(shape=(None, 7), order='C', device='cpu', writable=False)], kind: int, radius_q: float) -> None:
    """
    Adds pixel-integrated spots (x, y, flux, S_xx, S_xy, S_yy, parameter) to a float32 image.
    """

def expose(light_e: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], sky: Sequence[float], detector: Sequence[float], seed: int, threads: int = 1) -> Annotated[NDArray[numpy.uint16], dict(shape=(None, None))]:
    """
    uint16 image: Poisson and read noise on light + sky (level, slope_x, slope_y), then detector (gain_e_adu, read_noise_e, bias_adu, full_well_e).
    """

class Lights:
    """What shines in an image, in electrons."""

    def __init__(self, spots: Annotated[NDArray[numpy.float64], dict(shape=(None, 7), order='C', device='cpu', writable=False)], kind: int, radius_q: float, pixels: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], electrons: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> None:
        """
        Spots as of `render_spots`, and `electrons` in single `pixels`: places row by row.
        """

def expose_lights(lights: Lights, shape: Sequence[int], sky: Sequence[float], detector: Sequence[float], seed: int, threads: int = 1) -> Annotated[NDArray[numpy.uint16], dict(shape=(None, None))]:
    """
    The image (rows, columns) that `expose` makes of lights that are rendered into one of `shape`, without painting it as a whole first.
    """

def wave_sums(xy: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order='C', device='cpu', writable=False)], waves: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]:
    """
    (N,) sums of the cosines of plane waves (k_x, k_y, phase) at places (N, 2); NaN where one is NaN.
    """
