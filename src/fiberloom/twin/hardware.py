"""A twin as `Hardware`: a bus, a camera and the truth, as an operation gets them."""

from __future__ import annotations

import numpy as np

from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane, Instrument
from fiberloom.instruments.model import AXES, Axis
from fiberloom.metrology import Camera
from fiberloom.twin.camera.models import image_camera
from fiberloom.twin.camera.noise_camera import NoiseCamera
from fiberloom.twin.errors.sizes import NO_ERRORS, TwinErrors
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.faults.grammar import parse_faults
from fiberloom.twin.faults.kinds import OBSERVED
from fiberloom.twin.faults.schedule import ScheduledFault, schedule_faults
from fiberloom.twin.sky.guider import TwinGuider
from fiberloom.twin.transport import TwinTransport
from fiberloom.twin.twin import Twin
from fiberloom.twin.units import Units
from fiberloom.units import GEAR

CAMERAS = ("noise", "image")


def bench_hardware(plane: FocalPlane, units: Units, seed: int) -> Hardware:
    """Each positioner alone under the camera: arms do not meet."""
    check_motors(plane.instrument)
    twin = Twin(plane, units, seed=seed, neighbours=False)
    return _hardware(TwinTransport(twin), twin, seed + 1)


def field_hardware(
    plane: FocalPlane,
    units: Units,
    seed: int,
    faults: str = "",
    camera: str = "noise",
    errors: TwinErrors = NO_ERRORS,
) -> Hardware:
    """The focal plane, folded, with the `faults` asked for ("dark=3,dead=1,lying=1").

    `units`: those of the `plane`; `seed` of noise and faults; `camera`: noise or image; `errors`: of what the
    camera and the positioners' thermometers see.
    """
    check_camera(camera)
    check_motors(plane.instrument)
    twin = Twin(plane, units, seed=seed)
    power_up(twin, errors, seed)
    tell_temperature(twin, errors, seed)
    return _hardware(faulty_transport(twin, faults, seed), twin, seed, camera, errors)


def tell_temperature(twin: Twin, errors: TwinErrors, seed: int) -> None:
    """The sensors of a `twin` read the temperature of its night, of `errors` and `seed`, deg C as counts."""
    counts = errors.temperature.sensor_counts(twin.plane, seed)
    if counts is not None:
        twin.set_temperature(counts)


def power_up(twin: Twin, errors: TwinErrors, seed: int) -> None:
    """Power comes on: no datum is on record, and some counters of the `twin` are off by whole motor turns.

    `errors`: the share of those; nothing happens where it is 0. `seed`: which they are.
    """
    if errors.power_share > 0.0:
        for number in twin.plane.positioner_id.tolist():
            twin.power_up(number, errors.turns_lost(number, seed))


def faulty_transport(twin: Twin, faults: str, seed: int) -> TwinTransport:
    """The bus of a twin with the `faults` of a text, drawn by the `seed`; some begin and end meanwhile."""
    return TwinTransport(twin, faults=FaultClock(twin, draw_faults(twin.plane, faults, seed), seed))


def check_camera(camera: str) -> None:
    """Refuses a camera that the twin does not have."""
    if camera not in CAMERAS:
        raise InputError(f"--camera {camera}: known are {', '.join(CAMERAS)}")


def missing_in_twin(instrument: Instrument) -> str:
    """What the twin and its firmware lack to drive an instrument in a loop; empty: nothing."""
    if not instrument.metrology.present:
        return f"{instrument.name} has no metrology camera: it cannot be observed in a loop"
    if not (foreign := foreign_motors(instrument)):
        return ""
    return f"{foreign}. assign, plan, verify, centroid and match work with this instrument"


def foreign_motors(instrument: Instrument) -> str:
    """Which motors are not those of the twin with SDSS-V's firmware; empty: none."""
    for name in AXES:
        axis: Axis = getattr(instrument, name)
        if (axis.kind, axis.closed_loop, axis.gear) != ("bldc", True, GEAR):
            loop = "closed" if axis.closed_loop else "open"
            return (
                f"{instrument.name}: {name} is a {axis.kind} motor in {loop} loop with a gear of "
                f"{axis.gear:g}; this works with bldc motors in closed loop with a gear of {GEAR:g} only"
            )
    if instrument.drive.protocol != "sdssv":
        return (
            f"{instrument.name}: drive.protocol = '{instrument.drive.protocol}'; this works with 'sdssv' only"
        )
    return ""


def check_motors(instrument: Instrument) -> None:
    """Refuses an instrument that the twin cannot drive."""
    if reason := missing_in_twin(instrument):
        raise InputError(reason)


def _hardware(
    bus: TwinTransport, twin: Twin, seed: int, camera: str = "noise", errors: TwinErrors = NO_ERRORS
) -> Hardware:
    camera_of: Camera
    if camera == "image":
        camera_of = image_camera(twin, seed, errors=errors)
    else:
        camera_of = NoiseCamera(twin, twin.plane.instrument.metrology.noise_rms_um, seed, errors)
    # without that error each is told at power-up where it is, as after a search of the datum
    vouched = np.full(len(twin.plane), errors.power_share == 0.0)
    guider = TwinGuider(errors.pointing, seed)
    return Hardware(bus, camera_of, twin, vouched=vouched, telescope=twin, guider=guider)


def draw_faults(plane: FocalPlane, text: str, seed: int) -> list[ScheduledFault]:
    """Faults of a text of `--faults`, on positioners that are drawn by the seed, each on another one."""
    requests = parse_faults(text, OBSERVED)
    able = plane.positioner_id[~plane.offline]
    return schedule_faults(requests, able, (), seed)
