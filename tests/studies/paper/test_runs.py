"""What a figure makes of its measurement: numbers, and pictures with axes, limits and one mark a datum.

The measurements are made up, so that every number is known beforehand.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from fiberloom.calibration.bench.estimate import Fitted, Residuals, estimate
from fiberloom.calibration.bench.torque import TorqueScale, Windows
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.instruments.model import OwnRequirement
from fiberloom.studies.paper import Settings
from fiberloom.studies.paper.control import fig16_tracking as fig16
from fiberloom.studies.paper.control import fig17_repeatability as fig17
from fiberloom.studies.paper.focal_plane import fig18_camera as fig18
from fiberloom.studies.paper.focal_plane import fig20_focal_plane as fig20
from fiberloom.studies.paper.focal_plane import table01_instruments as table01
from fiberloom.studies.paper.focal_plane import table01_kept
from fiberloom.studies.paper.identification import fig10_transmission as fig10
from fiberloom.studies.paper.identification import fig12_drag as fig12
from fiberloom.studies.paper.identification import fig13_stiffness as fig13
from fiberloom.studies.paper.identification import fig14_inertia as fig14
from fiberloom.studies.paper.identification import identified
from fiberloom.units import GEAR

PNG = b"\x89PNG"


@pytest.fixture
def settings():
    said = []
    made = Settings(seed=5, n_seeds=2, say=said.append)
    return SimpleNamespace(given=made, said=said)


def made(figure, settings):
    """The outcome with its quantities by id; every picture is one."""
    outcome = figure.run(settings.given)
    assert all(d.png.startswith(PNG) for d in outcome.drawings)
    by_id = {q.id: q for q in outcome.quantities}
    assert len(by_id) == len(outcome.quantities)
    assert outcome.how
    return outcome, by_id


def column(value, residual_unit="1"):
    n = fig13.UNITS
    fitted = Fitted(np.full(n, value), np.full(n, 0.1))
    return estimate("q", "u", fitted, Residuals(np.zeros((n, 2)), residual_unit), [""] * n)


def test_figure_10_gives_back_the_backlash_of_the_gear(monkeypatch, settings, written):
    theta = np.broadcast_to(np.linspace(0.0, 360.0, 721), (2, 2, 2, 721)).copy()
    ripple = 0.01 * np.sin(np.deg2rad(36.0 * theta))
    gap = np.array([0.0, 100.0 / GEAR])[None, None, :, None]
    maps = TransmissionMaps(np.arange(2), theta + ripple + gap, theta)
    monkeypatch.setattr(fig10, "calibrated", lambda *a: SimpleNamespace(maps=maps))
    gap, backlash, off = (np.array(pair) for pair in ([60.0, 200.0], [70.0, 180.0], [11.0, 2.0]))
    curves = fig10.GearCurves(gap, backlash, off, np.array([36.0, 36.0]), np.array([3.0, 4.0]))
    monkeypatch.setattr(fig10, "measure", lambda seed, points: curves)
    _, found = made(fig10, settings)
    assert settings.said == ["Figure 10: seed 5", "Figure 10: seed 6"]
    assert found["fig10.backlash.min_motor_deg"].ours == 60.0
    assert found["fig10.backlash.max_motor_deg"].ours == 200.0
    assert found["fig10.peaks_per_turn"].ours == found["fig10.peaks_per_turn"].paper == 36.0
    assert found["fig10.backlash.corrected.max_motor_deg"].ours == 180.0
    assert found["fig10.backlash.corrected.max_motor_deg"].misses  # 28 % off: it does not come back
    assert found["fig10.backlash.gap_200.off_motor_deg"].ours == 11.0
    assert found["fig10.backlash.eq7_800.off_motor_deg"].ours == 2.0
    assert sum(q.beyond for q in found.values()) == 8
    panels = written[0].axes
    assert [p.get_title() for p in panels[:2]] == ["alpha", "beta"]
    for panel in panels[2:]:
        backlash, *limits = panel.lines
        np.testing.assert_allclose(backlash.get_ydata(), 100.0, atol=1e-6)
        assert sorted(line.get_ydata()[0] for line in limits) == sorted(fig10.PAPER_BACKLASH_DEG)
        assert panel.get_ylabel() == "backlash [motor deg]"


def linear_runs(units=fig12.UNITS):
    """Torque of 20 uNm, 0.1 uNm/rpm and a spring of -0.01 uNm/deg, both ways."""
    segments = []
    for rpm in (500.0, -500.0, 2000.0, -2000.0):
        output = np.linspace(5.0, 355.0, 60)
        torque = np.sign(rpm) * 20.0 + 0.01 * rpm - 0.01 * (output - 180.0)
        tile = np.tile(output * GEAR, (units, 1))
        speed = np.full((units, 60), rpm * np.pi / 30.0)
        segments.append(Windows(np.tile(torque / 100.0, (units, 1)), tile, np.stack([tile, tile], -1), speed))
    return segments


def test_figure_12_lines_explain_what_lies_on_lines(monkeypatch, settings, written):
    runs = linear_runs()
    silent = Windows(np.full((fig12.UNITS, 3), np.nan), *(runs[0][:3].motor_deg, runs[0][:3].rotor_deg),
                     runs[0][:3].speed_rad_s)  # fmt: skip
    data = SimpleNamespace(segments=[*runs, runs[0], silent], creep=[False] * 4 + [True, False])
    friction = SimpleNamespace(drag=column(0.8), spring=column(-4.0), spring_rate=column(1.0 / 180.0))
    found = SimpleNamespace(friction_data=[data], friction=[friction], scale=[TorqueScale(100.0, 0.01)])
    monkeypatch.setattr(identified, "identified", lambda seed: found)
    _, by_id = made(fig12, settings)
    assert by_id["fig12.linear_in_angle"].ours == pytest.approx(1.0)
    assert by_id["fig12.linear_in_speed"].ours == pytest.approx(1.0)
    assert by_id["fig12.drag_uNms"].ours == pytest.approx(0.8)
    # -4 at 0 deg, -2 at 360 deg
    assert by_id["fig12.spring_0_over_360"].ours == pytest.approx(2.0)
    left, right = written[0].axes
    assert [line.get_label() for line in left.lines] == ["+500 rpm", "-500 rpm", "+2000 rpm", "-2000 rpm"]
    dots, *fitted = right.lines
    np.testing.assert_allclose(dots.get_ydata(), [25.0, -25.0, 40.0, -40.0], atol=1e-6)
    # both lines begin at the Coulomb friction
    assert sorted(line.get_ydata()[0] for line in fitted) == pytest.approx([-20.0, 20.0])
    assert (left.get_ylabel(), right.get_xlabel()) == ("torque [µNm]", "motor speed [rpm]")


def test_figure_13_compares_every_unit_with_its_true_stiffness(monkeypatch, settings, written):
    true_mNm_deg = np.array([300.0, 20.0])
    plant = np.zeros(fig13.UNITS, dtype=[("stiffness", float, (2,))])
    plant["stiffness"] = true_mNm_deg * 1e-3 * 180.0 / np.pi
    units = SimpleNamespace(plant={"stiffness": plant["stiffness"]})
    found = SimpleNamespace(bench=SimpleNamespace(units=units), stiffness=[column(303.0), column(19.8)])
    monkeypatch.setattr(identified, "identified", lambda seed: found)
    _, by_id = made(fig13, settings)
    assert by_id["fig13.alpha.stiffness"].ours == pytest.approx(303.0)
    assert by_id["fig13.alpha.stiffness"].paper == 337.0
    assert by_id["fig13.alpha.error_percent"].ours == pytest.approx(1.0)
    assert by_id["fig13.beta.error_percent"].ours == pytest.approx(1.0)
    for panel, name, paper in zip(written[0].axes, ("alpha", "beta"), (337.0, 25.0), strict=True):
        assert panel.get_title() == name
        # units of both seeds
        assert len(panel.lines[0].get_xdata()) == 2 * fig13.UNITS
        assert panel.lines[-1].get_ydata()[0] == paper
        assert panel.get_xlabel() == "true stiffness [mNm/deg]"


def test_figure_14_takes_the_rise_from_the_speeds(monkeypatch, settings, written):
    period_s, m, n = 5e-4, 120, fig14.UNITS
    time_s = period_s * (np.arange(m) - 40)
    tau_s = 0.004
    rpm = np.where(time_s > 0, 5600.0 - 5000.0 * np.exp(-np.maximum(time_s, 0) / tau_s), 600.0)
    motor = np.cumsum(rpm * 6.0 * period_s)
    voltage = np.where(time_s >= 0, 0.97, 0.14)
    data = SimpleNamespace(
        motor_deg=np.tile(motor, (n, 1, 1)), voltage=np.tile(voltage, (n, 1, 1)), period_s=period_s
    )
    true = 3.5e-9
    inertia = SimpleNamespace(inertia=column(1.02 * true), speeds_rpm=np.tile([600.0, 5600.0], (n, 1)))
    plant = np.zeros((n, 2), dtype=[("inertia_motor", float), ("inertia_gear", float)])
    plant["inertia_motor"] = 0.6 * true
    plant["inertia_gear"] = 0.4 * true
    bench = SimpleNamespace(units=SimpleNamespace(plant=plant))
    found = SimpleNamespace(inertia_data=[data], inertia=[inertia], bench=bench)
    monkeypatch.setattr(identified, "identified", lambda seed: found)
    _, by_id = made(fig14, settings)
    assert by_id["fig14.inertia"].ours == pytest.approx(1e7 * 1.02 * true)
    assert by_id["fig14.error_percent"].ours == pytest.approx(2.0)
    assert (by_id["fig14.low_rpm"].ours, by_id["fig14.high_rpm"].ours) == (600.0, 5600.0)
    # an exponential has 97 % of its change after 3.5 time constants
    assert by_id["fig14.rise_ms"].ours == pytest.approx(1e3 * tau_s * -np.log(0.03), rel=0.05)
    (axes,) = written[0].axes
    assert len(axes.lines) == n + len(fig14.PAPER_RPM)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time from the step [ms]", "motor speed [rpm]")


def test_figure_16_compares_every_controller_with_the_full_law(monkeypatch, settings, written):
    level = {name: float(k + 1) for k, name in enumerate(fig16.CONTROLLERS)}

    asked = []

    def track(seed, name, *, fitted=False, gears="stages"):
        asked.append((fitted, gears))
        # open loop is the worst with the second spectrum alone, nothing is worse without break-away there
        size = level[name]
        if gears == "teeth":
            size = {fig16.OPEN_LOOP: 50.0, "no break-away term": 0.5}.get(name, size)
        wave = np.sin(np.linspace(0, 20 * np.pi, 2001))
        return fig16.Tracking(np.linspace(0, 1, 2001), size * np.stack([wave, wave, 2 * wave]), 3)

    monkeypatch.setattr(fig16, "track", track)
    _, by_id = made(fig16, settings)
    assert len(settings.said) == 2 * len(fig16.CONTROLLERS) + 2
    assert {(False, "stages"), (False, "teeth"), (True, "stages")} == set(asked)
    full = level[fig16.FULL]
    assert by_id["fig16.closed.max_deg"].ours == pytest.approx(full, rel=1e-4)
    assert by_id["fig16.closed.worst_unit_deg"].ours == pytest.approx(2.0 * full, rel=1e-4)
    assert by_id["fig16.open.max_deg"].ours == pytest.approx(level[fig16.OPEN_LOOP], rel=1e-4)
    penalties = {i: q.ours for i, q in by_id.items() if i.endswith(".penalty")}
    assert penalties == pytest.approx(
        {f"fig16.no_{k}.penalty": level[f"no {w} term"] / full for k, w in
         (("speed", "speed"), ("break_away", "break-away"), ("inertia", "inertia"))}
    )  # fmt: skip
    # of five waves of 1 to 5 the open loop's is the largest
    orders = {i.rpartition(".")[2]: q for i, q in by_id.items() if i.startswith("fig16.order.")}
    assert {name: q.ours for name, q in orders.items()} == {
        "open_loop_worst": 1.0, "no_speed_worse": 1.0, "no_break_away_worse": 0.5, "no_inertia_worse": 1.0,
    }  # fmt: skip
    assert orders["no_break_away_worse"].note.startswith("gears 'stages': true; gears 'teeth': false. ")
    assert all(q.kind == "tuned" for i, q in by_id.items() if i.startswith("fig16.fitted."))
    assert by_id["fig16.fitted.open_loop.max_deg"].paper == fig16.PAPER_OPEN_DEG
    assert "FITTED" in by_id["fig16.fitted.open_loop.max_deg"].note
    assert by_id["fig16.fitted.order.open_loop_worst"].ours == 1.0
    assert "6 false collisions" in by_id["fig16.shipped.max_deg"].note
    top, bottom = written[0].axes
    labels = [line.get_label() for line in bottom.lines if not line.get_label().startswith("_")]
    assert labels == list(fig16.CONTROLLERS)
    assert (top.get_ylabel(), bottom.get_ylabel()) == ("command [motor turns]", "command - motor [deg]")
    assert top.lines[0].get_ydata()[0] == 0.0


def test_figure_17_tells_repeatability_in_nm_of_each_axis(monkeypatch, settings, written):
    benches = []

    def make_bench(seed, units, *, noise_um, change=None, start_deg):
        benches.append((seed, noise_um))
        plant = {"seat_rms": np.ones(units)}
        if change is not None:
            change(SimpleNamespace(plant=plant))
            assert not plant["seat_rms"]
        return noise_um

    def visit(noise_um, axis, visits):
        # plus and minus: the sample rms is known
        sign = np.where(np.arange(visits) % 2 == 0, 1.0, -1.0)[:, None, None, None]
        at = np.arange(3.0)[None, :, None, None] * np.array([1.0, 0.0])
        size = (0.1 + axis * 0.05) if noise_um else 0.01
        return fig17.Visits(axis, at + sign * np.array([size, 0.0]) + np.zeros((visits, 3, fig17.UNITS, 2)))

    monkeypatch.setattr(fig17, "make_bench", make_bench)
    monkeypatch.setattr(fig17, "visit", visit)
    _, by_id = made(fig17, settings)
    n = fig17.VISITS
    for axis, name in enumerate(("alpha", "beta")):
        rms = 1e3 * (0.1 + 0.05 * axis) * np.sqrt(n / (n - 1))
        assert by_id[f"fig17.{name}.rms_nm"].ours == pytest.approx(rms, rel=0.01)
        assert by_id[f"fig17.{name}.apart_um"].ours == pytest.approx(1.0)
        assert by_id[f"fig17.{name}.control_nm"].ours < 20.0
        assert written[0].axes[axis].get_title().startswith(f"{name}: {rms:.0f} nm rms")
        assert len(written[0].axes[axis].lines) == 3
    # a micrometre over 7.6 mm, through the gear
    step = np.rad2deg(1e-3 / fig17.LEVER_MM[0]) * GEAR
    assert by_id["fig17.alpha.step_motor_deg"].ours == pytest.approx(step)
    assert [noise == 0.0 for _, noise in benches] == [False, True] * 4


@pytest.mark.parametrize("full", [False, True])
def test_figure_18_counts_images_and_averages_four(monkeypatch, written, full):
    asked = []

    def static(camera, images, seed):
        asked.append(images)
        size = 0.5 if getattr(camera, "average", 1) == 4 else 1.0
        return np.tile([[size, 0.0], [-size, 0.0]], (images // 2, 1)), 0.9

    monkeypatch.setattr(fig18, "static_fibre_um", static)
    _, by_id = made(fig18, SimpleNamespace(given=Settings(seed=1, n_seeds=2, full=full)))
    assert set(asked) == {fig18.MANY_IMAGES if full else fig18.IMAGES}
    assert by_id["fig18.workspace.rms_nm"].ours == pytest.approx(1000.0)
    assert by_id["fig18.close_up.stated_over_seen"].ours == pytest.approx(0.9)
    assert by_id["fig18.four_images_over_one"].ours == pytest.approx(0.5)
    for panel, name in zip(written[0].axes, fig18.PAPER_NM, strict=True):
        assert panel.get_title() == f"{name}: 1000 nm rms (paper: {fig18.PAPER_NM[name]:.0f})"
        assert panel.get_xlabel() == "x [nm]"


@pytest.mark.parametrize("full", [False, True])
def test_figure_20_tells_after_how_many_configurations(monkeypatch, written, full):
    sizes = []

    def curve(steps, scale):
        errors = scale / np.sqrt(np.array(steps, float))
        return fig20.Convergence(tuple(steps), errors, 0.5 * errors)

    def designed(seed, n_field):
        sizes.append(n_field)
        return curve(fig20.FIELD_STEPS, 4.0)

    monkeypatch.setattr(fig20, "as_printed", lambda seed: curve(fig20.STEPS, 9.0))
    monkeypatch.setattr(fig20, "designed", designed)
    _, by_id = made(fig20, SimpleNamespace(given=Settings(seed=1, n_seeds=2, full=full)))
    assert set(sizes) == {fig20.MANY_UNITS if full else fig20.FIELD_UNITS}
    # 9 um over the root of 81 is one
    assert by_id["fig20.configurations"].ours == pytest.approx(81.0, rel=1e-3)
    assert by_id["fig20.designed.configurations"].ours == pytest.approx(16.0, rel=1e-3)
    assert by_id["fig20.at_80.centre_um"].ours == pytest.approx(9.0 / np.sqrt(80.0))
    assert by_id["fig20.at_80.arms_um"].ours == pytest.approx(4.5 / np.sqrt(80.0))
    (axes,) = written[0].axes
    labels = [line.get_label() for line in axes.lines if not line.get_label().startswith("_")]
    assert labels == [
        "Eq. 26: centre",
        "Eq. 26: arm lengths",
        "survey: centre",
        "survey: arm lengths",
        "paper",
    ]
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")


def test_a_row_of_table_1_that_fails_leaves_the_others(tmp_path, written):
    calls = []

    class Kept:
        def __init__(self, folder, fresh):
            assert (folder, fresh) == (tmp_path, True)

        def made(self, row, seed, n_units):
            calls.append(row.key)
            if row.key == "moons":
                return "MemoryError: no room"
            return table01.InstrumentRun([np.full(2, 0.999)], 2, 57, 0, 0, 9.0, 7.0, 0.5, [9.0])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(table01, "RowRuns", Kept)
        given = Settings(seed=1, n_seeds=1, folder=tmp_path, fresh=True)
        outcome, by_id = made(table01, SimpleNamespace(given=given))
    assert calls == [row.key for row in table01.TABLE_1]
    missing = by_id["table1.moons.max_um"]
    assert (missing.ours, missing.misses) == (None, True)
    assert "no room" in missing.note
    assert not by_id["table1.desi.max_um"].misses
    lines = outcome.table.splitlines()
    assert [line.split(" | ")[7] for line in lines[2:8]] == 4 * ["met"] + ["not made", "met"]
    assert lines[8] == "MOONS was not made: MemoryError: no room"


def test_a_row_tells_how_many_seeds_have_met(tmp_path, written):
    """DESI by the second of three, MOONS by all; a field of LAMOST that was not made has not met."""

    class Kept:
        def __init__(self, folder, fresh):
            pass

        def made(self, row, seed, n_units):
            if (row.key, seed) == ("lamost", 3):
                return "MemoryError: no room"
            far_um = 9.0 if row.key == "desi" and seed != 2 else 1.0
            return table01.InstrumentRun([np.array([far_um])], 1, 57, 0, 0, 9.0, 7.0, 0.5, [9.0])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(table01, "RowRuns", Kept)
        given = Settings(seed=1, n_seeds=3, full=True, folder=tmp_path)
        outcome, by_id = made(table01, SimpleNamespace(given=given))
    lines = [line.strip("| ").split(" | ") for line in outcome.table.splitlines()]
    verdicts = {line[0]: line[7] for line in lines if len(line) > 7}
    assert verdicts["DESI"] == "MISSED, 1 of 3 seeds"
    assert verdicts["MOONS"] == "met, 3 of 3 seeds"
    assert verdicts["LAMOST"] == "MISSED, 2 of 3 seeds"
    assert by_id["table1.desi.max_um"].note.startswith("met by 1 of 3 seeds; ")


@pytest.mark.parametrize(
    ("ended_s", "statistic", "expected"),
    [([50.0, 100.0], "share", 0.75), ([50.0, 130.0], "share", 0.5), ([130.0, 200.0], "share", None),
     ([50.0, 130.0], "max", 9.0)],
)  # fmt: skip
def test_the_makers_own_requirement_is_held_against_what_was_there_in_time(ended_s, statistic, expected):
    errors = [np.array([1.0, 4.0, 9.0]), np.array([1.0, 2.0, 3.0])]
    run = table01.InstrumentRun(errors, 4, 57, 0, 0, ended_s[-1], 7.0, 0.5, ended_s)
    asked = OwnRequirement(statistic=statistic, within_um=5.0, share=0.9, within_s=120.0, source="a test")
    found = run.own(asked)
    assert np.isnan(found) if expected is None else found == expected


def test_a_row_tells_which_units_were_left_out_before_the_field(monkeypatch, written):
    """Two of one row are; the others' rows say nothing of it. The verdict is that of those with a target."""

    def made_up(row, seed, n_units):
        out = {"152": "phi: slow", "9": "theta: wild"} if row.key == "cobra" else {}
        return table01.InstrumentRun([np.array([1.0, 900.0])], 2, 57, 0, 0, 9.0, 7.0, 0.5, [9.0], None, out)

    monkeypatch.setattr(table01, "observe", made_up)
    _, by_id = made(table01, SimpleNamespace(given=Settings(seed=1, n_seeds=1)))
    note = by_id["table1.cobra.within"].note
    assert "by their calibration: 2 units, 9 (theta: wild); 152 (phi: slow)" in note
    assert "left out" not in by_id["table1.desi.within"].note
    assert by_id["table1.cobra.max_um"].misses


