"""Fiducials among all spots: at any rotation, with dead ones and strays, or an error."""

from dataclasses import replace

import numpy as np
import pytest

from fiberloom.metrology import zhao_burge
from fiberloom.metrology.acquisition import (
    AcquisitionError,
    AcquisitionSettings,
    CameraGeometry,
    acquire,
    refine,
)
from fiberloom.metrology.transform import Similarity

NOMINAL = CameraGeometry(6000, 6132, 0.1215, flipped=True)


class Sky:
    """A field of fibres and fiducials as a camera turned by some angle sees it."""

    def __init__(self, plane, seed=0, turn=0.0, dead=5, stray=60, dark_side=0.0, scale=1.0, irregular=True):
        rng = np.random.default_rng([seed, 3])
        low, high = plane.limits_deg.T
        angles = rng.uniform(low, high, (len(plane), 2))
        self.expected = plane.forward(*angles.T)
        true = self.expected + rng.normal(0, 0.05, self.expected.shape)
        gone = rng.random(len(plane)) < 0.05
        true[gone] = plane.forward(*rng.uniform(low, high, (len(plane), 2)).T)[gone]
        lit = self.expected[:, 0] <= np.quantile(self.expected[:, 0], 1 - dark_side)
        self.fiducials = plane.fiducials[:, :2].copy()
        if irregular:  # the array of the preset is the same after a sixth of a turn
            self.fiducials += rng.uniform(-25, 25, self.fiducials.shape)
        alive = rng.permutation(len(self.fiducials))[dead:]
        radius, angle = 340 * np.sqrt(rng.random(stray)), rng.uniform(0, 2 * np.pi, stray)
        nobody = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        self.mm = np.vstack([true[lit], self.fiducials[alive], nobody])
        self.alive = set(alive.tolist())
        self.px = self._to_px(turn, scale) + rng.normal(0, 0.01, self.mm.shape)

    def _to_px(self, turn, scale):
        bend = zhao_burge.basis(self.mm / 330, (9, 20, 5))
        bent = self.mm + np.tensordot([0.64, 0.028, 0.02], bend, 1)
        base = replace(NOMINAL, rotation_deg=turn).similarity()
        return Similarity(base.a * scale, base.b, True).to_px(bent)

    def acquire(self, tolerance=180.0, helped=True):
        geometry = replace(NOMINAL, rotation_tolerance_deg=tolerance)
        return acquire(
            self.px,
            self.fiducials,
            geometry,
            expected_mm=self.expected if helped else None,
            settings=AcquisitionSettings(radius_mm=330.0),
        )

    def check(self, found, at_least):
        assert len(found.fiducial) >= at_least
        np.testing.assert_allclose(self.mm[found.spot], self.fiducials[found.fiducial], atol=1e-9)
        error_um = 1e3 * np.hypot(*(found.transform.to_mm(self.px) - self.mm).T)
        # 0.01 px are 1.2 um per coordinate
        assert np.sqrt(np.mean(error_um**2)) < 3.0


@pytest.mark.parametrize(
    ("case", "tolerance", "at_least"),
    [
        ({}, 1.5, 55),
        ({"turn": 1.0}, 1.5, 55),
        ({"turn": 10.0, "dark_side": 0.2}, 15.0, 55),
        ({"turn": 137.0}, 180.0, 55),
        ({"turn": -77.0, "dead": 15, "stray": 100, "dark_side": 0.4, "scale": 1.04}, 180.0, 45),
    ],
)
def test_fiducials_are_found(plane, case, tolerance, at_least):
    sky = Sky(plane, **case)
    sky.check(sky.acquire(tolerance), at_least)


def test_fiducials_are_found_without_any_fibre_known(plane):
    sky = Sky(plane, seed=2, turn=50.0)
    sky.check(sky.acquire(helped=False), 55)


def test_a_symmetric_array_is_an_error_and_not_a_guess(plane):
    sky = Sky(plane, turn=50.0, irregular=False)
    with pytest.raises(AcquisitionError, match="turned by"):
        sky.acquire(helped=False)
    sky.check(sky.acquire(helped=True), 55)


def test_folded_arms_do_not_pass_for_fiducials(plane):
    """Parked, the fibres repeat the lattice of the fiducials: the pattern fits them, shifted."""
    sky = Sky(plane, irregular=False, stray=0, dead=0)
    folded = plane.forward(*plane.offline_position_deg.T)
    sky.mm = np.vstack([folded, sky.fiducials])
    sky.px, sky.expected = sky._to_px(0.4, 1.0), folded
    sky.check(sky.acquire(15.0), 60)


def test_the_next_image_is_refined(plane):
    sky = Sky(plane)
    first = sky.acquire(1.5)
    moved = sky.px + np.array([1.5, -0.8])
    again = refine(moved, sky.fiducials, first.transform)
    assert len(again.fiducial) >= 55
    np.testing.assert_allclose(again.transform.to_mm(moved), first.transform.to_mm(sky.px), atol=1e-3)
    with pytest.raises(AcquisitionError, match="anew"):
        refine(sky.px + 300.0, sky.fiducials, first.transform)


def test_a_picture_of_something_else_is_refused(plane):
    rng = np.random.default_rng(0)
    sky = Sky(plane)
    sky.px = rng.uniform(0, 6000, (500, 2))
    with pytest.raises(AcquisitionError, match="fiducials found"):
        sky.acquire(1.5)


def test_too_few_are_refused(plane):
    sky = Sky(plane)
    with pytest.raises(AcquisitionError, match="at least 4"):
        acquire(sky.px, sky.fiducials[:3], NOMINAL)
    with pytest.raises(AcquisitionError, match="2 spots"):
        acquire(sky.px[:2], sky.fiducials, NOMINAL)
