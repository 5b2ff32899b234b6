"""From the ICRS to the focal plane and back: ERFA, then the optics of the instrument.

A field is a telescope that looks at a centre at a time. Targets are observed each at its own wavelength, the
centre at the guide wavelength; where prisms correct the dispersion, all at that one.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import erfa
import numpy as np
from numpy.typing import ArrayLike

from fiberloom.errors import InputError
from fiberloom.instruments.model import Instrument, TelescopeSite
from fiberloom.sky.earth import ARCSEC_RAD, Orientation, SkyTime, orientation, quiet
from fiberloom.sky.optics.choose import optics_at
from fiberloom.sky.optics.view import FieldOptics, View
from fiberloom.sky.site import SkySite, Weather, sky_of
from fiberloom.sky.sky_targets import GUIDE, SkyTargets
from fiberloom.typing import Array, Flags, Floats
from fiberloom.units import RAD_PER_DEG, deg_to_rad, rad_to_deg

_MAS_RAD = 1e-3 * ARCSEC_RAD
_UM_PER_A = 1e-4
_BACK_STEPS = 2
_J2000 = (erfa.DJ00, 0.0)


@dataclass(frozen=True)
class SkyPointing:
    """Of a telescope: where it looks, how the focal plane is turned, and when."""

    ra_deg: float
    dec_deg: float
    time: SkyTime
    pa_deg: float = 0.0
    """Position angle: from the image's north through east to +y of the focal plane."""
    scale: float | None = None
    """Places on the image over places in the focal plane, a ratio; None: that of the site."""

    def __post_init__(self) -> None:
        if not abs(self.dec_deg) <= 90.0:
            raise InputError(f"field centre: dec = {self.dec_deg:g}: must be -90 to 90 deg")
        if not abs(self.ra_deg) <= 360.0:
            raise InputError(f"field centre: ra = {self.ra_deg:g}: must be 0 to 360 deg")
        if not abs(self.pa_deg) <= 360.0:
            raise InputError(f"position angle {self.pa_deg:g}: must be -360 to 360 deg")
        if self.scale is not None and not 0.9 < self.scale < 1.1:
            raise InputError(f"scale {self.scale:g}: must be 0.9 to 1.1")

    def at(self, time: SkyTime) -> SkyPointing:
        """The same field at another time."""
        return replace(self, time=time)


Pointing = SkyPointing
"""Within `fiberloom.sky`; elsewhere a pointing is that of the tilted focal plane."""


@dataclass(frozen=True, eq=False)
class SkyPlaces:
    """Where n targets are seen; arrays (n,) or (n, 2)."""

    xy_mm: Floats
    """(n, 2) in the focal plane of the positioners."""
    focal_mm: Floats
    """(n, 2) on the image: before position angle and scale."""
    altitude_deg: Floats
    """Observed: with refraction."""
    azimuth_deg: Floats
    field_angle_deg: Floats
    """From the centre of the field."""
    outside: Flags
    """Beyond what the optics' fit covers: the place is not to be trusted."""
    low: Flags
    """Below the altitude to which targets are accepted."""

    def __len__(self) -> int:
        return len(self.outside)


