"""From an image to the positions of the fibres, with covariance: spots, fiducials, pairs, mm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.metrology.acquisition import (
    Acquisition,
    AcquisitionError,
    AcquisitionSettings,
    CameraGeometry,
    acquire,
    refine,
)
from fiberloom.metrology.camera import Measurement
from fiberloom.metrology.images import CameraImage, trouble
from fiberloom.metrology.matching import Match, MatchSettings, MatchStatus, match_spots
from fiberloom.metrology.spots import Found, Profile, Spots, SpotSettings, find_spots
from fiberloom.metrology.transform import FieldTransform, PlaceErrors
from fiberloom.metrology.turbulence import FittedTerms, Turbulence, remove_turbulence
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import MM_PER_UM


class ImageSource(Protocol):
    """Something that takes images: a camera, the camera of a twin, a folder of files."""

    def expose(self) -> CameraImage:
        """The next image."""
        ...


@dataclass(frozen=True)
class ReductionSettings:
    """How an image becomes positions."""

    geometry: CameraGeometry
    terms: Sequence[int] | None = None
    """Zhao-Burge terms; by default those that predict the fiducials best."""
    radius_mm: float | None = None
    """That scales the terms; the outermost fiducial when left out."""
    fiducial_sigma_um: float = 0.0
    """How well the table of fiducials is known, per coordinate; 0: better than the camera."""
    threshold: float = 6.0
    turbulence: bool = False
    """Remove it, with fiducials and the positioners that do not move."""
    standing_sigma_um: float = 1.0
    """How well the place of a standing positioner is known, per coordinate."""
    retries: int = 2
    """Further exposures where one shows no fiducials."""
    matching: MatchSettings = field(default_factory=MatchSettings)
    acquisition: AcquisitionSettings = field(default_factory=AcquisitionSettings)

    @property
    def search(self) -> AcquisitionSettings:
        """How fiducials are looked for, with this distortion."""
        return replace(self.acquisition, terms=self.terms, radius_mm=self.radius_mm)


@dataclass(frozen=True, eq=False)
class ImageHints:
    """What is known before an image is looked at."""

    expected_mm: Floats | None = None
    """(N, 2) where the metrology fibres should be, NaN anywhere."""
    previous_mm: Floats | None = None
    """(N, 2) where they were seen last."""
    standing_mm: Floats | None = None
    """(N, 2) known places of positioners that do not move, NaN for the others; used against turbulence."""
    profile: Profile | None = None
    """Of an earlier image; it saves time, and is dropped where it does not hold."""
    start: FieldTransform | None = None
    """The transform of an earlier image, likewise."""


@dataclass(frozen=True)
class Reduction:
    """What one image told. Rows of `match`, `xy_mm` and `covariance_mm2` are positioners."""

    image: CameraImage
    found: Found
    acquisition: Acquisition
    match: Match
    spot_of_match: Ints
    """(N,) index into `found.spots`, -1 where not seen."""
    xy_mm: Floats
    """(N, 2); NaN where not seen."""
    covariance_mm2: Floats
    noise_mm2: Floats
    """(N, 2, 2) by which positions differ from image to image: without what the fiducials' table is off."""
    expected_mm: Floats
    turbulence: Turbulence | None = None
    loose_mm: Floats | None = None
    """(n, 2) spots that belong to no positioner for certain."""

    @property
    def spots(self) -> Spots:
        """All spots of the image."""
        return self.found.spots

    @property
    def transform(self) -> FieldTransform:
        """Pixels to focal plane."""
        return self.acquisition.transform

    @property
    def seen(self) -> Flags:
        """(N,) which fibres were seen for certain."""
        return self.spot_of_match >= 0

    def measurement(self) -> Measurement:
        """As the loop wants it."""
        return Measurement(
            self.xy_mm[:, 0],
            self.xy_mm[:, 1],
            self.seen,
            self.image.time_s,
            self.covariance_mm2,
            self.match.status == MatchStatus.AMBIGUOUS,
            self.loose_mm,
            self.noise_mm2,
        )


def reduce_image(
    image: CameraImage,
    plane: FocalPlane,
    settings: ReductionSettings,
    hints: ImageHints,
) -> Reduction:
    """All steps from pixels to millimetres.

    `image` of the `plane`; `settings`: camera geometry and those of each step; `hints`: what is known before.
    """
    found = find_spots(
        image.pixels,
        SpotSettings(image.gain_e_adu, image.saturation_adu, settings.threshold),
        profile=hints.profile,
        fits_bytes=image.fits_bytes,
    )
    if len(found.spots) < 4:
        raise AcquisitionError(f"{len(found.spots)} spots in the image: {trouble(image)}")
    acquisition = _fiducials(found.spots, plane, settings, hints)
    return _matched(image, found, acquisition, plane, settings, hints)


