"""Optics alone: published tables, inverses, and what presets say."""

import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.instruments import instrument_names, load_instrument, parse_instrument
from fiberloom.sky.optics.choose import optics_at
from fiberloom.sky.optics.newton import inverse
from fiberloom.sky.optics.radial import RoundOptics, polynomial, scaled, sphere
from fiberloom.sky.optics.raytrace import PrismAngles, PrismOptics
from fiberloom.sky.optics.subaru import PrimeFocus, adc_mm
from fiberloom.sky.optics.view import View

TANGENT = np.array(
    [
        [-0.018083392, 0.005312928],
        [0.013460971, 0.015770931],
        [-0.006097423, -0.020934806],
        [0.021313908, -0.012065188],
        [0.0, 0.0],
    ]
)
"""Direction cosines to the west and north (DESI)."""


def view(**changed):
    zero = ("pa_deg", "parallactic_deg", "zenith_deg", "pole_deg", "hour_angle_deg", "dec_deg")
    return View(**(dict.fromkeys(zero, 0.0) | {"scale": 1.0, "latitude_deg": 32.0} | changed))


def directions(tangent=TANGENT):
    return np.column_stack([tangent * [-1, 1], np.sqrt(1 - (tangent**2).sum(axis=1))])


def cs5(optics, seen):
    return optics.plane_mm(optics.focal_mm(directions(), seen), seen)


def test_desi_without_prisms_as_echo22():
    table = load_instrument("desi").sky.sites["kpno"]
    optics, limit = optics_at(table, 6400.0)
    echo22 = [
        (-256.7635, 75.4375),
        (191.9199, 224.8542),
        (-87.1531, -299.2303),
        (306.7555, -173.6454),
        (0, 0),
    ]
    assert 1e3 * np.abs(cs5(optics, view(flipped=True)) - echo22).max() < 1.0
    # rows of the table of Echo22 itself
    radius = polynomial(load_instrument("desi").sky.sites["kpno"].optics[0].terms_mm).radius_mm(
        np.radians([0.410328527, 0.813922562, 1.204866778, 1.578588554])
    )
    assert radius == pytest.approx([100.0, 200.0, 300.0, 400.0], abs=1e-3)
    assert limit == pytest.approx(1.64)


@pytest.mark.parametrize(
    ("prisms", "traced"),
    [
        (
            (0.0, 0.0),
            [
                (-256.6549, 75.4077),
                (191.8558, 224.7705),
                (-87.1125, -299.1157),
                (306.6526, -173.5830),
                (0.0069, 0),
            ],
        ),
        (
            (63.78489, 91.97558),
            [
                *((-255.4105, 75.1441), (193.0981, 224.5238), (-85.8761, -299.3700)),
                *((307.9330, -173.8629), (1.1939, -0.2496)),
            ],
        ),
    ],
)
def test_desi_with_prisms_as_the_ray_trace(shared_desi, prisms, traced):
    file = shared_desi / "desimeter" / "raytrace-tan2fp.json"
    optics, seen = PrismOptics.read(file, PrismAngles(*prisms)), view(flipped=True)
    assert 1e3 * np.abs(cs5(optics, seen) - traced).max() < 0.1
    focal = optics.focal_mm(directions(), seen)
    assert np.abs(optics.directions(focal, seen) - directions()).max() < 1e-12


def test_prisms_open_with_the_zenith_distance_and_stop():
    def opened(zenith_deg):
        return PrismAngles.of(view(zenith_deg=zenith_deg, hour_angle_deg=20.0)).opened_deg

    assert opened(0.0) == pytest.approx(2 * np.degrees(0.0183))
    assert opened(0.0) < opened(30.0) < opened(60.0) == opened(80.0)


def test_a_file_that_is_no_ray_trace(tmp_path):
    (tmp_path / "no.json").write_text("{}")
    with pytest.raises(InputError, match=r"no\.json: no ray trace of desimeter's form: 'zbpolids'"):
        PrismOptics.read(tmp_path / "no.json")