class Chain:
    """From RA and Dec to mm, for one field, site and weather.

    Parameters
    ----------
    instrument : Instrument
        With a `[sky]` table.
    pointing : SkyPointing
        Where the telescope looks, and when.
    site : SkySite, optional
        The first of the instrument when left out.
    weather : Weather, optional
        What the instrument computes with when left out.
    polar_motion : bool
        Take polar motion from the table of the IERS, not 0. It turns a field by up to 0.3 arcsec.
    optics : FieldOptics, optional
        In place of the instrument's.

    Raises
    ------
    InputError
        An instrument without optics for the sky; a field that is below the horizon.
    """

    def __init__(
        self,
        instrument: Instrument,
        pointing: SkyPointing,
        site: SkySite | None = None,
        weather: Weather | None = None,
        *,
        polar_motion: bool = False,
        optics: FieldOptics | None = None,
    ) -> None:
        self.instrument, self.pointing = instrument, pointing
        sky = sky_of(instrument)
        self.guide_A, self.known_A = sky.guide_wavelength_A, sky.fibre_wavelength_A
        self.site = site or SkySite.of(instrument)
        self.weather = weather or Weather.usual(self.site)
        found = orientation(pointing.time)
        self.earth = found if polar_motion else Orientation(found.ut1_utc_s, 0.0, 0.0)
        self.polar_motion = polar_motion
        self._optics = optics
        self._air: dict[float, tuple[float, float]] = {}
        if self.altitude_deg <= 0.0:
            raise InputError(
                f"field centre {pointing.ra_deg:g}, {pointing.dec_deg:g}: is {-self.altitude_deg:.1f} deg "
                f"below the horizon of {self.site.name} at {pointing.time.iso} UTC"
            )

    def at(self, time: SkyTime) -> Chain:
        """The same at another time."""
        return self._with(self.pointing.at(time))

    def turned(self, by_deg: float) -> Chain:
        """The same with the position angle larger by so many deg."""
        return self._with(replace(self.pointing, pa_deg=self.pointing.pa_deg + by_deg))

    def _with(self, pointing: SkyPointing) -> Chain:
        how: dict[str, Any] = {"polar_motion": self.polar_motion, "optics": self._optics}
        return Chain(self.instrument, pointing, self.site, self.weather, **how)

    # ERFA

    @cached_property
    def _astrom(self) -> Any:
        """For the guide wavelength."""
        return self._apco13(self._air_of(self.guide_A))

    def _apco13(self, air: tuple[float, float]) -> Any:
        time, site, earth = self.pointing.time, self.site, self.earth
        astrom, _ = quiet(
            erfa.apco13,
            *(time.day, time.part, earth.ut1_utc_s, site.longitude_rad, site.latitude_rad, site.height_m),
            *(earth.x_arcsec * ARCSEC_RAD, earth.y_arcsec * ARCSEC_RAD, 0.0, 0.0, 0.0, 0.55),
        )
        astrom["refa"], astrom["refb"] = air
        return astrom

    def _air_of(self, wavelength_A: float) -> tuple[float, float]:
        """SOFA's constants of refraction, rad."""
        if wavelength_A not in self._air:
            w = self.weather
            got = erfa.refco(w.pressure_hPa, w.temperature_C, w.humidity, wavelength_A * _UM_PER_A)
            self._air[wavelength_A] = (float(got[0]), float(got[1]))
        return self._air[wavelength_A]

    def _astrom_of(self, wavelength_A: Floats) -> Any:
        """(n,) for the wavelength of each target."""
        if sky_of(self.instrument).dispersion_corrected or not len(wavelength_A):
            return self._astrom
        distinct, which = np.unique(wavelength_A, return_inverse=True)
        air = np.array([self._air_of(float(w)) for w in distinct])[which]
        astrom = np.repeat(np.atleast_1d(self._astrom), len(wavelength_A))
        astrom["refa"], astrom["refb"] = air.T
        return astrom

    def _observed(self, ra_rad: Any, dec_rad: Any, motion: tuple[Any, ...], astrom: Any) -> tuple[Any, Any]:
        """Azimuth and altitude, rad."""
        ri, di = erfa.atciq(ra_rad, dec_rad, *motion, self._astrom)
        azimuth, zenith, *_ = erfa.atioq(ri, di, astrom)
        return azimuth, np.pi / 2 - zenith

    # the centre of the field

    @cached_property
    def _centre(self) -> tuple[float, float, float, float]:
        """Azimuth, altitude, hour angle, declination, as observed; rad."""
        p = self.pointing
        radec = p.ra_deg * RAD_PER_DEG, p.dec_deg * RAD_PER_DEG
        ri, di = erfa.atciq(*radec, 0.0, 0.0, 0.0, 0.0, self._astrom)
        azimuth, zenith, ha, dec, _ = erfa.atioq(ri, di, self._astrom)
        return float(azimuth), float(np.pi / 2 - zenith), float(ha), float(dec)

    @property
    def altitude_deg(self) -> float:
        """Of the centre, observed."""
        return self._centre[1] / RAD_PER_DEG

    @property
    def azimuth_deg(self) -> float:
        """Of the centre, observed; north 0, east 90."""
        return self._centre[0] / RAD_PER_DEG

    @property
    def airmass(self) -> float:
        """Secant of the observed zenith distance, a ratio."""
        return float(1.0 / np.sin(self._centre[1]))

    @cached_property
    def view(self) -> View:
        """What the optics know of the field; angles in deg."""
        _, _, ha, dec = self._centre
        scale = self.pointing.scale
        telescope: TelescopeSite = self.site.telescope
        zenith, pole = self._without_air
        true_north = View(
            pa_deg=self.pointing.pa_deg,
            scale=telescope.scale if scale is None else scale,
            parallactic_deg=float(erfa.hd2pa(ha, dec, self.site.latitude_rad)) / RAD_PER_DEG,
            zenith_deg=zenith / RAD_PER_DEG,
            pole_deg=pole / RAD_PER_DEG,
            hour_angle_deg=ha / RAD_PER_DEG,
            dec_deg=dec / RAD_PER_DEG,
            latitude_deg=self.site.latitude_deg,
            flipped=sky_of(self.instrument).flipped,
        )
        return replace(true_north, pa_deg=true_north.pa_deg + self._mount_deg(true_north))

    def _mount_deg(self, view: View) -> float:
        """Position angle of the mount's pole at the centre, deg: the field follows that pole."""
        site: TelescopeSite = self.site.telescope
        low, east = ARCSEC_RAD * site.mount_pole_low_arcsec, ARCSEC_RAD * site.mount_pole_east_arcsec
        if low == east == 0.0:
            return 0.0
        e, u, _ = _about(east, self.site.latitude_rad - low, *self._centre[:2])
        x, y = view.equatorial(np.array([[float(e), float(u)]]))[0]
        return float(np.arctan2(x, y)) / RAD_PER_DEG

    @cached_property
    def _without_air(self) -> tuple[float, float]:
        """Zenith distance of the centre, and from the zenith through growing azimuth to the pole; rad.

        The pole is the mean one of date, as a star there would be seen: with aberration (PFS takes that one).
        """
        p, airless = self.pointing, self._apco13((0.0, 0.0))
        pole = erfa.c2s(erfa.pmat06(*self.pointing.time.tt)[2])
        radec = np.array([(p.ra_deg * RAD_PER_DEG, p.dec_deg * RAD_PER_DEG), pole])
        azimuth, altitude = self._observed(radec[:, 0], radec[:, 1], (0.0,) * 4, airless)
        e, u = np.column_stack(_about(azimuth[1:], altitude[1:], azimuth[0], altitude[0])[:2])[0]
        return float(np.pi / 2 - altitude[0]), float(np.arctan2(e, u))

    def optics(self, wavelength_A: float) -> tuple[FieldOptics, float]:
        """Optics for a wavelength in A, and to which field angle in deg they hold."""
        fitted, limit_deg = optics_at(self.site.telescope, wavelength_A)
        return self._optics or fitted, limit_deg

    # forth

    def place(self, targets: SkyTargets, fibre: str | None = None) -> SkyPlaces:
        """Where targets are in the focal plane.

        Parameters
        ----------
        targets : SkyTargets
            n targets.
        fibre : str, optional
            Places for this fibre; when left out, for the one that each target asks for, or at its own
            wavelength.

        Returns
        -------
        SkyPlaces
            mm, deg, and flags for what is outside the fit of the optics or too low.

        Raises
        ------
        InputError
            A target of which neither a fibre nor a wavelength is known.
        """
        wavelength = self.wavelengths_A(targets, fibre)
        ra, dec, *motion = _at_2000(targets)
        astrom = self._astrom_of(wavelength)
        azimuth, altitude = self._observed(ra, dec, tuple(motion), astrom)
        directions = self._to_field(azimuth, altitude)
        focal, plane, limit = self._through(directions, wavelength)
        angle_deg = rad_to_deg(np.arctan2(np.hypot(*directions[:, :2].T), directions[:, 2]))
        return SkyPlaces(
            plane,
            focal,
            rad_to_deg(altitude),
            rad_to_deg(azimuth),
            angle_deg,
            angle_deg > limit,
            rad_to_deg(altitude) < sky_of(self.instrument).altitude_min_deg,
        )

    def wavelengths_A(self, targets: SkyTargets, fibre: str | None = None) -> Floats:
        """(n,) A: of each target its own; where it has none that of `fibre`, or of the fibre it asks for."""
        known, n = {GUIDE: self.guide_A} | self.known_A, len(targets)
        if fibre is not None:
            of_fibre = np.full(n, self.wavelength_of(fibre))
        else:
            own = set(self.known_A.values())
            only = next(iter(own)) if len(own) == 1 else np.nan
            of_fibre = np.array([known.get(str(f), only) for f in targets.fibre], dtype=np.float64)
        wavelength = np.where(np.isnan(targets.wavelength_A), of_fibre, targets.wavelength_A)
        for row in np.flatnonzero(~(wavelength > 0.0))[:1].tolist():
            raise InputError(
                f"target {targets.target_id[row]}: no wavelength; give a wavelength or one of the fibres "
                f"{', '.join(self.known_A)}"
            )
        return wavelength

    def wavelength_of(self, fibre: str) -> float:
        """Of a fibre, A; the guide wavelength for the metrology fibre."""
        known = {"metrology": self.guide_A} | self.known_A
        if fibre not in known:
            raise InputError(f"fibre '{fibre}': no wavelength is known; {', '.join(known)} have one")
        return known[fibre]

    def _to_field(self, azimuth: Any, altitude: Any) -> Floats:
        """(n, 3) unit vectors."""
        e, u, z = _about(azimuth, altitude, *self._centre[:2])
        return np.column_stack([self.view.equatorial(np.column_stack([e, u])), z])

    def _through(self, directions: Floats, wavelength_A: Floats) -> tuple[Floats, Floats, Floats]:
        """Places on the image and in the focal plane, and limits of the optics."""
        focal, plane = np.empty((2, len(directions), 2))
        limit = np.empty(len(directions))
        for rows, (optics, limit_deg) in self._grouped(wavelength_A):
            focal[rows] = optics.focal_mm(directions[rows], self.view)
            plane[rows] = optics.plane_mm(focal[rows], self.view)
            limit[rows] = limit_deg
        return focal, plane, limit

    def _grouped(self, wavelength_A: Floats) -> Iterator[tuple[Array, tuple[FieldOptics, float]]]:
        for w in np.unique(wavelength_A):
            yield np.flatnonzero(wavelength_A == w), self.optics(float(w))

    # back

    def sky(self, xy_mm: ArrayLike, wavelength_A: ArrayLike) -> Floats:
        """Where places of the focal plane look.

        Parameters
        ----------
        xy_mm : array_like
            (n, 2) mm.
        wavelength_A : array_like
            One, or (n,).

        Returns
        -------
        (n, 2) float
            ICRS right ascension 0 to 360 and declination, deg, of a star that does not move.
        """
        xy = np.atleast_2d(np.asarray(xy_mm, dtype=np.float64))
        wavelength = np.broadcast_to(np.asarray(wavelength_A, dtype=np.float64), len(xy)).copy()
        directions = np.empty((len(xy), 3))
        for rows, (optics, _) in self._grouped(wavelength):
            focal = optics.from_plane_mm(xy[rows], self.view)
            directions[rows] = optics.directions(focal, self.view)
        azimuth, altitude = self._to_horizon(directions)
        with np.errstate(invalid="ignore"):  # a place that the optics do not reach stays NaN
            ri, di = _unrefracted(azimuth, np.pi / 2 - altitude, self._astrom_of(wavelength))
            ra, dec = erfa.aticq(ri, di, self._astrom)
            ra = erfa.anp(ra)
        return np.column_stack([rad_to_deg(ra), rad_to_deg(dec)])

    def _to_horizon(self, directions: Floats) -> tuple[Floats, Floats]:
        """Azimuth and altitude, rad."""
        az0, alt0, _, _ = self._centre
        e, u = self.view.horizontal(directions[:, :2]).T
        z = directions[:, 2]
        north = z * np.cos(alt0) - u * np.sin(alt0)
        up = u * np.cos(alt0) + z * np.sin(alt0)
        azimuth: Floats = az0 + np.arctan2(e, north)
        altitude: Floats = np.arctan2(up, np.hypot(e, north))
        return azimuth, altitude