def test_units_of_several_fields_that_have_the_same_number_are_each_told():
    runs = [
        table01.InstrumentRun([np.array([1.0])], 2, 57, 0, 0, 9.0, 7.0, 0.5, [9.0], None, out)
        for out in ({"9": "theta: wild"}, {}, {"12": "phi: slow", "9": "phi: slow"})
    ]
    told = table01._left_out(runs).partition(": ")[2]
    assert told == ("1 units, 9 (theta: wild), and in another field 2 units, 9 (phi: slow); 12 (phi: slow)")


def test_rows_of_table_1_are_made_in_processes_of_their_own_and_kept(tmp_path, monkeypatch):
    row = next(row for row in table01.TABLE_1 if row.key == "megara")
    rows = table01_kept.RowRuns(tmp_path)
    first = rows.made(row, 0, 7)
    assert first.positioners == 7
    monkeypatch.setattr(table01_kept, "_in_a_process", lambda *_: "made again")
    again = rows.made(row, 0, 7)
    assert again.error_um[-1].tolist() == first.error_um[-1].tolist()
    assert (again.cpu_s, again.ended_s, again.further_um) == (first.cpu_s, first.ended_s, None)
    assert table01_kept.RowRuns(tmp_path, fresh=True).made(row, 0, 7) == "made again"
    assert rows.made(row, 1, 7) == "made again"
    (file,) = tmp_path.iterdir()
    file.write_text(file.read_text()[:-9])  # cut short
    assert rows.made(row, 0, 7) == "made again"


