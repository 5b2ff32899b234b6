"""The cameras of the paper's bench: one fibre, no fiducials, a lens that is known. Fig. 18.

Each positioner has a camera of its own, which never moves. Only the pixels near the light are made:
the rest of the frame would hold noise and nothing to find.
"""

from __future__ import annotations

import numpy as np

from fiberloom._core import metrology as _core
from fiberloom.instruments.model import METROLOGY
from fiberloom.metrology import Measurement, Profile, SpotSettings, find_spots
from fiberloom.twin.camera.imaging import PSF_KINDS, CameraModel
from fiberloom.twin.camera.models import camera_model
from fiberloom.twin.twin import Twin
from fiberloom.typing import Array, Floats
from fiberloom.units import UM_PER_MM

_WIDTHS = 4.0
"""Half of the window in widths of the spot."""
_GRID = 5
"""The profile is measured once, on a frame with the fibre at so many places squared."""


class SpotBench:
    """One spot through light, detector and centroid."""

    def __init__(self, model: CameraModel, seed: int) -> None:
        self.model, self._rng = model, np.random.default_rng([seed, 0xBE7C])
        # odd, so that the pixel under the fibre is the middle one
        self.half_px = int(np.ceil(_WIDTHS * model.psf.fwhm_px))
        self.settings = SpotSettings(
            model.detector.gain_e_adu * model.average,
            model.detector.bias_adu + model.detector.full_well_e / model.detector.gain_e_adu,
        )
        self.profile = self._measure_profile()

    def measure_px(self, xy_px: Floats) -> tuple[Floats, Floats]:
        """Where a fibre at `xy_px` (2,) is seen, and the covariance (2, 2) in px^2; NaN: not at all."""
        corner = np.floor(xy_px).astype(int) - self.half_px
        image = self._image(np.atleast_2d(xy_px - corner), 2 * self.half_px + 1)
        spots = find_spots(image, self.settings, profile=self.profile).spots
        if not len(spots):
            return np.full(2, np.nan), np.full((2, 2), np.nan)
        brightest = int(np.argmax(spots.flux_e))
        return spots.xy_px[brightest] + corner, spots.covariance_px2[brightest]

    def _image(self, xy_px: Floats, size: int) -> Array:
        """The mean of as many exposures as the model says."""
        psf, light, d = self.model.psf, self.model.light, self.model.detector
        n = len(xy_px)
        shape = psf.ellipses_px2(np.zeros((n, 2)))
        table = np.column_stack([xy_px, np.full(n, light.fibre_e), shape, np.full(n, psf.parameter)])
        bright = np.zeros((size, size), dtype=np.float32)
        _core.render_spots(bright, np.ascontiguousarray(table), PSF_KINDS[psf.kind], psf.end_q)
        detector = [d.gain_e_adu, d.read_noise_e, d.bias_adu, d.full_well_e]
        frames = [
            _core.expose(bright, [light.background_e, 0.0, 0.0], detector, int(self._rng.integers(2**62)))
            for _ in range(self.model.average)
        ]
        return frames[0] if len(frames) == 1 else np.asarray(np.mean(frames, axis=0, dtype=np.float32))

    def _measure_profile(self) -> Profile:
        step = 2 * self.half_px + 1
        places = step * (np.stack(np.meshgrid(*2 * [np.arange(_GRID)]), -1).reshape(-1, 2) + 0.5)
        places = places + self._rng.uniform(-0.5, 0.5, places.shape)
        return find_spots(self._image(places, _GRID * step), self.settings).profile


class BenchCamera:
    """Sees the metrology fibres of a bench through images. Implements `fiberloom.metrology.Camera`.

    `name`: workspace (all of a workspace in view, 669 nm rms) or close-up (ten images averaged, 101
    nm), or a model of your own. Positions are exact but for photons and pixels: the lens is known.
    """

    def __init__(self, twin: Twin, name: str | CameraModel = "workspace", seed: int = 0) -> None:
        self._twin = twin
        model = camera_model(name) if isinstance(name, str) else name
        self._lens = model.optics.geometry.similarity()
        self._bench = SpotBench(model, seed)

    def measure(self, expected_mm: Floats | None = None) -> Measurement:
        """Takes an image of each fibre now."""
        centre = self._twin.plane.centres_mm
        true_mm = self._twin.fibre_xy(METROLOGY) - centre
        lit = ~self._twin.dark & np.isfinite(true_mm).all(axis=1)
        xy, covariance = np.full((len(lit), 2), np.nan), np.full((len(lit), 2, 2), np.nan)
        jacobian = self._lens.jacobian
        for row in np.flatnonzero(lit):
            px, px2 = self._bench.measure_px(self._lens.to_px(true_mm[row : row + 1])[0])
            xy[row] = self._lens.to_mm(px[None])[0] + centre[row]
            covariance[row] = jacobian @ px2 @ jacobian.T
        seen = np.isfinite(xy).all(axis=1)
        return Measurement(xy[:, 0], xy[:, 1], seen, self._twin.time_s, covariance)


def static_fibre_um(name: str | CameraModel, n_images: int, seed: int = 0) -> tuple[Floats, float]:
    """Fig. 18: positions (n_images, 2) of a fibre that does not move, in um about their mean, and the
    2-D rms that the centroids state."""
    model = camera_model(name) if isinstance(name, str) else name
    bench, scale_um = SpotBench(model, seed), UM_PER_MM * model.optics.geometry.scale_mm_px
    at = np.random.default_rng([seed, 18]).uniform(500.0, 501.0, 2)
    seen = [bench.measure_px(at) for _ in range(n_images)]
    xy = scale_um * np.array([px for px, _ in seen])
    stated = scale_um * float(np.sqrt(np.mean([np.trace(px2) for _, px2 in seen])))
    return xy - xy.mean(axis=0), stated
