"""A physics twin of a focal plane: true units with the real firmware, a virtual bus and camera."""

from .camera import NoiseCamera
from .draw import draw_units, put_in
from .faults import Fault, FaultKind
from .hardware import bench_hardware, field_hardware
from .statistical import StatisticalTwin
from .transport import TwinTransport
from .twin import Reply, Twin
from .units import Units
from .wear import Wear, WearModel, worn
from .weights import TwinWeights

__all__ = [
    "Fault",
    "FaultKind",
    "NoiseCamera",
    "Reply",
    "StatisticalTwin",
    "Twin",
    "TwinTransport",
    "TwinWeights",
    "Units",
    "Wear",
    "WearModel",
    "bench_hardware",
    "draw_units",
    "field_hardware",
    "put_in",
    "worn",
]