def _matched(
    image: CameraImage,
    found: Found,
    acquisition: Acquisition,
    plane: FocalPlane,
    settings: ReductionSettings,
    hints: ImageHints,
) -> Reduction:
    """Whose the spots are, and where. `found` in the `image`, with the transform of its `acquisition`."""
    expected = np.full((len(plane), 2), np.nan) if hints.expected_mm is None else hints.expected_mm
    free = np.setdiff1d(np.arange(len(found.spots)), acquisition.spot)
    others = found.spots.select(free)
    spots_mm = acquisition.transform.to_mm(others.xy_px)
    match = match_spots(
        spots_mm, expected, plane.centres_mm, metrology_reach_mm(plane),
        previous_mm=hints.previous_mm, settings=settings.matching,
    )  # fmt: skip
    covariance, noise = _known(acquisition.transform, others, settings.turbulence)
    seen, n = match.spot >= 0, len(plane)
    xy, cov, own = np.full((n, 2), np.nan), np.full((n, 2, 2), np.nan), np.full((n, 2, 2), np.nan)
    for rows, values in ((xy, spots_mm), (cov, covariance), (own, noise)):
        rows[seen] = values[match.spot[seen]]
    spot = np.where(seen, free[match.spot] if len(free) else -1, -1)
    air = (
        _calm(plane, settings, _SeenSpots(acquisition, found.spots, spot), hints.standing_mm, xy, cov)
        if settings.turbulence
        else None
    )
    loose = spots_mm[match.stray]
    if air is not None:
        own[seen] += air.variance_mm2[:, None, None] * np.eye(2)
    return Reduction(image, found, acquisition, match, spot, xy, cov, own, expected, air, loose)


def metrology_reach_mm(plane: FocalPlane) -> Floats:
    """(N, 2) inner and outer radius that the metrology fibres reach."""
    alpha, beta = plane.l_alpha_mm, plane.l_beta_mm
    return np.column_stack([np.abs(alpha - beta), alpha + beta])


def _fiducials(
    spots: Spots, plane: FocalPlane, settings: ReductionSettings, hints: ImageHints
) -> Acquisition:
    errors = PlaceErrors(spots.covariance_px2, settings.fiducial_sigma_um * MM_PER_UM)
    fiducials = plane.fiducials[:, :2]
    if hints.start is not None:
        try:
            return refine(spots.xy_px, fiducials, hints.start, errors=errors, settings=settings.search)
        except AcquisitionError:
            pass  # the camera has moved: look for them as on the first image
    return acquire(
        spots.xy_px,
        fiducials,
        settings.geometry,
        expected_mm=hints.expected_mm,
        errors=errors,
        settings=settings.search,
    )


def _known(transform: FieldTransform, spots: Spots, turbulence: bool) -> Floats:
    """(2, n, 2, 2) mm^2 of the places of `spots`: how well known, and what of it is new in every image.

    With `turbulence` by the spots alone: what the transform is off the fit of the air tells. It knows that
    neighbouring fiducials are off together.
    """
    if turbulence:
        own = transform.of_spots(spots.xy_px, spots.covariance_px2)
        return np.stack([own, own])
    known = transform.covariance(spots.xy_px, spots.covariance_px2)
    return np.stack([known, transform.noise(spots.xy_px, spots.covariance_px2)])


@dataclass(frozen=True)
class _SeenSpots:
    """The spots of an image, and whose they are."""

    acquisition: Acquisition
    spots: Spots
    spot: Ints
    """(N,) of each positioner; -1: none."""

    def fiducials_sigma_mm(self, table_um: float) -> Floats:
        """(m,) per coordinate: of the table, and of the spots."""
        fiducials = self.spots.select(self.acquisition.spot)
        noise = self.acquisition.transform.of_spots(fiducials.xy_px, fiducials.covariance_px2)
        spots: Floats = np.sqrt(0.5 * np.trace(noise, axis1=1, axis2=2))
        return np.hypot(spots, max(table_um, 0.1) * MM_PER_UM)

    def trend(self, still: Flags, seen: Flags) -> FittedTerms:
        """Of the transform, at fiducials and positioners `still` (N,), and at those `seen` (N,)."""
        rows = np.concatenate([self.acquisition.spot, self.spot[still]])
        fields = self.acquisition.transform.fields
        return FittedTerms(fields(self.spots.xy_px[rows]), fields(self.spots.xy_px[self.spot[seen]]))


def _calm(
    plane: FocalPlane,
    settings: ReductionSettings,
    image: _SeenSpots,
    standing_mm: Floats | None,
    xy: Floats,
    cov: Floats,
) -> Turbulence:
    """Takes the turbulence off `xy`, in place, and adds what is not known of it to `cov`."""
    at = plane.fiducials[image.acquisition.fiducial, :2]
    shift = -image.acquisition.fit.residual_mm
    sigma = image.fiducials_sigma_mm(settings.fiducial_sigma_um)
    seen: Flags = np.asarray(np.isfinite(xy).all(axis=1))
    still: Flags = np.zeros(len(seen), dtype=bool)
    if standing_mm is not None:
        still = np.asarray(np.isfinite(standing_mm).all(axis=1) & seen)
        at = np.vstack([at, standing_mm[still]])
        shift = np.vstack([shift, xy[still] - standing_mm[still]])
        own = np.sqrt(0.5 * np.trace(cov[still], axis1=1, axis2=2))
        sigma = np.concatenate([sigma, np.hypot(own, settings.standing_sigma_um * MM_PER_UM)])
    air = remove_turbulence(at, shift, sigma, xy[seen], trend=image.trend(still, seen))
    xy[seen] -= air.shift_mm
    cov[seen] += air.variance_mm2[:, None, None] * np.eye(2)
    return air


