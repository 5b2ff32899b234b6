"""Figures of merit, sweeps and their front; power of an array against an independent table."""

import json
import math
from dataclasses import replace

import pytest

from fiberloom.design.merits import MeritSettings, merits, pareto, varied
from fiberloom.design.power import PowerSettings, array_power, care_lines, limited, motor, move_power
from fiberloom.design.sweep import ranges_of, sweep
from fiberloom.errors import InputError
from fiberloom.instruments import load_instrument
from fiberloom.planning.supply import PAUSE_S

SDSSV = load_instrument("sdssv")
QUICK = MeritSettings(fields=2, rings=3)


def test_three_seconds_at_2000_rpm():
    """Closed loop, the paper's motor without a spring: copper 0.037 J, electric 0.084 J, 2.6 mA of 12 V."""
    alpha = SDSSV.alpha.model_copy(update={"speed_deg_s": 2000 * 6 / 1024})
    speed, rise = alpha.speed_deg_s, alpha.acceleration_deg_s2
    own = SDSSV.model_copy(update={"alpha": alpha})
    plant = motor(own, 0)
    plant["spring_rate"] = 0.0
    found = move_power(own, 0, plant, speed * (3.0 - speed / rise))
    assert found.time_s == pytest.approx(3.0, abs=1e-9)
    assert found.torque_uNm == pytest.approx(83.0, rel=0.02)  # medians of 61 units
    assert found.copper_J == pytest.approx(0.037, rel=0.04)
    assert found.supply_J == pytest.approx(0.084, rel=0.04)
    assert 1e3 * found.mean_A == pytest.approx(2.6, rel=0.12)  # of all 3 s; the table's is of the plateau


def test_a_limit_is_kept_slower_or_in_waves():
    full = array_power(SDSSV)
    within = limited(SDSSV, 0.5 * full.peak_W)
    assert array_power(SDSSV, PowerSettings(share=within.speed_share)).peak_W == pytest.approx(
        0.5 * full.peak_W, rel=1e-3
    )
    assert within.waves == 2
    assert full.time_s < within.time_s <= within.waves_s
    assert limited(SDSSV, 2.0 * full.peak_W).time_s == pytest.approx(full.time_s)
    with pytest.raises(InputError, match=r"one positioner takes 0\.038\d W"):
        limited(SDSSV, 0.01)


def test_a_limit_is_of_the_ways_that_are_asked_for_and_of_the_motors_alone():
    some = PowerSettings(100, (120.0, 60.0), rest_W=1.0)
    motors = array_power(SDSSV, replace(some, rest_W=0.0))
    assert limited(SDSSV, 1.01 * motors.peak_W, some).time_s == pytest.approx(motors.time_s)
    half = limited(SDSSV, 0.5 * motors.peak_W, some)
    assert half.waves_s == pytest.approx(2 * motors.time_s + PAUSE_S)
    slower = array_power(SDSSV, replace(some, rest_W=0.0, share=half.speed_share))
    assert slower.peak_W == pytest.approx(0.5 * motors.peak_W, rel=1e-3)
    assert slower.time_s == pytest.approx(half.slower_s)


def test_lines_of_care_are_read_by_the_instrument():
    import tomllib

    care = tomllib.loads("\n".join(care_lines(SDSSV, 10.0)))["care"]
    data = SDSSV.model_dump(exclude_none=True)
    data["care"] |= care
    kept = type(SDSSV).model_validate(data).care
    assert kept.supply_A == pytest.approx(10.0 / 12.0, rel=0.01)
    assert sum(kept.motor_most_A) * 500 == pytest.approx(array_power(SDSSV).peak_A, rel=1e-3)


def test_heat_goes_with_positioners_and_ways():
    one, all_ = array_power(SDSSV, PowerSettings(1)), array_power(SDSSV)
    assert all_.move_J == pytest.approx(500 * one.move_J)
    assert array_power(SDSSV, PowerSettings(1, (180.0, 90.0))).move_J == pytest.approx(
        0.5 * one.move_J, rel=0.02
    )
    assert one.warmer_K == pytest.approx(one.move_J / 900.0 * 30.0)
    with pytest.raises(InputError, match="stepper of gear 2050"):
        array_power(load_instrument("moons"))