def _unrefracted(azimuth: Any, zenith: Any, astrom: Any) -> tuple[Any, Any]:
    """CIRS place of an observed azimuth and zenith distance, rad.

    SOFA's own inverse of the refraction is good to 15 microarcsec; two steps make it exact.
    """
    aim = zenith
    for _ in range(_BACK_STEPS):
        seen = erfa.atioq(*erfa.atoiq("A", azimuth, aim, astrom), astrom)[1]
        aim = aim + (zenith - seen)
    place: tuple[Any, Any] = erfa.atoiq("A", azimuth, aim, astrom)
    return place


def _about(azimuth: Any, altitude: Any, azimuth0: float, altitude0: float) -> tuple[Any, Any, Any]:
    """Components of directions to growing azimuth, up, and towards a centre; angles in rad."""
    d = azimuth - azimuth0
    e = np.cos(altitude) * np.sin(d)
    u = np.sin(altitude) * np.cos(altitude0) - np.cos(altitude) * np.sin(altitude0) * np.cos(d)
    z = np.sin(altitude) * np.sin(altitude0) + np.cos(altitude) * np.cos(altitude0) * np.cos(d)
    return e, u, z


def _at_2000(targets: SkyTargets) -> tuple[Any, ...]:
    """Places at J2000.0 in rad, with motions in rad/yr, parallax in arcsec and velocity in km/s."""
    dec = deg_to_rad(targets.dec_deg + targets.delta_dec_arcsec / 3600.0)
    shift = targets.delta_ra_arcsec / 3600.0 / np.cos(deg_to_rad(targets.dec_deg))
    ra = deg_to_rad(targets.ra_deg + shift)
    pm_ra = targets.pm_ra_mas_yr * _MAS_RAD / np.cos(dec)
    pm_dec = targets.pm_dec_mas_yr * _MAS_RAD
    epoch = np.where(np.isnan(targets.epoch_yr), 2000.0, targets.epoch_yr)
    days = (epoch - 2000.0) * erfa.DJY
    px, rv = 1e-3 * targets.parallax_mas, targets.velocity_km_s
    with _no_distance():
        moved: tuple[Any, ...] = erfa.pmsafe(ra, dec, pm_ra, pm_dec, px, rv, erfa.DJ00, days, *_J2000)
    return moved


@contextmanager
def _no_distance() -> Iterator[None]:
    """`pmsafe` warns of every star without a parallax that it has overridden the distance."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*distance overridden.*", category=erfa.ErfaWarning)
        yield
