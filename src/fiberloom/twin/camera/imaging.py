"""The camera of the twin: from true fibre positions to a noisy image.

Fibres and fiducials go through turbulence and vibration (in the focal plane), distortion, rotation
and scale onto the detector, where each becomes a spot integrated over the pixels; then background,
strays, cosmic rays, hot pixels, photon and read noise, full well, gain, bias and rounding. Nothing
is added to positions: what a measurement scatters by comes out of photons and pixels.

Electrons are those of one exposure; several exposures can be averaged. A seed gives the same image
again; every exposure of a camera draws new noise.
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiberloom._core import metrology as _core
from fiberloom.errors import InputError
from fiberloom.metrology import zhao_burge
from fiberloom.metrology.acquisition import CameraGeometry
from fiberloom.metrology.images import CameraImage
from fiberloom.timing import core_count, part
from fiberloom.twin.camera.air import air_shift_mm
from fiberloom.twin.twin import Twin
from fiberloom.typing import Floats, Ints
from fiberloom.units import MM_PER_UM
from fiberloom.version import __version__

PSF_KINDS = {"gaussian": 0, "moffat": 1, "disc": 2}
_FWHM_PER_SIGMA = 2.3548200450309493
_DRIFT = 0xD21F
_END = 1e-6
"""Share of the peak where a painted spot ends."""


@dataclass(frozen=True)
class Psf:
    """The shape of a spot, over the field."""

    kind: str = "gaussian"
    """gaussian, moffat, or disc (a fibre tip large against the pixel)."""
    fwhm_px: float = 3.5
    beta: float = 3.0
    """Of the Moffat function."""
    edge: float = 0.1
    """Of the disc: blur of its rim, as a share of the radius."""
    ellipticity: float = 0.0
    """(a - b) / (a + b) of the axes."""
    angle_deg: float = 0.0
    growth: float = 0.0
    """How much wider spots are at the edge of the field: 0.2 is 20 %."""
    astigmatism: float = 0.0
    """How much longer in the radial direction they are there."""

    def __post_init__(self) -> None:
        if self.kind not in PSF_KINDS:
            raise InputError(f"psf '{self.kind}': known are {', '.join(PSF_KINDS)}")
        if not self.fwhm_px > 0:
            raise InputError(f"psf: fwhm_px {self.fwhm_px} must be above 0")

    @property
    def parameter(self) -> float:
        """What the painter needs besides the ellipse, dimensionless."""
        return {"gaussian": 0.0, "moffat": self.beta, "disc": self.edge}[self.kind]

    @property
    def end_q(self) -> float:
        """Elliptical radius squared at which the spot ends, relative to its core."""
        if self.kind == "disc":
            return (1 + 5 * self.edge) ** 2
        return float(-2 * np.log(_END) if self.kind == "gaussian" else _END ** (-1 / self.beta) - 1)

    def ellipses_px2(self, place: Floats) -> Floats:
        """(n, 3) S_xx, S_xy, S_yy at places (n, 2) relative to the radius of the field."""
        r2 = np.sum(place**2, axis=1)
        width = self._core_px() * (1 + self.growth * r2)
        a, b = np.sqrt((1 + self.ellipticity) / (1 - self.ellipticity)), 1.0
        c, s = np.cos(np.deg2rad(self.angle_deg)), np.sin(np.deg2rad(self.angle_deg))
        turn = np.array([[c, -s], [s, c]])
        shape = turn @ np.diag([a, b / a]) @ turn.T
        longer = self.astigmatism * place[:, :, None] * place[:, None, :]
        full = width[:, None, None] ** 2 * (shape + longer)
        return np.column_stack([full[:, 0, 0], full[:, 0, 1], full[:, 1, 1]])

    def _core_px(self) -> float:
        """Length that makes q = 1."""
        if self.kind == "gaussian":
            return self.fwhm_px / _FWHM_PER_SIGMA
        if self.kind == "disc":
            return self.fwhm_px / 2
        return float(self.fwhm_px / (2 * np.sqrt(2 ** (1 / self.beta) - 1)))


@dataclass(frozen=True)
class Detector:
    """Electrons to digital units, and the detector's blemishes."""

    gain_e_adu: float = 1.0
    read_noise_e: float = 10.0
    bias_adu: float = 500.0
    full_well_e: float = 60_000.0
    hot_share: float = 0.0
    """Share of the pixels that are hot; they stay the same."""
    hot_e: float = 3000.0
    """Mean of their exponential distribution."""
    cosmic_rays: float = 0.0
    """Per exposure, on average."""