def test_lengths_are_varied_with_what_hangs_on_them():
    longer = varied(SDSSV, {"arms.beta": 2.0 * 14.965, "arms.alpha": 8.0, "gear": 512.0, "pitch": 30.0})
    assert longer.positioner.points["BOSS"].x_mm == pytest.approx(2.0 * 14.965)
    assert longer.positioner.points["metrology"].x_mm == pytest.approx(2.0 * 14.314)
    assert longer.bodies.beta_segment_mm[1] == pytest.approx(2.0 * 14.7276)
    assert longer.scatter.l_alpha_mm.mean == 8.0
    assert (longer.beta.gear, longer.layout.pitch_mm) == (512.0, 30.0)
    with pytest.raises(InputError, match=r"--vary arms\.gamma: no such number"):
        varied(SDSSV, {"arms.gamma": 1.0})
    with pytest.raises(InputError, match="l_alpha_mm"):
        varied(SDSSV, {"arms.alpha": -1.0})


def test_figures_of_a_design_are_those_of_its_tools():
    found = merits(SDSSV, QUICK)
    assert found["reach_mm"] == pytest.approx(7.4 + math.hypot(14.965, 0.376))
    assert found["neighbours"] == 18
    assert found["range_s"] == pytest.approx(30.26, abs=0.01)
    assert found["move_s"] < found["range_s"]
    assert 8.0 < found["blind_um"] < 11.0
    assert merits(load_instrument("moons"), QUICK)["blind_um"] is None


def test_the_front_is_what_nothing_beats():
    rows = [
        {"fibres_used": 0.9, "move_s": 20.0},
        {"fibres_used": 0.8, "move_s": 10.0},
        {"fibres_used": 0.8, "move_s": 12.0},  # beaten by the second
        {"fibres_used": 0.95, "move_s": None},
        {"fibres_used": 0.9, "move_s": 20.0},  # as good as the first
    ]
    assert pareto(rows, ["fibres_used", "move_s"]) == [True, True, False, False, True]
    with pytest.raises(InputError, match="--objectives reach_mm"):
        pareto(rows, ["reach_mm"])


def test_ranges_of_a_sweep():
    assert ranges_of("arms.alpha=5:6:0.5,pitch=20;22.4") == {
        "arms.alpha": [5.0, 5.5, 6.0],
        "pitch": [20.0, 22.4],
    }
    for text in ("arms.alpha", "arms.alpha=5:4:1", "pitch=wide", "pitch="):
        with pytest.raises(InputError, match="--vary"):
            ranges_of(text)
    with pytest.raises(InputError, match="2000 at most"):
        sweep(SDSSV, {"pitch": list(range(1, 2002))}, QUICK)


def test_a_sweep_refuses_single_designs_and_draws_its_front(fl, tmp_path):
    words = ("--vary", "arms.alpha=-1;2.5", "--fields", 2, "--out", tmp_path / "front.png")
    code, said, _ = fl("design", "sweep", "pfs", *words, "--json")
    rows = json.loads(said)
    assert code == 0
    assert (tmp_path / "front.png").exists()
    assert [bool(row["refused"]) for row in rows] == [True, False]
    assert any(row["front"] for row in rows[1:])


def test_workers_find_the_same(monkeypatch):
    """Threads in place of processes, which take seconds to start."""
    monkeypatch.setattr("fiberloom.design.sweep.SCHEDULER", "threads")
    ranges = {"pitch": [21.0, 22.4]}
    megara = load_instrument("megara")
    assert sweep(megara, ranges, QUICK, workers=2) == sweep(megara, ranges, QUICK)


def test_compare_and_power_print(fl):
    code, said, _ = fl("design", "compare", "megara", "pfs", "--fields", 2)
    assert code == 0
    assert "not known" in said
    code, said, _ = fl("design", "power", "sdssv", "--limit", 10)
    assert code == 1
    assert "supply_A = 0.83" in said
    assert fl("design", "power", "sdssv", "--ways", "ten")[0] == 2
