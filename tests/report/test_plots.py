"""Figures: axes with units, titles that say the result, as many artists as there are data."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from fiberloom.calibration.bench.arms import Arms, ArmsData
from fiberloom.calibration.bench.estimate import Estimate, Fitted, Residuals, estimate
from fiberloom.calibration.bench.friction import Friction, FrictionData
from fiberloom.calibration.bench.inertia import Inertia, InertiaData
from fiberloom.calibration.bench.repeatability import Repeatability, RepeatabilityData
from fiberloom.calibration.bench.stiffness import StiffnessData, identify_stiffness
from fiberloom.calibration.bench.torque import TorqueScale, Windows
from fiberloom.calibration.transmission.maps import Provenance, TransmissionMaps
from fiberloom.instruments import generate
from fiberloom.metrology.images import CameraImage
from fiberloom.metrology.matching import MatchStatus
from fiberloom.metrology.spots import Flag, Spots
from fiberloom.report import identification
from fiberloom.report.convergence import plot_convergence
from fiberloom.report.exposure import plot_reduction, plot_spots
from fiberloom.report.figures import number_outline
from fiberloom.report.focal_plane import (
    FieldPicture,
    draw_focal_plane,
    errors_title,
    frame_positioners,
    plot_errors,
    plot_focal_plane,
)
from fiberloom.report.lifetime import STYLES, LifetimeCurves, plot_deltas, plot_lifetime, rms
from fiberloom.report.transmission import plot_transmission

N = 3


@pytest.fixture(scope="module")
def few(sdssv):
    return generate(sdssv, seed=0, n_positioners=N)


def line(axes, label):
    """The one line of the axes with this label."""
    (found,) = [one for one in axes.lines if one.get_label() == label]
    return found


def about(name="q", unit="µNm", value=2.0, residuals=None, reason=("", "", "stalled")) -> Estimate:
    left = np.zeros((N, 4)) if residuals is None else residuals
    fitted = Fitted(np.full(N, value), np.full(N, 0.1))
    return estimate(name, unit, fitted, Residuals(left, unit), reason)


def test_convergence_is_drawn_by_quantity_against_configurations(tmp_path, written):
    rows = [
        {"configurations": n, "error_um": {"centre": 8 / n, "l_alpha": 6 / n, "l_beta": 4 / n},
         "standard_error_um": {"centre": 1.0, "l_alpha": 1.0, "l_beta": 1.0}}
        for n in (5, 20, 80)
    ]  # fmt: skip
    plot_convergence(tmp_path / "c.png", rows, 500, 2.0)
    (axes,) = written[0].axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("configurations", "rms over positioners [µm]")
    assert axes.get_title().endswith("500 positioners, camera 2 µm: error")
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    drawn = line(axes, "centre, 0.10 µm at 80")
    np.testing.assert_allclose(drawn.get_xydata(), [[5, 1.6], [20, 0.4], [80, 0.1]])
    blind = [row | {"error_um": {}} for row in rows]
    plot_convergence(tmp_path / "s.png", blind, 500, 2.0)
    assert written[1].axes[0].get_title().endswith(": standard error")
    assert (tmp_path / "s.png").read_bytes().startswith(b"\x89PNG")


def picture(plane, flagged=()):
    error_um = np.arange(1.0, len(plane) + 1)
    error_um[0] = np.nan
    flags = np.isin(np.arange(len(plane)), flagged)
    return FieldPicture(np.full((len(plane), 2), [30.0, 120.0]), error_um, flags, 5.0, "all within 5 µm")


def test_a_focal_plane_shows_every_arm_and_colours_the_served_fibres(few, tmp_path, written):
    plot_focal_plane(tmp_path / "f.png", few, picture(few, flagged=[2]))
    axes, bar = written[0].axes
    arms = [c for c in axes.collections if isinstance(c, LineCollection)]
    assert [len(c.get_segments()) for c in arms] == [N, N]
    for alpha, beta in zip(arms[0].get_segments(), arms[1].get_segments(), strict=True):
        np.testing.assert_array_equal(alpha[1], beta[0])
    lengths = [np.hypot(*(s[1] - s[0])) for s in arms[0].get_segments()]
    np.testing.assert_allclose(lengths, few.l_alpha_mm, rtol=1e-9)
    fiducials, dots, rings = [c for c in axes.collections if not isinstance(c, LineCollection)]
    np.testing.assert_array_equal(fiducials.get_offsets(), few.fiducials[:, :2])
    # no target, served, flagged
    np.testing.assert_array_equal(dots.get_array(), [2.0])
    assert len(rings.get_offsets()) == 1
    assert [t.get_text() for t in axes.texts] == [str(few.positioner_id[2])]
    assert axes.get_title() == "all within 5 µm"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [mm]", "y [mm]")
    assert bar.get_ylabel() == "error of the fibre [µm]"


def test_without_a_flag_no_ring_is_drawn_and_the_frame_holds_the_arms(few):
    axes = Figure().subplots()
    assert draw_focal_plane(axes, few, picture(few)) is axes
    assert not axes.texts
    frame_positioners(axes, few)
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    reach = few.body_reach_mm.max()
    assert left <= few.centres_mm[:, 0].min() - reach
    assert right >= few.centres_mm[:, 0].max() + reach
    assert bottom <= few.centres_mm[:, 1].min() - reach
    assert top >= few.centres_mm[:, 1].max() + reach


@pytest.mark.parametrize(
    ("moves", "said"),
    [
        ([], "no error is known of any of 3 assigned fibres"),
        ([[np.nan, np.nan]], "no error is known of any of 3 assigned fibres"),
        ([[3.0, 4.0]], "2 of 3 assigned fibres within 5 µm; 3.54 µm rms"),
        ([[30.0, 40.0], [1.0, 1.0]],
         "2 of 3 assigned fibres within 5 µm; corrected from 35.36 to 1.00 µm rms"),
        ([[30.0], [1.0], [2.0]],
         "1 of 3 assigned fibres within 5 µm; the last correction made it worse: 1.00 to 2.00 µm rms"),
        ([[3.0], [1.0], [6.0]],
         "0 of 3 assigned fibres within 5 µm; the corrections made it worse: 3.00 to 6.00 µm rms"),
    ],
)  # fmt: skip
def test_the_title_of_the_errors_says_the_result(tmp_path, written, moves, said):
    errors = [np.array(move) for move in moves]
    title = errors_title(errors, 3, 5.0)
    assert title == said
    plot_errors(tmp_path / "e.png", errors, [f"move {k}" for k in range(len(moves))], 5.0, title)
    assert written[0].axes[0].get_title() == said


def test_errors_are_a_distribution_for_each_move_that_was_seen(tmp_path, written):
    moves = [np.array([3.0, np.nan, 4.0]), np.full(3, np.nan), np.array([1.0, 1.0, 1.0])]
    plot_errors(tmp_path / "e.png", moves, ["blind", "not seen", "correction 1"], 5.0)
    (axes,) = written[0].axes
    labels = [one.get_label() for one in axes.lines]
    assert labels == ["blind: 3.54 µm rms", "correction 1: 1.00 µm rms", "requirement 5 µm"]
    np.testing.assert_array_equal(axes.lines[0].get_xydata(), [[3.0, 50.0], [4.0, 100.0]])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("error of the fibre [µm]", "fibres below [%]")


def maps_with_backlash(plane, gap_deg=0.1):
    theta = np.broadcast_to(np.linspace(0.0, 180.0, 40), (len(plane), 2, 2, 40)).copy()
    wire = theta + np.array([0.0, gap_deg])[None, None, :, None]
    wire[1] += 0.3
    return TransmissionMaps(plane.positioner_id, wire, theta, Provenance(gear=1000.0))


def test_a_transmission_shows_both_contacts_and_the_backlash(few, tmp_path, written):
    plot_transmission(tmp_path / "t.png", maps_with_backlash(few), 1)
    figure = written[0]
    assert figure.get_suptitle().startswith(
        f"Positioner {few.positioner_id[1]}: deviation from a linear gear"
    )
    assert "1000" in figure.get_suptitle()
    for panel in figure.axes[:2]:
        np.testing.assert_allclose(line(panel, "negative contact").get_ydata(), 0.3, atol=1e-9)
        np.testing.assert_allclose(line(panel, "positive contact").get_ydata(), 0.4, atol=1e-9)
        assert panel.get_ylabel() == "δ [deg]"
    for panel in figure.axes[2:]:
        np.testing.assert_allclose(panel.lines[0].get_ydata(), 100.0, atol=1e-6)
        assert panel.get_ylabel() == "backlash [motor deg]"
        assert panel.get_title() == "backlash 100 to 100 motor deg"


CYCLES = 4


def curves(n=2):
    rng = np.random.default_rng(2)
    arms = 7.4 + 1e-3 * rng.normal(size=(n, CYCLES, 2))
    angles = np.stack([np.linspace(0, 360, 30), np.linspace(0, 180, 30)])
    truth = rng.normal(0.0, 0.1, (n, 2, 2, 30))
    off_deg = {"true": 0.0, "recalibrated": 0.01, "adaptive": 0.02, "adaptive_paper": 0.03}
    deltas = {name: truth + off for name, off in off_deg.items()}
    return LifetimeCurves(
        np.arange(CYCLES),
        np.arange(n) + 11,
        {way: np.full((n, CYCLES), 1.0 + k) for k, way in enumerate(STYLES)},
        arms + 1e-4,
        arms,
        [0, 3],
        angles,
        deltas,
    )


def test_a_lifetime_shows_every_way_and_every_arm(tmp_path, written):
    plot_lifetime(tmp_path / "l.png", curves())
    left, right = written[0].axes
    # each way: its rms and the two units
    assert len(left.lines) == 3 * len(STYLES)
    for k, (_, _, label) in enumerate(STYLES.values()):
        np.testing.assert_array_equal(line(left, label).get_ydata(), np.full(CYCLES, 1.0 + k))
    assert "Learning holds 4.0 µm (as printed 3.0); recalibrating 5.0" in left.get_title()
    assert (left.get_xlabel(), left.get_ylabel()) == (
        "cycle of 15260 moves",
        "error of blind moves, rms [µm]",
    )
    # dots as calibrated and a line in truth, for each of two arms of two units
    assert len(right.lines) == 8
    found, true = right.lines[:2]
    np.testing.assert_allclose(found.get_ydata() - true.get_ydata(), 0.1, atol=1e-9)
    assert true.get_ydata()[0] == 0.0
    assert [t.get_text() for t in right.get_legend().get_texts()] == [
        f"{axis} arm, positioner {unit}" for unit in (11, 12) for axis in ("alpha", "beta")
    ]


def test_a_lifetime_of_one_unit_draws_no_units_beside_the_mean(tmp_path, written):
    plot_lifetime(tmp_path / "l.png", curves(1))
    assert len(written[0].axes[0].lines) == len(STYLES)
    assert len(written[0].axes[1].lines) == 4


def test_deltas_are_drawn_less_their_first_course(tmp_path, written):
    made = curves()
    plot_deltas(tmp_path / "d.png", made)
    panels = written[0].axes
    assert [p.get_title() for p in panels] == ["positioner 11, cycle 3", "positioner 12, cycle 3"]
    begun = made.delta_deg["true"][1, 0, 1]
    np.testing.assert_allclose(
        line(panels[1], "adaptive").get_ydata(), made.delta_deg["adaptive"][1, 1, 1] - begun
    )
    assert [p.get_xlabel() for p in panels] == ["beta [deg]"] * 2
    assert panels[0].get_ylabel() == "change of δ [deg]"
    title = written[0].get_suptitle()
    assert "off by 20 mdeg rms (adaptive), 30 (as printed), 10 (recalibrated)" in title
    change = np.abs(made.delta_deg["true"][:, 1, 1] - made.delta_deg["true"][:, 0, 1]).max()
    assert f"wear changes it by {change:.2f} deg at most" in title


def test_units_that_dropped_out_do_not_count():
    error = np.array([[3.0, np.nan], [4.0, np.nan]])
    np.testing.assert_allclose(rms(error, axis=0), [np.sqrt(12.5), np.nan])
    assert rms(error) == pytest.approx(np.sqrt(12.5))


# what a camera sees


def spots_at(xy, flags):
    n = len(xy)
    zero = np.zeros(n)
    return Spots(
        *np.asarray(xy, float).T, np.zeros((n, 2, 2)), zero, zero, zero, zero, np.array(flags, np.uint32)
    )


@pytest.mark.parametrize("fits", [False, True])
def test_spots_are_ringed_and_the_flagged_ones_in_red(tmp_path, written, fits):
    adu = np.random.default_rng(1).integers(90, 110, (60, 80)).astype(np.uint16)
    adu[40, 50] = 60000
    pixels = (adu ^ np.uint16(0x8000)).byteswap() if fits else adu
    # a ray of cosmic origin does not spoil a centre by itself
    spots = spots_at([[10, 20], [50, 40], [70, 5]], [0, Flag.COSMIC, Flag.SATURATED])
    plot_spots(tmp_path / "s.png", CameraImage(pixels, fits), spots)
    (axes,) = written[0].axes
    plain, red = axes.collections
    np.testing.assert_array_equal(plain.get_offsets(), [[10, 20], [50, 40]])
    np.testing.assert_array_equal(red.get_offsets(), [[70, 5]])
    assert axes.get_title() == "3 spots, 1 flagged"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [px]", "y [px]")
    shown = axes.images[0].get_array()
    assert shown.shape == (60, 80)
    assert np.unravel_index(np.argmax(shown), shown.shape) == (40, 50)


def test_no_spot_falls_between_the_pixels_that_are_shown(tmp_path, written):
    adu = np.zeros((3003, 40), np.float32)
    adu[3000, 21] = 5e4
    adu[1501, 0] = np.nan
    plot_spots(tmp_path / "s.png", CameraImage(adu), spots_at([[21, 3000]], [0]))
    shown = written[0].axes[0].images[0].get_array()
    assert shown.shape == (1001, 13)
    assert np.unravel_index(np.argmax(shown), shown.shape) == (1000, 7)
    assert np.isfinite(shown).all()


# identifications: one row each of alpha and beta; the third unit was refused


def windows(level, rpm, n=30):
    motor = np.tile(np.linspace(0.0, 360.0, n), (N, 1))
    speed = np.full((N, n), rpm / 30.0 * np.pi)
    return Windows(np.full((N, n), level), motor, np.stack([motor, motor], -1), speed)


def friction(axis):
    segments = (windows(0.3, 30), windows(-0.1, -30), windows(0.5, 500))
    data = FrictionData(axis, segments, (True, True, False), (90.0, 90.0, 0.0), [""] * N, 1000.0)
    coulomb = about("coulomb", residuals=np.full((N, 90), 0.5))
    found = Friction(axis, coulomb, *[about() for _ in range(4)], about("drag", value=0.0), np.zeros((N, 90)))
    return data, found


def test_friction_shows_break_away_running_and_residuals(few, tmp_path, written):
    (a, found_a), (b, found_b) = friction(0), friction(1)
    scales = [TorqueScale(100.0, 0.05), TorqueScale(np.full(N, 200.0), 0.05)]
    identification.plot_friction(tmp_path / "f.png", few, (a, b), [found_a, found_b], scales, 1)
    figure = written[0]
    assert figure.get_suptitle().startswith(f"sdssv, positioner {few.positioner_id[1]}: friction")
    for axis, full in ((0, 100.0), (1, 200.0)):
        creep, running, left = figure.axes[axis::2]
        up, down = creep.lines
        np.testing.assert_allclose(up.get_ydata(), 0.3 * full)
        np.testing.assert_allclose(down.get_ydata(), -0.1 * full)
        assert creep.get_title().startswith(f"{('alpha', 'beta')[axis]}: Coulomb 2 ± 0.1 µNm")
        assert creep.get_ylabel() == "torque [µNm]"
        run = line(running, "500 rpm")
        np.testing.assert_allclose(run.get_ydata(), 0.5 * full)
        # 360 motor degrees behind a gear of 1000
        assert run.get_xdata()[-1] == pytest.approx(0.36)
        assert len(left.lines) == 3
        assert "rms 0.5 µNm" in left.get_title()


def test_a_refused_unit_leaves_its_panels_empty_and_gives_the_reason(few, tmp_path, written):
    (a, found_a), (b, found_b) = friction(0), friction(1)
    scales = [TorqueScale(100.0, 0.05)] * 2
    identification.plot_friction(tmp_path / "f.png", few, (a, b), [found_a, found_b], scales, 2)
    assert all(not panel.lines for panel in written[0].axes)
    assert identification.said(found_a.coulomb, 2) == "refused: stalled"


@pytest.mark.parametrize("row", [0, 2])
def test_inertia_shows_the_speed_in_rpm_after_each_push(few, tmp_path, written, row):
    k, m, tick = 2, 20, 5e-4
    motor = np.broadcast_to(6.0 * 1000.0 * tick * np.arange(m), (N, k, m)).copy()
    data = InertiaData(0, np.full((N, k, m), 0.25), motor, np.zeros((N, k)), [""] * N, tick)
    j = about("inertia", "kg m2", 1e-9, np.full((N, k * m), 0.2))
    found = Inertia(0, j, about(), np.full(N, 0.004), np.tile([0.0, 1000.0], (N, 1)))
    scales = [TorqueScale(400.0, 0.05)] * 2
    identification.plot_inertia(tmp_path / "i.png", few, (data, data), [found, found], scales, row)
    speed, left = written[0].axes[0], written[0].axes[2]
    if row == 2:
        assert not speed.lines
        assert not left.lines
        return
    assert len(speed.lines) == len(left.lines) == k
    np.testing.assert_allclose(speed.lines[0].get_ydata(), 1000.0)
    assert "100 µNm, 0 to 1000 rpm, 10–90 % in 4.0 ms" in speed.get_title()
    assert (speed.get_xlabel(), speed.get_ylabel()) == ("time [ms]", "speed [rpm]")
    assert left.get_title() == "rms 0.20 motor deg"


@pytest.mark.parametrize("row", [1, 2])
def test_stiffness_shows_each_repeat_beside_the_fit(few, tmp_path, written, row):
    lever, turn = 20.0, np.deg2rad(0.05)
    xy = np.zeros((N, 5, 2, 2))
    xy[..., 0] = lever
    xy[:, :, 1, 1] = turn * lever * np.array([0.9, 1.0, 1.1, 1.0, 1.0])
    xy[2] = np.nan
    data = StiffnessData(0, xy, np.zeros((N, 2)), np.full(N, lever), 5.0, 0.01, ["", "", "not seen"])
    found = identify_stiffness(data)
    # 10 mNm over 0.05 deg
    assert found.value[0] == pytest.approx(200.0, rel=1e-3)
    identification.plot_stiffness(tmp_path / "s.png", few, (data, data), [found, found], row)
    panel = written[0].axes[0]
    if row == 2:
        assert not panel.lines
        return
    dots, mean = panel.lines
    np.testing.assert_allclose(dots.get_ydata(), [45.0, 50.0, 55.0, 50.0, 50.0], rtol=1e-3)
    assert mean.get_ydata()[0] == pytest.approx(50.0, rel=1e-3)
    assert panel.get_title().startswith("alpha: −5 to +5 mNm, k = 200 ± ")
    assert panel.get_ylabel() == "turn of the axis [mdeg]"


@pytest.mark.parametrize("row", [0, 2])
def test_arms_show_radial_residuals_over_the_direction(few, tmp_path, written, row):
    phi = np.deg2rad(np.arange(0.0, 360.0, 45.0))
    circle = 7.4 * np.stack([np.cos(phi), np.sin(phi)], -1)
    data = ArmsData(np.broadcast_to(circle, (2, N, 8, 2)), [""] * N)
    left = np.tile(np.repeat([1.0, 3.0], 8), (N, 1))
    length = about("l_alpha", "mm", 7.4, left)
    arms = Arms(about(), about(), length, about("l_beta", "mm", 15.0))
    identification.plot_arms(tmp_path / "a.png", few, data, arms, row)
    alpha, beta = written[0].axes
    if row == 2:
        assert not alpha.lines
        return
    np.testing.assert_array_equal(alpha.lines[1].get_ydata(), np.ones(8))
    np.testing.assert_array_equal(beta.lines[1].get_ydata(), np.full(8, 3.0))
    assert alpha.get_title() == "while alpha turned: radial rms 1.000 µm; l_alpha = 7.4 ± 0.1 mm"
    assert beta.get_title() == "while beta turned: radial rms 3.000 µm; l_beta = 15 ± 0.1 mm"
    assert sorted(np.round(alpha.lines[1].get_xdata()).astype(int) % 360) == list(range(0, 360, 45))


@pytest.mark.parametrize("row", [0, 2])
def test_repeatability_shows_every_visit_along_and_across_the_way(few, tmp_path, written, row):
    lever = 20.0
    # along the way 2 um, across it nothing: the arm points along y, and turns towards -x
    shift = np.zeros((N, 3, 4, 2))
    shift[..., 0] = 2e-3 * np.array([-1.0, 1.0, -1.0, 1.0])
    data = RepeatabilityData(0, np.array([0.0, lever]) + shift, np.zeros((N, 2)), np.full(N, lever), [""] * N)
    found = Repeatability(0, about("measured", "µm"), about("own", "µm", 1.5), about(), np.zeros((N, 2)))
    identification.plot_repeatability(tmp_path / "r.png", few, (data, data), [found, found], row)
    panel = written[0].axes[0]
    if row == 2:
        assert not panel.lines
        return
    assert len(panel.lines) == 3
    along, across = panel.lines[0].get_data()
    np.testing.assert_allclose(along, [2.0, -2.0, 2.0, -2.0], atol=1e-9)
    np.testing.assert_allclose(across, 0.0, atol=1e-9)
    assert "lever 20.0 mm, rms: as measured 2 ± 0.1 µm" in panel.get_title()
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("along the way [µm]", "across [µm]")


def test_a_reduced_image_is_drawn_with_what_is_missing(few, tmp_path, written):
    """Dark and ambiguous positioners at their expected place, or at their centre where none is known."""
    plane = few
    expected = plane.centres_mm + np.array([5.0, 0.0])
    expected[2] = np.nan
    spots = spots_at([[100.0, 100.0], [300.0, 320.0]], [0, 0])
    transform = SimpleNamespace(
        to_px=lambda mm: 200.0 + mm,
        to_mm=lambda px: px - 200.0,
        distortion_mm=lambda px: np.full(px.shape, 3e-3),
        radius_mm=50.0,
    )
    fit = SimpleNamespace(leave_one_out_mm=np.array([[1e-3, 0.0]]), rms_um=0.5, leave_one_out_rms_um=1.0)
    statuses = [MatchStatus.MATCHED, MatchStatus.DARK, MatchStatus.AMBIGUOUS]
    xy = np.full((N, 2), np.nan)
    xy[0] = expected[0] + [3e-3, 4e-3]
    reduction = SimpleNamespace(
        image=CameraImage(np.random.default_rng(0).normal(100, 3, (400, 400)).astype(np.float32)),
        spots=spots,
        seen=np.array([True, False, False]),
        spot_of_match=np.array([0, -1, -1]),
        acquisition=SimpleNamespace(spot=np.array([1]), fiducial=np.array([0]), fit=fit),
        match=SimpleNamespace(status=np.array(statuses)),
        expected_mm=expected,
        xy_mm=xy,
        transform=transform,
    )
    paths = plot_reduction(tmp_path / "new", "e", plane, reduction)
    assert [p.name for p in paths] == ["e-image.png", "e-residuals.png", "e-distortion.png"]
    labels, residuals, distortion = written
    axes = labels.axes[0]
    numbers, crosses = axes.collections[2::2], axes.collections[3::2]
    np.testing.assert_allclose(crosses[0].get_offsets(), [200.0 + expected[1]])
    np.testing.assert_allclose(crosses[1].get_offsets(), [200.0 + plane.centres_mm[2]])
    for shown, positioner in zip(numbers, plane.positioner_id, strict=True):
        assert np.array_equal(shown.get_paths()[0].vertices, number_outline(positioner).vertices)
    assert axes.get_title().startswith("1 of 3 fibres, 1 fiducials (squares)")
    left, right = residuals.axes
    assert left.get_title() == "fiducials: 0.50 µm rms fitted, 1.00 µm left out"
    assert right.get_title() == "fibres: measured minus where the motors say, 5.00 µm rms of 1"
    # 3 um in x and in y
    assert distortion.axes[0].get_title().endswith("rotation: 4 µm at most")
    # against the targets, where they are known; one that has not gone there is none
    goal_mm = np.stack([xy[0] - [1e-3, 0.0], xy[0] + 1.0, plane.centres_mm[2]])
    reduction.seen, reduction.xy_mm = np.array([True, True, False]), np.stack([xy[0], xy[0], xy[2]])
    reduction.spot_of_match = np.array([0, 0, -1])
    plot_reduction(tmp_path / "new", "g", plane, reduction, goal_mm)
    title = written[4].axes[1].get_title()
    assert title == "fibres: measured minus target, 1.00 µm rms of 1; 1 farther than 0.5 mm left out"
    # no target at all: an empty picture, without a warning
    plot_reduction(tmp_path / "new", "n", plane, reduction, np.full((3, 2), np.nan))
    written[7].canvas.draw()
    assert written[7].axes[1].get_title() == "fibres: measured minus target, none seen"
