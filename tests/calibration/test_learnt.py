"""Learnt states go through bytes and come back."""

import numpy as np
import pytest
from wearing import Wearing, random_goals

from fiberloom.calibration.adaptive.calibration import AdaptiveCalibration
from fiberloom.calibration.adaptive.learnt import origin, pack, unpack
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument

PLANE = generate(load_instrument("sdssv"), seed=0, n_positioners=7)


def taught(fields=20):
    world, rng = Wearing(PLANE, seed=1), np.random.default_rng(0)
    maps = world.calibrated()
    learner = AdaptiveCalibration(PLANE, maps)
    for _ in range(fields):
        wire = learner.to_wire(random_goals(PLANE, rng))
        learner.update(wire, world.arrive(wire)[1])
    return world, maps, learner


def test_what_is_packed_comes_back():
    world, maps, learner = taught()
    again = AdaptiveCalibration(PLANE, maps)
    packets = pack(learner, np.arange(PLANE.n))
    unpack(again, packets, dict.fromkeys(packets, 20))
    np.testing.assert_allclose(again.output_deg, learner.output_deg, atol=2e-8)
    np.testing.assert_allclose(again.plane.arms, learner.plane.arms, atol=1e-9)
    wire = learner.to_wire(random_goals(PLANE, np.random.default_rng(5)))
    before, after = learner.sigma_deg(wire), again.sigma_deg(wire)
    # correlations between nodes are not kept: as sure of itself as before, or a little less
    assert (after > 0.98 * before).all()
    assert np.median(after / before) < 1.5
    assert (again.moves == 20).all()
    # it goes on learning from there
    again.update(wire, world.arrive(wire)[1])
    assert max(len(p) for p in packets.values()) < 15_000


def test_packets_of_others_are_passed_over_and_broken_ones_named():
    _, maps, learner = taught(2)
    packets = pack(learner, np.array([0, 3]))
    few = AdaptiveCalibration(PLANE.select([3, 5]), maps)
    unpack(few, packets, dict.fromkeys(packets, 2))
    np.testing.assert_allclose(few.output_deg[0], learner.output_deg[3], atol=2e-8)
    np.testing.assert_array_equal(few.moves, [2, 0])
    positioner = next(iter(packets))
    for broken in (b"", b"FL01nonsense", packets[positioner][:-9]):
        with pytest.raises(InputError, match=f"positioner {positioner} cannot be read"):
            unpack(learner, {positioner: broken}, {positioner: 1})


def test_another_calibration_or_other_arms_are_another_origin():
    world, maps, learner = taught(1)
    assert origin(maps, learner) == origin(maps, AdaptiveCalibration(PLANE, maps))
    assert origin(world.calibrated(), learner) != origin(maps, learner)
    moved = AdaptiveCalibration(world.true_plane, maps)
    assert origin(maps, moved) != origin(maps, learner)