@dataclass(frozen=True)
class Light:
    """What shines, in electrons of one exposure."""

    fibre_e: float = 250_000.0
    fiducial_e: float = 250_000.0
    scatter: float = 0.2
    """Of fluxes from spot to spot, standard deviation of the logarithm."""
    background_e: float = 100.0
    """Per pixel."""
    gradient_e: float = 0.0
    """Background at the right edge less that at the left."""
    strays: int = 0
    """Spots without a fibre, at fixed places."""


@dataclass(frozen=True)
class Optics:
    """From the focal plane to the detector, and what the air does in between."""

    geometry: CameraGeometry
    field_radius_mm: float
    distortion_mm: Mapping[int, float] = field(default_factory=dict)
    """Zhao-Burge terms (polid: rms mm over the field)."""
    radial: tuple[float, float] = (0.0, 0.0)
    """p (k3 (r/R)^2 + k5 (r/R)^4), beside the terms."""
    turbulence_um: float = 0.0
    """Rms per coordinate of the correlated shifts, new in every exposure."""
    turbulence_length_mm: float = 50.0
    vibration_um: float = 0.0
    """Rms per coordinate of the shift of a whole exposure."""
    turned_deg: float = 0.0
    """By which a rotator has turned the focal plane before the lens."""

    drift_um: float = 0.0
    """Rms per coordinate of a smooth distortion over the field, beside the terms."""
    drift_length_mm: float = 150.0
    """Of its correlation."""
    drift_seed: int = 0

    def to_px(self, xy_mm: ArrayLike) -> Floats:
        """Where a point of the focal plane falls on the detector."""
        p = self._before_the_lens(np.asarray(xy_mm, dtype=np.float64))
        place = p / self.field_radius_mm
        terms = list(self.distortion_mm)
        values = np.array([self.distortion_mm[t] for t in terms])
        bent = zhao_burge.field(place, values, terms)
        r2 = np.sum(place**2, axis=1, keepdims=True)
        k3, k5 = self.radial
        drift = air_shift_mm(
            p, self.drift_um, self.drift_length_mm, np.random.default_rng([self.drift_seed, _DRIFT])
        )
        return self.geometry.similarity().to_px(p + bent + drift + p * (k3 * r2 + k5 * r2**2))

    def _before_the_lens(self, xy_mm: Floats) -> Floats:
        """Turned back by as much as an image is turned: what the lens bends stays with the camera."""
        cos, sin = np.cos(np.deg2rad(self.turned_deg)), np.sin(np.deg2rad(self.turned_deg))
        turned: Floats = xy_mm @ np.array([[cos, -sin], [sin, cos]])
        return turned


@dataclass(frozen=True)
class CameraModel:
    """A true camera."""

    optics: Optics
    psf: Psf = field(default_factory=Psf)
    detector: Detector = field(default_factory=Detector)
    light: Light = field(default_factory=Light)
    exposure_s: float = 5.0
    average: int = 1
    """Exposures averaged into one image."""

    def __post_init__(self) -> None:
        if self.average < 1:
            raise InputError(f"average = {self.average} exposures: at least 1")


class Scene(Protocol):
    """What the camera sees."""

    @property
    def time_s(self) -> float:
        """When."""
        ...

    def lit_mm(self) -> Floats:
        """(n, 2) true positions of what is lit, the fibres; NaN for a dark one."""
        ...


@dataclass
class StillScene:
    """Fibres at fixed places."""

    xy_mm: Floats
    time_s: float = 0.0

    def lit_mm(self) -> Floats:
        """Their positions."""
        return self.xy_mm


