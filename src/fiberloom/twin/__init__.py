"""A physics twin of a focal plane: true units with the real firmware, a virtual bus and camera."""

from .bench_camera import BenchCamera, static_fibre_um
from .camera import NoiseCamera
from .draw import draw_units, put_in, worn
from .faults import Fault, FaultKind
from .hardware import bench_hardware, field_hardware
from .transport import TwinTransport
from .twin import Reply, Twin
from .units import Units

__all__ = [
    "BenchCamera",
    "Fault",
    "FaultKind",
    "NoiseCamera",
    "Reply",
    "Twin",
    "TwinTransport",
    "Units",
    "bench_hardware",
    "draw_units",
    "field_hardware",
    "put_in",
    "static_fibre_um",
    "worn",
]
