"""Waveforms of a field: those that take too long are named, and are in no leg."""

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.drive.moons import WaveformMaker, maker
from fiberloom.drive.port import Wanted
from fiberloom.drive.steppers import AxisSteps, KnownUnits


@pytest.mark.parametrize("most", [0, 100, 256])
def test_ways_that_are_too_long_are_not_loaded(most, monkeypatch):
    """A controller refuses one that is too long, and nothing starts where one is refused."""
    monkeypatch.setattr(maker, "MOST_SEGMENTS", most)
    plane, n = fl.FocalPlane.of("moons", seed=0, n=8), 8
    here = np.tile(plane.instrument.positioner.park_deg, (n, 1))
    goal = np.column_stack([np.linspace(-150.0, 150.0, n), np.full(n, 170.0)])
    known = KnownUnits.nominal(AxisSteps.of(plane.instrument), n)
    wanted = Wanted(plane, here, goal, np.zeros(n))
    legs, refused = WaveformMaker(3400).legs(wanted, np.ones(n, dtype=bool), np.zeros((n, 2)), known)
    gone = [row for leg in legs for row in leg.rows.tolist()]
    assert sorted([*gone, *refused]) == list(range(n))
    assert {0: 0, 100: 3, 256: n}[most] == len(gone)
    assert all(len(leg.counts) - 1 <= most for leg in legs)
    assert all(why == f"its way takes more than {most} segments" for why in refused.values())
