"""What the begin check weighs: densities that integrate to one, and exchanged numbers."""

from dataclasses import replace

import numpy as np
import pytest

from fiberloom.instruments import generate, load_instrument
from fiberloom.instruments.arms import CENTRE
from fiberloom.metrology import Measurement
from fiberloom.operation.safety import begin
from fiberloom.operation.safety.begin import Report, begin_check
from fiberloom.operation.safety.seen import SCATTER_MM

PLANE = generate(load_instrument("sdssv"), 0, n_positioners=7)
DEPLOYED = np.column_stack([np.linspace(20.0, 320.0, 7), np.linspace(60.0, 120.0, 7)])
ALL = np.ones(7, dtype=bool)


def seen_at(xy_mm):
    return Measurement(*np.array(xy_mm).T, ALL, 0.0)


def test_a_miss_along_a_line_is_certain_to_be_somewhere():
    off_mm = np.linspace(-8.0, 8.0, 20_001) * SCATTER_MM
    assert np.trapezoid(begin._normal_1d(off_mm, SCATTER_MM), off_mm) == pytest.approx(1.0, abs=1e-6)
    # and its standard deviation is the scatter
    variance = np.trapezoid(off_mm**2 * begin._normal_1d(off_mm, SCATTER_MM), off_mm)
    assert np.sqrt(variance) == pytest.approx(SCATTER_MM, rel=1e-6)


def test_a_fibre_with_one_axis_astray_is_certain_to_be_somewhere():
    """Half of it on the circle about the alpha axis, half on that about the elbow: in all one."""
    report_mm = PLANE.forward(*DEPLOYED.T)
    elbows_mm = PLANE.elbows_mm(DEPLOYED[:, 0])
    total = np.zeros(7)
    turn = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
    across_mm = np.linspace(-5.0, 5.0, 21) * SCATTER_MM
    for about_mm, own in ((PLANE.centres_mm, 0), (elbows_mm, 1)):
        radius_mm = np.hypot(*(report_mm - about_mm).T)
        for angle in turn:
            out = np.array([np.cos(angle), np.sin(angle)])
            for miss_mm in across_mm:
                at_mm = about_mm + (radius_mm + miss_mm)[:, None] * out
                density = begin._one_axis(PLANE, Report(DEPLOYED, ALL, seen_at(at_mm), ~ALL))
                # where the circles cross, each is counted with its own share only
                other_mm = (PLANE.centres_mm, elbows_mm)[1 - own]
                other = np.hypot(*(at_mm - other_mm).T) - np.hypot(*(report_mm - other_mm).T)
                mine = np.abs(miss_mm) <= np.abs(other)
                area_mm2 = (radius_mm + miss_mm) * (2.0 * np.pi / len(turn)) * (across_mm[1] - across_mm[0])
                total += np.where(mine, density * area_mm2, 0.0)
    # the grid resolves no crossing: a few of 90 steps are lost or doubled there
    np.testing.assert_allclose(total, 1.0, atol=0.06)


def exchanged(a, b, angles_deg):
    """The check where the two numbers are exchanged: each reports the angles of the other."""
    reported = angles_deg.copy()
    reported[[a, b]] = angles_deg[[b, a]]
    return begin_check(PLANE, Report(reported, ALL, seen_at(PLANE.forward(*angles_deg.T)), ~ALL))


def test_exchanged_numbers_are_found_where_the_fibre_is_opposite_to_its_report():
    """Of a positioner on the optical axis: fibre and report at the same radius, on either side of it."""
    middle, other = (int(k) for k in np.argsort(np.hypot(*PLANE.centres_mm.T))[:2])
    arms = PLANE.arms.copy()
    arms[:, CENTRE] -= PLANE.centres_mm[middle]
    plane = replace(PLANE, arms=arms)
    place_mm = plane.forward([40.0], [90.0], index=[middle])[0]
    found = plane.inverse(np.array([place_mm, -place_mm]), index=[middle, middle])
    assert found.reachable.all()
    angles = DEPLOYED.copy()
    angles[[middle, other]] = np.column_stack([found.alpha_deg, found.beta_deg])
    reported = angles.copy()
    reported[[middle, other]] = angles[[other, middle]]
    report = Report(reported, ALL, seen_at(plane.forward(*angles.T)), ~ALL)
    _, partner = begin._swapped(plane, report, plane.forward(*reported.T))
    assert [partner[i] for i in (middle, other)] == [other, middle]


@pytest.mark.parametrize("which", [1, 2])
def test_the_partner_is_named_also_where_it_is_the_first_of_the_layout(which):
    other = int(np.argsort(np.hypot(*(PLANE.centres_mm - PLANE.centres_mm[0]).T))[which])
    result = exchanged(0, other, DEPLOYED)
    assert f"where positioner {PLANE.positioner_id[0]} reports to be" in result.text[other]
    assert f"where positioner {PLANE.positioner_id[other]} reports to be" in result.text[0]