@pytest.mark.parametrize(
    ("zenith", "rotator", "star", "pfi_mm"),
    [
        (90 - 66.907465, -52.034846, (0.5095163, 40.775915), (162.1680, 31.8696)),
        (90 - 66.907465, -52.034846, (0.5653934, -82.871268), (-129.4124, 130.4741)),
        (90 - 66.907465, -52.034846, (0.6323433, 123.668433), (64.7961, -196.2537)),
        (90 - 42.576425, -25.519546, (0.5380717, -176.218885), (-162.3101, -64.3688)),
        (90 - 42.576425, -25.519546, (0.0000080, 64.056098), (0.1112, -0.0224)),
    ],
)
def test_pfs_from_its_own_angles(zenith, rotator, star, pfi_mm):
    seen = view(zenith_deg=zenith, pole_deg=rotator, parallactic_deg=0.0)
    sep, angle = np.radians(star)
    # angle: less the direction from up through growing azimuth; the image's east is to shrinking azimuth here
    unit = np.array([[np.sin(sep) * np.sin(angle), np.sin(sep) * np.cos(angle), np.cos(sep)]])
    optics = PrimeFocus()
    focal = optics.focal_mm(unit, seen)
    assert optics.plane_mm(focal, seen)[0] == pytest.approx(pfi_mm, abs=1e-4)
    assert optics.directions(focal, seen) == pytest.approx(unit, abs=1e-13)
    assert optics.from_plane_mm(optics.plane_mm(focal, seen), seen) == pytest.approx(focal, abs=1e-12)


def test_pfs_prisms():
    assert adc_mm(90 - 66.907465) == pytest.approx(5.402891, abs=1e-6)
    assert adc_mm(90 - 42.576425) == pytest.approx(13.830685, abs=2e-5)


def test_projections_differ_as_they_must():
    """At 2.5 deg and F = 20 m."""
    angle = np.radians([2.5])
    radii = [scaled(20000.0, p, ()).radius_mm(angle)[0] for p in ("linear", "sin", "tan")]
    assert radii == pytest.approx([872.66, 872.39, 873.22], abs=5e-3)


@pytest.mark.parametrize(
    "law",
    [
        sphere(9208.0, (1.36580, 6.09425e-3, 6.54926e-4, 2.62176e-5, -2.27106e-5)),
        polynomial((243.02546, 4.043221, 0.0432912, 0.00136928)),
        scaled(20000.0, "linear", (0.3, -2.0)),
        scaled(120046.0, "tan", ()),
        scaled(120046.0, "sin", (1.0,)),
    ],
)
def test_radial_laws_go_back(law):
    angle = np.radians(np.linspace(0.0, 1.5, 50))
    assert law.angle_rad(law.radius_mm(angle)) == pytest.approx(angle, abs=1e-15)


def test_a_radius_beyond_the_surface_is_nowhere():
    assert np.isnan(sphere(100.0, (1.0,)).angle_rad(np.array([101.0]))).all()


def test_the_position_angle_goes_from_north_through_east_to_y():
    """A star to the north at PA 0 is on +y; turn the plane by 90 deg and a star to the east is."""
    optics, north, east = RoundOptics(polynomial((200.0,))), [[0.0, 0.01, 1.0]], [[0.01, 0.0, 1.0]]
    for star, pa in ((north, 0.0), (east, 90.0)):
        seen = view(pa_deg=pa)
        x, y = optics.plane_mm(optics.focal_mm(np.array(star), seen), seen)[0]
        assert y > 0 and abs(x) < 1e-12  # noqa: PT018
    seen = view(flipped=True)
    assert optics.plane_mm(optics.focal_mm(np.array(east), seen), seen)[0, 0] < 0


def test_scales_of_the_presets_in_um_per_arcsec():
    """At the centre: [D] of published plate scales."""
    published = {"sdssv": 60.97, "desi": 67.507, "lamost": 96.96, "megara": 824.2, "moons": 582.0}
    for name, um_arcsec in published.items():
        site = next(iter(load_instrument(name).sky.sites.values()))
        optics, _ = optics_at(site, 6231.0)
        mm = optics.focal_mm(np.array([[np.radians(1 / 3600.0), 0.0, 1.0]]), view())[0, 0]
        # SDSS-V's figure is of BOSS
        assert 1e3 * mm == pytest.approx(um_arcsec, rel=6e-3 if name == "sdssv" else 2e-4)


def test_every_preset_has_a_sky_and_a_wavelength_for_each_science_fibre():
    for name in instrument_names():
        model = load_instrument(name)
        assert model.sky is not None
        assert set(model.sky.fibre_wavelength_A) == set(model.science_fibres)


def test_several_optics_must_be_told_apart_by_wavelength():
    data = load_instrument("lamost").model_dump(mode="json")
    data["sky"]["sites"]["xinglong"]["optics"] *= 2
    with pytest.raises(InputError, match=r"sites.xinglong.optics: several, so each must be of kind 'sphere'"):
        parse_instrument(data, "mine.toml")


def test_newton_finds_what_a_map_came_from():
    def bent(xy):
        x, y = xy.T
        return np.column_stack([270 * x + 3 * x * y, 270 * y - 2 * x**2 + 5 * y * (x**2 + y**2)])

    rng = np.random.default_rng(0)
    where = rng.uniform(-0.6, 0.6, (50, 2))
    assert inverse(bent, bent(where), bent(where) / 270.0) == pytest.approx(where, abs=1e-14)
