"""The `[sky]` table of an instrument's TOML file: from RA and Dec to millimetres."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from fiberloom.instruments.table import Finite, NotNegative, Positive, Table

Latitude = Annotated[float, Field(ge=-90, le=90)]
Longitude = Annotated[float, Field(ge=-360, le=360)]
Arcsec = Annotated[float, Field(ge=-3600, le=3600)]
Share = Annotated[float, Field(ge=0, le=1)]


class SphereOptics(Table):
    """A spherical focal surface: r = R sin p(t), p an odd polynomial of the field angle t, both in deg."""

    kind: Literal["sphere"]
    wavelength_A: Positive
    """Of the fit; a target takes the fit of the nearest wavelength."""
    radius_mm: Positive
    """Of the surface."""
    terms: Annotated[tuple[Finite, ...], Field(min_length=1)]
    """Of t, t^3, t^5, ..."""
    limit_deg: Positive
    """Field angle to which the fit holds."""


class PolynomialOptics(Table):
    """r = an odd polynomial of the field angle t in deg."""

    kind: Literal["polynomial"]
    terms_mm: Annotated[tuple[Finite, ...], Field(min_length=1)]
    """Of t, t^3, t^5, ..."""
    limit_deg: Positive


class RadialOptics(Table):
    """r = F (s + k3 s^3 + k5 s^5 ...), s = t, sin t or tan t of the field angle t in rad."""

    kind: Literal["radial"]
    focal_length_mm: Positive
    projection: Literal["linear", "sin", "tan"]
    terms: tuple[Finite, ...] = ()
    """k3, k5, ...; none: no distortion is known."""
    limit_deg: Positive


class RaytraceOptics(Table):
    """A ray trace of a corrector with two prisms, in a file of desimeter's form (`raytrace-tan2fp.json`)."""

    kind: Literal["raytrace"]
    file: str
    limit_deg: Positive


class SubaruOptics(Table):
    """Prime focus of Subaru with its corrector, prisms and rotator, as PFS has published it."""

    kind: Literal["subaru"]
    limit_deg: Positive


OpticsTable = Annotated[
    SphereOptics | PolynomialOptics | RadialOptics | RaytraceOptics | SubaruOptics,
    Field(discriminator="kind"),
]


class WeatherTable(Table):
    """Air at the telescope, as the refraction takes it."""

    temperature_C: Annotated[float, Field(ge=-80, le=60)]
    pressure_hPa: NotNegative
    """0: no refraction."""
    humidity: Share


class TelescopeSite(Table):
    """A place on Earth where the instrument is, and the optics of the telescope there."""

    longitude_deg: Longitude
    """East of Greenwich."""
    latitude_deg: Latitude
    height_m: Annotated[float, Field(ge=-500, le=10000)]
    scale: Positive = 1.0
    """Places in the focal plane are divided by it."""
    mount_pole_low_arcsec: Arcsec = 0.0
    """By how much the polar axis of the mount is below the celestial pole."""
    mount_pole_east_arcsec: Arcsec = 0.0
    """By how much it is to the east of north, in azimuth."""
    weather: WeatherTable | None = None
    """None: 10 deg C, half saturated, pressure by the height."""
    optics: Annotated[tuple[OpticsTable, ...], Field(min_length=1)]


class SkyTable(Table):
    """From RA and Dec to millimetres."""

    guide_wavelength_A: Positive
    """At which the centre of the field is observed."""
    fibre_wavelength_A: dict[str, Positive]
    """At which a target is observed by a fibre."""
    dispersion_corrected: bool = False
    """True: prisms bring all wavelengths to the place of the guide wavelength."""
    altitude_min_deg: Annotated[float, Field(ge=0, lt=90)] = 20.0
    """Targets below are refused."""
    flipped: bool = False
    """True: at position angle 0, x runs to the west on the image."""
    sites: Annotated[dict[str, TelescopeSite], Field(min_length=1)]
    """By name; the first is taken where none is named."""

    @model_validator(mode="after")
    def _nearest(self) -> Self:
        """Several optics of a site are told apart by their wavelengths."""
        for name, site in self.sites.items():
            if len(site.optics) > 1 and not all(isinstance(one, SphereOptics) for one in site.optics):
                raise ValueError(f"sites.{name}.optics: several, so each must be of kind 'sphere'")
        return self