def test_a_row_of_table_1_that_cannot_be_made_says_why(tmp_path):
    row = next(row for row in table01.TABLE_1 if row.key == "megara")
    assert "InputError" in table01_kept.RowRuns(tmp_path).made(row, 0, 10**6)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("full", [False, True])
def test_table_1_holds_every_instrument_against_its_own_requirement(monkeypatch, written, full):
    sizes = []
    one_move = ("megara", "moons")

    def observe(row, seed, n_units):
        sizes.append(n_units)
        blind = np.array([2.0, 4.0]) * row.requirement_um
        last = np.array([0.5, 1.5]) * row.requirement_um
        moves = [blind] if row.key in one_move else [blind, last]
        further = None if row.key in one_move else last / 3.0
        ended_s = [90.0, 100.0][-len(moves) :]
        return table01.InstrumentRun(moves, 2, 57, 1, 3, 100.0, 7.0, 0.5, ended_s, further)

    monkeypatch.setattr(table01, "observe", observe)
    _, by_id = made(table01, SimpleNamespace(given=Settings(seed=1, n_seeds=2, full=full)))
    runs = 2
    assert sizes == 6 * runs * [None if full else table01.UNITS]
    assert by_id["table1.order.strictest_is_sdssv"].ours == 1.0
    for row in table01.TABLE_1:
        corrected = row.key not in one_move
        worst = by_id[f"table1.{row.key}.max_um"]
        assert worst.ours == pytest.approx((1.5 if corrected else 4.0) * row.requirement_um)
        assert worst.misses
        assert worst.note.startswith("met by 0 of 2 seeds; ")
        assert f"{runs} collisions in verified plans, {3 * runs} contacts in truth" in worst.note
        assert f"published: {row.published}" in worst.note
        within = by_id[f"table1.{row.key}.within"]
        assert (within.ours, within.paper) == (0.5 if corrected else 0.0, None)
        on_target = by_id[f"table1.{row.key}.on_target"]
        assert (on_target.ours, on_target.paper) == (within.ours, row.operation.required_share)
        assert on_target.misses
        own = by_id.get(f"table1.{row.key}.own")
        assert (own is None) == (row.key == "megara")
        if own is not None and row.operation.own.statistic == "rms":
            last = np.array([0.5, 1.5] if corrected else [2.0, 4.0]) * row.requirement_um
            assert own.ours == pytest.approx(np.sqrt(np.mean(last**2)))
        blind = by_id[f"table1.{row.key}.blind_rms_um"].ours
        assert blind == pytest.approx(np.sqrt(10.0) * row.requirement_um)
        assert by_id[f"table1.{row.key}.moves"].ours == (2.0 if corrected else 1.0)
        assert by_id[f"table1.{row.key}.reconfiguration_s"].ours == 100.0
        assert by_id[f"table1.{row.key}.memory_gib"].ours == 0.5
        contacts = by_id[f"table1.{row.key}.contacts"]
        assert (contacts.ours, contacts.misses, contacts.beyond) == (3.0, True, True)
        further = by_id.get(f"table1.{row.key}.further_within")
        assert further is None if row.key in one_move else further.ours == 1.0
        by_moves = "after each move 0.0, 50.0 %" if corrected else ""
        assert within.note == "; ".join(filter(None, [by_moves, row.why]))
    cells = written[0].axes[0].tables[0]
    assert [cells[k + 1, 0].get_text().get_text() for k in range(6)] == [row.name for row in table01.TABLE_1]
    assert cells[1, table01.COLUMNS.index("within")].get_text().get_text() == "50 %"
    assert cells[1, table01.COLUMNS.index("contacts")].get_text().get_text() == f"{3 * runs}"
    verdicts = {
        cells[k + 1, column].get_text().get_text() for k in range(6) for column in table01.VERDICTS[:1]
    }
    assert verdicts == {"MISSED, 0 of 2 seeds"}
    (axes,) = written[1].axes
    assert [t.get_text() for t in axes.get_xticklabels()] == [row.name for row in table01.TABLE_1]
    # dots after the blind move, after the corrections where there are any, and the requirement
    assert len(axes.lines) == sum(2 if row.key in one_move else 3 for row in table01.TABLE_1)
    assert axes.get_ylabel() == "true error of a fibre [µm]"
