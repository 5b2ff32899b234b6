"""A physics twin of a focal plane: true units with the real firmware, a virtual bus and camera."""

from typing import TYPE_CHECKING

from fiberloom.lazy import on_use

if TYPE_CHECKING:
    from fiberloom.twin.bench import bench_units
    from fiberloom.twin.camera.bench_camera import BenchCamera, static_fibre_um
    from fiberloom.twin.camera.noise_camera import NoiseCamera
    from fiberloom.twin.draw import draw_units, put_in
    from fiberloom.twin.faults.ailments import AilmentModel, Ailments, draw_ailments
    from fiberloom.twin.faults.faults import Fault
    from fiberloom.twin.faults.kinds import AilmentKind, FaultKind
    from fiberloom.twin.hardware import bench_hardware, field_hardware
    from fiberloom.twin.statistical import StatisticalTwin
    from fiberloom.twin.transport import TwinTransport
    from fiberloom.twin.twin import Reply, Twin
    from fiberloom.twin.units import Units
    from fiberloom.twin.wear import Wear, WearModel, worn
    from fiberloom.twin.weights import TwinWeights

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
    "Wear",
    "WearModel",
    "bench_hardware",
    "bench_units",
    "draw_ailments",
    "draw_units",
    "field_hardware",
    "put_in",
    "static_fibre_um",
    "worn",
]

__getattr__ = on_use(__name__)
