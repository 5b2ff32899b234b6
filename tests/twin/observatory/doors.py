"""What a served camera looks at, and how its failures are waited for on a machine with other work."""

import time

import numpy as np
import pytest

from fiberloom.metrology.acquisition import CameraGeometry
from fiberloom.metrology.sources.errors import CameraError, CameraSilent
from fiberloom.twin.camera.imaging import CameraModel, Detector, Optics
from fiberloom.twin.server.camera.exposing import Look

PATIENCE_S = 120
"""A deadline for what comes by itself: the camera's process yields to all ordinary programs."""
TRIES = 12
WIDTH, HEIGHT = 96, 64
MODEL = CameraModel(Optics(CameraGeometry(WIDTH, HEIGHT, 0.1), 5.0), detector=Detector(gain_e_adu=1.5))


class SeenTwin:
    """What the camera's process asks; `on`: the faults."""

    def __init__(self):
        self.looked_s = []
        self.on, self.lit_mm, self.time_s = set(), np.array([[0.0, 0.0], [2.0, 1.0]]), 7.0

    def look(self):
        self.looked_s.append(time.monotonic())
        return Look(self.time_s, self.lit_mm)

    def faults(self):
        return frozenset(self.on)


def failure(source, kind):
    """The error of an exposure. Silence is asked again where another `kind` is meant: the image was late."""
    for _ in range(TRIES):
        with pytest.raises(CameraError) as caught:
            source.expose()
        if kind is CameraSilent or not isinstance(caught.value, CameraSilent):
            break
    return caught.value
