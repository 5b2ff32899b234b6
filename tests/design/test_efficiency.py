"""Shares of fibres and targets, against an independent count on a torus and against limits."""

import math

import numpy as np
import pytest

from fiberloom.design.efficiency import (
    EfficiencySettings,
    efficiency,
    endless,
    inner_part,
    of_list,
    whole_array,
)
from fiberloom.errors import InputError
from fiberloom.instruments import Instrument, generate, load_instrument
from fiberloom.targets.generate import random_targets


def part_of(name, rings=5, **lengths):
    instrument = load_instrument(name)
    if lengths:
        data = instrument.model_dump(exclude_none=True)
        data["layout"] |= lengths
        instrument = Instrument.model_validate(data)
    fibre = instrument.science_fibres[0]
    return inner_part(endless(instrument, rings), fibre), fibre


TORUS = {
    # rule: share of fibres used at densities 1 and 4, 10 fields of 144 units on a torus
    "pfs": {"free": (0.610, 0.979), "tips": (0.601, 0.979), "arms": (0.596, 0.978)},
    "sdssv": {"free": (0.323, 0.979), "tips": (0.316, 0.979), "arms": (0.315, 0.962)},
}


@pytest.mark.parametrize("name", TORUS)
def test_shares_are_those_of_an_independent_count(name):
    where, fibre = part_of(name)
    found = efficiency(where, fibre, [1.0, 4.0], EfficiencySettings(("free", "tips", "arms"), fields=6))
    for rule, shares in TORUS[name].items():
        for one, share in zip([f for f in found if f.rule == rule], shares, strict=True):
            # its own error is 0.01 to 0.02 at density 1, 0.004 at 4; ours where no unit was left is 0
            error = math.hypot(one.used_error, 0.015 if one.density == 1.0 else 0.006)
            assert abs(one.used - share) < 3.5 * error, one


def test_more_rules_leave_fewer_targets_in_the_same_fields():
    """Tips kept one pitch apart cannot be more than a lattice has cells, and arms do not add targets."""
    where, fibre = part_of("moons", rings=4)
    found = efficiency(where, fibre, [2.5], EfficiencySettings(fields=3, seed=1, exclusion_mm=25.0))
    observed = {one.rule: one.observed for one in found}
    assert observed["free"] >= observed["arms"] >= observed["assigned"] - 0.02
    assert observed["tips"] < observed["free"] - 0.1


def test_most_targets_against_any_gain_what_is_published():
    """BigBOSS, whose patrol discs just cover the plane as DESI's do: "as much as 2 %" for the first tiles
    (Morales et al. 2012, arXiv:1103.0988, abstract). Arms that overlap several neighbours gain more."""
    gain, units = {}, 0
    for name, rings in (("desi", 8), ("moons", 6)):
        where, fibre = part_of(name, rings)
        units = int(where.counted.sum())
        per_fibre = {"desi": 1.207, "moons": 3.157}[name]
        found = efficiency(
            where,
            fibre,
            [0.8 * per_fibre, 1.3 * per_fibre],
            EfficiencySettings(("random", "free"), fields=10),
        )
        used = np.array([one.used for one in found]).reshape(2, 2)
        gain[name] = used[:, 1] / used[:, 0] - 1.0
        assert units > 18
    # the same fields for both rules: a gain of 2 % is known to 1 % or so
    assert (gain["desi"] > 0.0).all()
    assert gain["desi"].max() < 0.035
    assert gain["moons"].max() > 2.0 * gain["desi"].mean()


def test_units_that_share_nothing_are_poisson():
    """A pitch of more than two reaches: a unit has a target with 1 - exp(-density)."""
    where, fibre = part_of("pfs", rings=8, pitch_mm=10.0)
    (one,) = efficiency(where, fibre, [1.3], EfficiencySettings(("free",), fields=12))
    assert where.counted.sum() > 100
    assert one.used == pytest.approx(1.0 - math.exp(-1.3), abs=4.0 * max(one.used_error, 0.005))


def test_clusters_and_broken_units_leave_targets_and_exposures_catch_up():
    where, fibre = part_of("pfs")
    shares = {}
    for name, asked in {
        "plain": {},
        "clustered": {"clustered": True},
        "broken": {"broken": 0.3},
        "twice": {"exposures": 2},
    }.items():
        (one,) = efficiency(where, fibre, [1.5], EfficiencySettings(("free",), fields=8, **asked))
        shares[name] = one.observed
    assert shares["clustered"] < shares["plain"] - 0.05
    assert shares["broken"] < shares["plain"] - 0.05
    assert shares["twice"] > shares["plain"] + 0.1


def test_fields_without_a_target_count_for_fibres_alone():
    """Seven units of PFS at 0.02 targets in an annulus: most fields are empty, and these have no share."""
    where, fibre = part_of("pfs", rings=2)
    (one,) = efficiency(where, fibre, [0.02], EfficiencySettings(("free",), fields=40))
    assert one.used == pytest.approx(0.02, abs=0.02)
    assert one.observed == 1.0


def test_a_list_on_the_whole_array():
    plane = generate(load_instrument("sdssv"), 0, n_positioners=19)
    targets = random_targets(plane, 60, seed=0)
    found = of_list(whole_array(plane, "BOSS"), "BOSS", targets, EfficiencySettings(("free", "assigned")))
    assert [one.rule for one in found] == ["free", "assigned"]
    assert found[0].observed >= found[1].observed > 0.2
    assert np.isnan(found[0].used_error)
    assert found[0].per_fibre == pytest.approx(60 / 19)


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"densities": [0.0]}, "density 0"),
        ({"densities": [1e6]}, "200000 at most"),
        ({"exposures": 0}, "0 exposures"),
        ({"broken": 1.0}, "broken 1"),
    ],
)
def test_bad_numbers_are_refused(asked, says):
    where, fibre = part_of("pfs", rings=2)
    densities = asked.pop("densities", [1.0])
    with pytest.raises(InputError, match=says):
        efficiency(where, fibre, densities, EfficiencySettings(**asked))


def test_the_command_draws_and_refuses_unknown_rules(fl, tmp_path):
    words = ("--fields", 2, "--rings", 2, "--density", 2, "--out", tmp_path / "shares.png")
    assert fl("design", "efficiency", "pfs", *words)[0] == 0
    assert (tmp_path / "shares.png").exists()
    code, _, said = fl("design", "efficiency", "pfs", "--rules", "luck")
    assert code == 2
    assert "known are random, free, tips, arms, assigned" in said
