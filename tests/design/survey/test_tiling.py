"""Lists larger than a field: every target once, within the hexagon, where it is on the sky."""

import json
import math

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from fiberloom.design.survey import HoursSettings, tiled_survey
from fiberloom.design.survey.tiling import fields_in_mm, fields_on_sky, hexagon_of
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.targets.generate import random_targets

PFS, SDSSV = load_instrument("pfs"), load_instrument("sdssv")
SEVEN = generate(PFS, 0, n_positioners=7)
SCALE = 60.0
ARCSEC_RAD = math.pi / 648000.0


def inside(xy_mm, hexagon, slack=1e-6):
    """(n,) within all six sides."""
    faces = hexagon.turned_rad + np.radians(30.0 + 60.0 * np.arange(6))
    towards = xy_mm @ np.stack([np.cos(faces), np.sin(faces)])
    return towards.max(axis=1) <= hexagon.circumradius_mm * math.sqrt(0.75) * (1.0 + slack)


@pytest.mark.parametrize("n", [19, 61])
def test_the_hexagon_of_a_hexagonal_array_is_that_array(n):
    plane = generate(SDSSV, 0, n_positioners=n)
    rings = {19: 2, 61: 4}[n]
    found = hexagon_of(plane)
    # arms scatter, and fiducials take the place of some units
    assert 0.94 < found.circumradius_mm / (rings * SDSSV.layout.pitch_mm) < 1.01
    centres = plane.centres_mm - plane.centres_mm.mean(axis=0)
    corners = found.turned_rad + np.radians(60.0 * np.arange(6))
    ring = found.circumradius_mm * np.column_stack([np.cos(corners), np.sin(corners)])
    hull = ConvexHull(centres)
    assert ConvexHull(np.vstack([centres, 0.999 * ring])).volume == pytest.approx(hull.volume, rel=1e-12)
    assert ConvexHull(np.vstack([centres, 1.01 * ring])).volume > hull.volume
    assert hexagon_of(generate(SDSSV, 0, n_positioners=1)).circumradius_mm > 20.0


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_in_the_plane_every_target_is_in_one_hexagon(angle):
    rng = np.random.default_rng(1)
    xy = rng.uniform(-500.0, 500.0, (4000, 2))
    hexagon = hexagon_of(generate(SDSSV, 0, n_positioners=61))
    fields = list(fields_in_mm(xy, hexagon, angle, rng.uniform(size=2)))
    assert sorted(np.concatenate([one.rows for one in fields])) == list(range(4000))
    assert all(inside(one.xy_mm, hexagon).all() for one in fields)
    # distances between targets of a field are as in the list
    one = max(fields, key=lambda one: len(one.rows))
    apart = np.linalg.norm(np.diff(one.xy_mm, axis=0), axis=1)
    np.testing.assert_allclose(apart, np.linalg.norm(np.diff(xy[one.rows], axis=0), axis=1), rtol=1e-9)
    area = 1.5 * math.sqrt(3.0) * hexagon.circumradius_mm**2
    assert 1e6 / area < len(fields) < 1.5 * 1e6 / area


@pytest.mark.parametrize(
    ("ra", "dec", "wide"), [(180.0, 25.0, 10.0), (359.0, -80.0, 30.0), (10.0, 84.0, 20.0)]
)
def test_on_the_sky_every_target_is_in_one_hexagon_at_its_distance(ra, dec, wide):
    rng = np.random.default_rng(2)
    radec = np.column_stack(
        [ra + rng.uniform(-wide, wide, 3000), np.clip(dec + rng.uniform(-9, 9, 3000), -90, 90)]
    )
    hexagon = hexagon_of(generate(SDSSV, 0, n_positioners=500))
    fields = list(fields_on_sky(radec, SCALE, hexagon, 0.4, rng.uniform(size=2)))
    assert sorted(np.concatenate([one.rows for one in fields])) == list(range(3000))
    # a tangent stretches by 1/cos^2: 4e-4 at 1.2 deg
    assert all(inside(one.xy_mm, hexagon, 2e-3).all() for one in fields)
    a, d = np.radians(radec).T
    points = np.column_stack([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)])
    for one in fields[:20]:
        p, q = points[one.rows[:-1]], points[one.rows[1:]]
        apart_mm = np.arcsin(np.linalg.norm(np.cross(p, q), axis=1)) / ARCSEC_RAD * SCALE * 1e-3
        found = np.linalg.norm(np.diff(one.xy_mm, axis=0), axis=1)
        np.testing.assert_allclose(found, apart_mm, rtol=2e-3, atol=1e-6)


