"""Matrices that are covariances, and those that are none."""

import numpy as np

from fiberloom.calibration.covariances import are_covariances


def test_each_fault_is_seen_alone():
    good = np.array([[2.0, 0.5], [0.5, 1.0]])
    faults = {
        "skew": [[2.0, 0.5], [0.4, 1.0]],
        "indefinite": [[1.0, 2.0], [2.0, 1.0]],
        "singular": [[1.0, 1.0], [1.0, 1.0]],
        "negative": [[-1.0, 0.0], [0.0, -1.0]],
        "large": [[2.5, 0.0], [0.0, 1.0]],
        "no number": [[np.nan, 0.0], [0.0, 1.0]],
        "infinite": [[1.0, 0.0], [0.0, np.inf]],
    }
    many = np.array([good, *faults.values(), good])
    assert are_covariances(many, 3.0).tolist() == [True] + [False] * len(faults) + [True]
    assert are_covariances(np.empty((0, 2, 2)), 3.0).tolist() == []
