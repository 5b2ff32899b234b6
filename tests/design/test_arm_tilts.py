"""Tilted axes and fibres: defocus, focal ratio and light, against arithmetic and turned arms."""

import json
import math

import numpy as np
import pytest

from fiberloom.design.budget.tilt import (
    Tilts,
    beyond_collimator,
    half_angle_deg,
    output_ratio,
    simulated_tilts,
    tilted,
)
from fiberloom.design.throughput import FibreOptics
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument

PLANE = generate(load_instrument("sdssv"), 0, n_positioners=300)


@pytest.mark.parametrize(
    "tilts",
    [
        Tilts(5.0, alpha_deg=0.1),
        Tilts(5.0, beta_deg=0.1, curvature_mm=9000.0),
        Tilts(5.0, 0.3, 0.2, 0.4, 4.8),
        Tilts(2.2, fibre_deg=1.0, curvature_mm=3000.0),
    ],
)
def test_formulas_are_those_of_arms_turned_in_space(tilts):
    """300 units: the rms of 600 normal numbers scatters by 3 %, their 95 % by 4."""
    formula, turned = tilted(PLANE, tilts), simulated_tilts(PLANE, tilts, 1, 8)
    assert formula.defocus_um == pytest.approx(turned.defocus_um, rel=0.09)
    assert formula.fibre_deg == pytest.approx(turned.fibre_deg, rel=0.09)
    assert formula.fibre_95_deg == pytest.approx(turned.fibre_95_deg, rel=0.12)
    assert formula.leaves_at == pytest.approx(turned.leaves_at, rel=0.03)
    assert formula.beyond == pytest.approx(turned.beyond, rel=0.2, abs=3e-4)
    if tilts.alpha_deg or tilts.beta_deg:  # a curved surface alone is no normal defocus
        assert formula.defocus_95_um == pytest.approx(turned.defocus_95_um, rel=0.12)


def test_a_tenth_of_a_degree_at_the_reach():
    """39 um at 22.4 mm; over the annulus and all directions 0.1 deg times sqrt((7.4^2 + 15^2)/2)."""
    assert math.radians(0.1) * 22.4 == pytest.approx(0.039, abs=1e-3)
    found = tilted(PLANE, Tilts(5.0, alpha_deg=0.1))
    assert found.defocus_um == pytest.approx(
        1e3 * math.radians(0.1) * math.sqrt((7.4**2 + 14.97**2) / 2), rel=1e-3
    )
    assert found.blur_95_um == pytest.approx(found.defocus_95_um / 5.0)


def test_a_tilted_fibre_makes_its_cone_faster():
    assert output_ratio(5.0, 0.1) == pytest.approx(4.91, abs=0.005)
    assert output_ratio(5.0, 0.4) == pytest.approx(4.67, abs=0.005)
    margins = {(5.0, 4.0): 1.4, (3.86, 3.57): 0.6, (2.8, 2.5): 1.2}
    for (beam, taken), deg in margins.items():
        assert half_angle_deg(taken) - half_angle_deg(beam) == pytest.approx(deg, abs=0.05)


def test_light_is_lost_beyond_the_margin_only():
    margin = half_angle_deg(4.0) - half_angle_deg(5.0)
    lost = beyond_collimator(
        Tilts(5.0, collimator_ratio=4.0), np.array([0.0, 0.9 * margin, 1.1 * margin, 30.0])
    )
    assert lost[:2] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert 0.0 < lost[2] < 0.01
    assert lost[3] == pytest.approx(1.0)
    assert beyond_collimator(Tilts(5.0), np.array([0.1]))[0] == pytest.approx(0.011, abs=5e-4)


def test_defocus_spreads_a_point_over_a_disc():
    """Against points drawn from the seeing and from the disc, one by one."""
    optics, rng = FibreOptics(120.0, 60.0), np.random.default_rng(0)
    n = 400_000
    seeing = optics.core_radius_um * np.sqrt(rng.random(n) ** (-1.0 / 2.5) - 1.0)
    turn, around = rng.uniform(0.0, 2.0 * np.pi, (2, n))
    blur = 0.5 * 300.0 / 5.0 * np.sqrt(rng.random(n))
    x, y = seeing * np.cos(turn) + blur * np.cos(around), seeing * np.sin(turn) + blur * np.sin(around)
    inside, focused = (np.hypot(x, y) < 60.0).mean(), (seeing < 60.0).mean()
    # the same points for both: the difference scatters by 5e-4
    assert optics.defocus_loss(300.0, 5.0)[0] == pytest.approx(1.0 - inside / focused, abs=2e-3)
    assert optics.mean_defocus_loss(10.0, 5.0) == pytest.approx(0.5 * optics.k_per_um2, rel=0.03)


TABLE = [
    # fibre in um, um per arcsec, focal ratio: per cent lost at 50, 100, 200 um in 1 arcsec
    ((120.0, 60.0), 5.0, (0.2, 0.8, 3.1)),
    ((107.0, 70.0), 3.9, (0.4, 1.8, 7.0)),
    ((127.0 / 1.28, 89.0), 2.2, (1.3, 5.2, 19.0)),
]


@pytest.mark.parametrize(("fibre", "focal_ratio", "lost"), TABLE)
def test_what_defocus_costs(fibre, focal_ratio, lost):
    """An independent table, whose blur is 5 to 12 % larger than that of an open pupil; given to one digit."""
    found = 100.0 * FibreOptics(*fibre).defocus_loss([50.0, 100.0, 200.0], focal_ratio)
    assert found == pytest.approx(lost, rel=0.13, abs=0.05)


def test_bad_tilts_are_refused_with_what_would_do(fl):
    for asked, says in (
        ({"alpha_deg": 30.0}, "0 to 20"),
        ({"collimator_ratio": 6.0}, "slower than the beam"),
        ({"curvature_mm": 0.0}, "above 0"),
    ):
        with pytest.raises(InputError, match=says):
            Tilts(5.0, **asked)
    for words, says in (
        (("--axis-tilt", "steep", "--focal-ratio", 5), "two angles"),
        (("--collimator", 4), "go with --focal-ratio"),
    ):
        code, _, said = fl("design", "budget", "sdssv", *words)
        assert code == 2
        assert says in said
    light = ("--core", 120, "--scale", 60)
    assert "needs both" in fl("design", "throughput", "sdssv", *light, "--defocus", 20)[2]
    code, said, _ = fl("design", "throughput", "sdssv", *light, "--defocus", 28, "--focal-ratio", 5, "--json")
    assert code == 0
    assert json.loads(said)["summary"]["defocus_loses_percent"] == pytest.approx(0.054, abs=2e-3)
