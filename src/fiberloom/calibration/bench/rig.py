"""What an engineer has at the bench."""

from __future__ import annotations

from dataclasses import dataclass

from fiberloom.bus.client import Client
from fiberloom.calibration.bench.bench import TorqueActuator
from fiberloom.metrology import Camera


@dataclass(frozen=True)
class BenchRig:
    """A bus, two cameras and weights: all that a measurement of single units gets."""

    client: Client
    camera: Camera
    close_up: Camera
    close_up_um: float
    """Two-dimensional rms of `close_up`."""
    weights: TorqueActuator