class TwinScene:
    """The metrology fibres of a twin."""

    def __init__(self, twin: Twin) -> None:
        self._twin, self._backlit = twin, ""

    def light(self, fibre: str) -> None:
        """Lights this science fibre of all positioners from behind, beside the metrology fibres; "": none."""
        self._backlit = fibre

    @property
    def time_s(self) -> float:
        """Virtual time."""
        return self._twin.time_s

    def lit_mm(self) -> Floats:
        """Where they are now; NaN for dark ones."""
        metrology = np.where(self._twin.dark[:, None], np.nan, self._twin.fibre_xy("metrology"))
        return np.vstack([metrology, self._twin.fibre_xy(self._backlit)]) if self._backlit else metrology


class ImagingCamera:
    """Takes images of a scene: the source of images for `fiberloom.metrology.ImageCamera`."""

    def __init__(
        self,
        scene: Scene,
        model: CameraModel,
        *,
        fiducials_mm: ArrayLike | None = None,
        seed: int = 0,
        instrument: str = "",
        threads: int | None = None,
    ) -> None:
        self.threads = threads or core_count()
        self.scene, self.model, self.seed, self.instrument = scene, model, seed, instrument
        self.fiducials_mm = np.zeros((0, 2))
        if fiducials_mm is not None:
            self.fiducials_mm = np.asarray(fiducials_mm, dtype=np.float64)[:, :2]
        self.exposures = 0
        self._fixed = np.random.default_rng([seed, 0x1A6E])
        self._strays_px = self._fixed.uniform(0, 1, (model.light.strays, 2)) * self._size()
        self._flux_scatter: dict[int, Floats] = {}
        self._hot = self._draw_hot()

    def turn(self, turned_deg: float) -> None:
        """Turns the focal plane before the camera, by so many `turned_deg` from where it was at first."""
        self.model = replace(self.model, optics=replace(self.model.optics, turned_deg=turned_deg))

    def light(self, fibre: str) -> None:
        """Lights this science fibre too, from behind; "": none. A scene without them stays as it is."""
        if (light := getattr(self.scene, "light", None)) is not None:
            light(fibre)

    @part("images")
    def expose(self) -> CameraImage:
        """The next image."""
        frames = [self._one() for _ in range(self.model.average)]
        detector = self.model.detector
        pixels = frames[0]
        if len(frames) > 1:
            pixels = np.mean(frames, axis=0, dtype=np.float32)
        top = detector.bias_adu + detector.full_well_e / detector.gain_e_adu
        return CameraImage(
            pixels,
            gain_e_adu=detector.gain_e_adu * self.model.average,
            saturation_adu=min(top, 65535.0),
            exposure_s=self.model.exposure_s * self.model.average,
            time_s=self.scene.time_s,
            header=self.header(),
        )

    def header(self) -> dict[str, Any]:
        """What a FITS file of the image says about it; a linear WCS in mm."""
        g, d = self.model.optics.geometry, self.model.detector
        base = g.similarity()
        # z_mm = a z + b; FITS counts pixels from 1
        z = -base.b / base.a
        j = base.jacobian
        return {
            "INSTRUME": self.instrument or "twin",
            "ORIGIN": f"fiberloom {__version__} twin",
            "DATE": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "SEED": self.seed,
            "FRAME": self.exposures,
            "NAVERAGE": self.model.average,
            "RDNOISE": (d.read_noise_e, "[electron] of one exposure"),
            "BIAS": (d.bias_adu, "[adu]"),
            "CTYPE1": "LINEAR", "CTYPE2": "LINEAR", "CUNIT1": "mm", "CUNIT2": "mm",
            "CRPIX1": z.real + 1, "CRPIX2": (-z.imag if g.flipped else z.imag) + 1,
            "CRVAL1": 0.0, "CRVAL2": 0.0,
            "CD1_1": j[0, 0], "CD1_2": j[0, 1], "CD2_1": j[1, 0], "CD2_2": j[1, 1],
        }  # fmt: skip

    def _size(self) -> Floats:
        g = self.model.optics.geometry
        return np.array([g.width_px, g.height_px], dtype=np.float64)

    def _draw_hot(self) -> tuple[Ints, NDArray[np.float32]]:
        d = self.model.detector
        n = int(self._fixed.poisson(d.hot_share * np.prod(self._size())))
        where = self._fixed.integers(0, int(np.prod(self._size())), n)
        return where, self._fixed.exponential(d.hot_e, n).astype(np.float32)

    def _one(self) -> NDArray[np.uint16]:
        """One exposure."""
        rng = np.random.default_rng([self.seed, 0xE0, self.exposures])
        self.exposures += 1
        model, g = self.model, self.model.optics.geometry
        sources = self._sources(rng)
        single = [self._hot, *self._cosmic_rays(rng)]
        pixels, electrons = (np.concatenate(column) for column in zip(*single, strict=True))
        sky = [model.light.background_e, model.light.gradient_e / g.width_px, 0.0]
        d = model.detector
        detector = [d.gain_e_adu, d.read_noise_e, d.bias_adu, d.full_well_e]
        lights = _core.Lights(sources, PSF_KINDS[model.psf.kind], model.psf.end_q, pixels, electrons)
        shape = (g.height_px, g.width_px)
        return _core.expose_lights(lights, shape, sky, detector, int(rng.integers(2**63)), self.threads)

    def _sources(self, rng: np.random.Generator) -> Floats:
        """(n, 7) for the painter: fibres, fiducials, strays."""
        fibres, model = self.scene.lit_mm(), self.model
        xy_mm = np.vstack([fibres, self.fiducials_mm])
        flux = np.repeat(
            [model.light.fibre_e, model.light.fiducial_e, model.light.fibre_e],
            [len(fibres), len(self.fiducials_mm), len(self._strays_px)],
        ) * self._scatter(len(xy_mm) + len(self._strays_px))  # fmt: skip
        shift = rng.normal(0.0, model.optics.vibration_um * MM_PER_UM, 2)
        optics = model.optics
        moved = xy_mm + shift
        moved += air_shift_mm(xy_mm, optics.turbulence_um, optics.turbulence_length_mm, rng)
        xy_px = np.vstack([model.optics.to_px(moved), self._strays_px])
        centre = model.optics.geometry.similarity().to_px(np.zeros((1, 2)))
        scale = model.optics.geometry.scale_mm_px / model.optics.field_radius_mm
        shape = model.psf.ellipses_px2((xy_px - centre) * scale)
        parameter = np.full(len(xy_px), model.psf.parameter)
        table = np.column_stack([xy_px, flux, shape, parameter])
        return np.ascontiguousarray(table[np.isfinite(table).all(axis=1)])

    def _scatter(self, n: int) -> Floats:
        """Factors on the fluxes: the same spot is always as bright."""
        if n not in self._flux_scatter:
            draw = np.random.default_rng([self.seed, 0xF1]).normal(0.0, self.model.light.scatter, n)
            self._flux_scatter[n] = np.exp(draw)
        return self._flux_scatter[n]

    def _cosmic_rays(self, rng: np.random.Generator) -> list[tuple[Ints, NDArray[np.float32]]]:
        """Straight tracks one or two pixels wide: of each its pixels, row by row, and their electrons."""
        width, height = self._size().astype(int)
        tracks = []
        for _ in range(rng.poisson(self.model.detector.cosmic_rays)):
            start, angle = rng.uniform(0, 1, 2) * [width, height], rng.uniform(0, 2 * np.pi)
            step = np.arange(0.0, 1 + rng.exponential(8.0), 0.5)
            x = (start[0] + step * np.cos(angle)).astype(int)
            y = (start[1] + step * np.sin(angle)).astype(int)
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            pixels = y[inside] * width + x[inside]
            tracks.append((pixels, np.full(len(pixels), rng.uniform(150, 1500), dtype=np.float32)))
        return tracks