class ImageCamera:
    """Measures the metrology fibres in images. Implements `fiberloom.metrology.Camera`.

    Remembers from image to image the profile of the spots, the transform and where each fibre was
    seen; `last` is the latest reduction, for plots and reports. Where the settings name no terms of the
    distortion, those of the first image are kept: what is wrong with the table of the fiducials shows by
    the terms, and the fibres of a field would jump by micrometres with them.
    """

    def __init__(self, source: ImageSource, plane: FocalPlane, settings: ReductionSettings) -> None:
        self.source, self.plane, self.settings = source, plane, settings
        self.last: Reduction | None = None
        self._unturned_deg, self._turned = settings.geometry.rotation_deg, False
        self._measured: Measurement | None = None
        self.profile: Profile | None = None
        self.previous_mm = np.full((len(plane), 2), np.nan)
        self.standing_mm: Floats | None = None
        """(N, 2) places of positioners that do not move, against turbulence; for callers that know them.

        The loop does not give them: it knows them from images alone, whose air they would keep.
        """
        self.watchers: list[Callable[[Reduction], None]] = []
        """Told of every exposure."""

    def measure(self, expected_mm: Floats | None = None) -> Measurement:
        """Takes an image now and reduces it; another one where there is nothing to be made of it."""
        for _ in range(self.settings.retries):
            try:
                reduction = self._reduce(expected_mm)
                break
            except AcquisitionError:
                continue
        else:
            reduction = self._reduce(expected_mm)
        measured = self._remember(reduction)
        for watcher in self.watchers:
            watcher(reduction)
        return measured

    def rematch(self, expected_mm: Floats, image: Measurement) -> Measurement | None:
        """An `image` measured before, once more: no arm has moved since, but more is known of where they are.

        `expected_mm` (N, 2), as of `measure`. None where it is not what was measured or matched anew last, or
        where the camera has been turned or told of other fiducials since. It is no exposure: watchers are not
        told.
        """
        last = self.last
        if last is None or image is not self._measured:
            return None
        hints = ImageHints(expected_mm, self.previous_mm, self.standing_mm)
        self.last = _matched(last.image, last.found, last.acquisition, self.plane, self.settings, hints)
        return self._keep(self.last)

    def turn(self, turned_deg: float) -> None:
        """From now on images are turned by so many deg more than nominal, by the instrument's rotator.

        A source that has a rotator (`turn`) is turned by it.
        """
        if (turn := getattr(self.source, "turn", None)) is not None:
            turn(turned_deg)
        geometry = replace(self.settings.geometry, rotation_deg=self._unturned_deg + turned_deg)
        self.settings, self._turned = replace(self.settings, geometry=geometry), True
        self._measured = None

    def light(self, fibre: str) -> None:
        """From now on this science `fibre` shines beside the metrology fibres, "" none: a source's lamp."""
        if (light := getattr(self.source, "light", None)) is not None:
            light(fibre)

    def know_fiducials(self, fiducials_mm: Floats) -> None:
        """From now on fiducials are taken to be at (F, 2) mm: as a calibration has found them."""
        known = np.column_stack([fiducials_mm, self.plane.fiducials[:, 2:]])
        self.plane, self._measured = replace(self.plane, fiducials=known), None

    def abort(self) -> None:
        """Makes a running `measure` raise, where the source can be aborted; from any thread."""
        if (abort := getattr(self.source, "abort", None)) is not None:
            abort()

    def close(self) -> None:
        """Lets go of the camera."""
        if (close := getattr(self.source, "close", None)) is not None:
            close()

    def _reduce(self, expected_mm: Floats | None) -> Reduction:
        image = self.source.expose()
        if image.pixels.ndim != 2:
            raise InputError("the camera delivered something that is no image")
        start = self.last.transform if self.last and not self._turned else None
        hints = ImageHints(expected_mm, self.previous_mm, self.standing_mm, self.profile, start)
        terms = self.settings.terms
        if terms is None and self.last:
            terms = self.last.transform.terms
        return reduce_image(image, self.plane, replace(self.settings, terms=terms), hints)

    def _remember(self, reduction: Reduction) -> Measurement:
        self.last, self._turned = reduction, False
        # a profile that no longer fits is measured again on the next image
        worn = np.median(reduction.spots.chi2) > _WORN_CHI2 if len(reduction.spots) else True
        self.profile = None if worn else reduction.found.profile
        return self._keep(reduction)

    def _keep(self, reduction: Reduction) -> Measurement:
        seen = reduction.seen
        self.previous_mm[seen] = reduction.xy_mm[seen]
        self._measured = reduction.measurement()
        return self._measured


_WORN_CHI2 = 1.3