def test_a_list_round_the_sky_is_refused():
    with pytest.raises(
        InputError, match=r"goes \d+ deg from its middle; cut it into parts of at most 60 deg"
    ):
        list(fields_on_sky(np.array([[0.0, 0.0], [170.0, 10.0]]), SCALE, hexagon_of(SEVEN), 0.0, np.zeros(2)))


def whole(xy, **asked):
    wanted = random_targets(SEVEN, len(xy), seed=0)
    hexagon = hexagon_of(SEVEN)
    return tiled_survey(
        SEVEN, wanted, lambda angle, phase: fields_in_mm(xy, hexagon, angle, phase), HoursSettings(**asked)
    )


def test_no_survey_makes_more_visits_than_there_are_fibres():
    xy = np.random.default_rng(3).uniform(-30.0, 30.0, (150, 2))
    found = whole(xy, share=0.9, turns=2, fields=999)
    assert found.planned == round(2 * found.fields)
    assert found.exposures >= 0.9 * found.reachable * 150 / 7
    assert found.used == pytest.approx(0.9 * found.reachable * 150 / (7 * found.exposures), rel=0.1)
    assert whole(xy, share=0.5, turns=2, fields=999).exposures < 0.5 * found.exposures
    assert whole(xy, share=1.0, turns=2, fields=999, most=1).exposures is None


def test_far_apart_targets_take_a_field_each_and_a_sample_of_fields_stands_for_all():
    xy = 1e3 * np.random.default_rng(4).uniform(-1.0, 1.0, (40, 2))
    found = whole(xy, share=1.0, turns=3, fields=999)
    assert found.exposures == pytest.approx(found.fields * found.reachable, rel=0.03)
    drawn = whole(xy, share=1.0, turns=3, fields=10)
    assert drawn.planned == 30
    assert drawn.exposures == pytest.approx(found.exposures, rel=0.3)


def test_the_command_cuts_lists_in_mm_and_on_the_sky(fl, tmp_path):
    rng = np.random.default_rng(5)
    flat, sky = tmp_path / "flat.csv", tmp_path / "sky.csv"
    flat.write_text(
        "target_id,x_mm,y_mm\n"
        + "".join(f"{k},{x},{y}\n" for k, (x, y) in enumerate(rng.uniform(-60, 60, (60, 2))))
    )
    sky.write_text(
        "target_id,ra,dec\n"
        + "".join(f"{k},{a},{d}\n" for k, (a, d) in enumerate(rng.uniform(10, 10.5, (60, 2))))
    )
    words = ("--positioners", 7, "--turns", 2, "--fields", 3, "--json")
    code, said, _ = fl("design", "survey", "pfs", "--targets", flat, *words)
    told = json.loads(said)["survey"]
    assert code == 0
    assert told["fields"] > 20
    assert told["fields_planned"] == 6
    assert told["hours"] == pytest.approx(told["exposures"] * 960.0 / 3600.0, rel=0.01)
    code, said, _ = fl("design", "survey", "pfs", "--targets", sky, "--scale", 60, *words)
    assert (code, json.loads(said)["survey"]["targets"]) == (0, 60)
    code, _, err = fl("design", "survey", "pfs", "--targets", sky, *words)
    assert code == 2
    assert "give the focal plane's --scale, um per arcsec" in err
    assert fl("design", "survey", "pfs", "--targets", sky, "--scale", 0, *words)[0] == 2
    assert fl("design", "survey", "pfs", "--targets", flat, *words, "--fields", 0)[0] == 2
