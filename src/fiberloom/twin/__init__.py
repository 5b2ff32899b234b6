"""A physics twin of a focal plane: true units with the real firmware, a virtual bus and camera."""

from .ailments import AilmentKind, AilmentModel, Ailments, draw_ailments
from .bench import bench_units
from .bench_camera import BenchCamera, static_fibre_um
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
from .years import Visit, Years

__all__ = [
    "AilmentKind",
    "AilmentModel",
    "Ailments",
    "BenchCamera",
    "Fault",
    "FaultKind",
    "NoiseCamera",
    "Reply",
    "StatisticalTwin",
    "Twin",
    "TwinTransport",
    "TwinWeights",
    "Units",
    "Visit",
    "Wear",
    "WearModel",
    "Years",
    "bench_hardware",
    "bench_units",
    "draw_ailments",
    "draw_units",
    "field_hardware",
    "put_in",
    "static_fibre_um",
    "worn",
]
