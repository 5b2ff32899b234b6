"""Physics of whole focal planes with firmware in the loop. SI, rad."""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy
from numpy.typing import NDArray


TICK_S: float = 0.0005

SYNC_TICKS: int = 4

SCOPE_FIELDS: tuple[str, ...]

PLANT_PARAMS: list[tuple[str, str, float, float, float, str]]

KERNELS: list[str]

HARMONIC_ORDERS: list[int]

WEAR_COUNT: int = 8

TRANSMISSION_SIZE: int = 77

NODES_PER_TURN: int = 4096

def transmission(transmission: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], gear_ratio: float, output_rad: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,))], Annotated[NDArray[numpy.float64], dict(shape=(None,))]]:
    """Gear angle T- and backlash B, motor rad, at output angles."""

def output_per_motor(transmission: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], gear_ratio: float) -> float:
    """The most that the output turns for a rad of the motor."""

class Plant:
    """Motors, gears and hall sensors of n axes, without firmware."""

    def __init__(self, plant: Annotated[NDArray[numpy.float64], dict(order='C', device='cpu', writable=False)], transmission: Annotated[NDArray[numpy.float64], dict(order='C', device='cpu', writable=False)], output_rad: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], seed: int = 0, kernel: str = '', substeps: int | tuple[int, int] = 10) -> None:
        """
        plant (n, len(PLANT_PARAMS)), transmission (n, TRANSMISSION_SIZE), output_rad (n,); substeps a tick, or a pair: of any axis, and of one that pushes its gear all the time. ValueError names what is wrong with which axis.
        """

    def run(self, duty: Annotated[NDArray[numpy.float64], dict(shape=(None, None, None), order='C', device='cpu', writable=False)]) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None, None, 4))], Annotated[NDArray[numpy.int32], dict(shape=(None, None, 2))]]:
        """
        One tick for each row of duties (ticks, n, 3). Returns (ticks, n, 4): motor rad, momentum N m s, gear rad, output rad after each tick; and hall counts (ticks, n, 2) at its start.
        """

    def push(self, torque_fraction: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None, 4))]:
        """
        Drives at 90 deg to the true rotor, Eq. 20, with a share [-1, 1] of the supply (ticks, n).
        """

    def advance(self, ticks: int) -> None:
        """Ticks with the duties as they are, without a log."""

    def state(self, axis: int) -> tuple[float, float, float, float]:
        """Motor rad, momentum N m s, gear rad, output rad."""

    def set_state(self, axis: int, theta_rad: float, momentum_Nms: float, gear_rad: float) -> None: ...

    def set_external_torque(self, axis: int, torque_Nm: float) -> None:
        """At the output, positive towards positive angles."""

    def set_open(self, axis: int, open: bool) -> None:
        """Opens or closes the bridge; once a tick while it is open."""

    def backlash_rad(self, axis: int) -> float:
        """Where the gear is, motor rad."""

    def speed_bound(self, axis: int) -> tuple[float, float]:
        """
        Of the rotor: limit in rad/s that none exceeds, time constant of the way there in s.
        """

    @property
    def kernel(self) -> str: ...

class TwinSetup:
    """What a twin is made from, N positioners."""

    def __init__(self, *, ids: Annotated[NDArray[numpy.uint16], dict(shape=(None,), order='C', device='cpu', writable=False)], plant: Annotated[NDArray[numpy.float64], dict(order='C', device='cpu', writable=False)], transmission: Annotated[NDArray[numpy.float64], dict(order='C', device='cpu', writable=False)], firmware: Annotated[NDArray[numpy.float32], dict(order='C', device='cpu', writable=False)], start_rad: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order='C', device='cpu', writable=False)]) -> None:
        """
        ids (N,), 1..2047; rows of alpha and beta in turn: plant (2 N, len(PLANT_PARAMS)), transmission (2 N, TRANSMISSION_SIZE), firmware (2 N, len(AXIS_PARAMS)); start_rad (N, 2), output angles.
        """

    def place(self, arms: Annotated[NDArray[numpy.float64], dict(shape=(None, 5), order='C', device='cpu', writable=False)], obstacles: Annotated[NDArray[numpy.float64], dict(shape=(None, 5), order='C', device='cpu', writable=False)], body_mm: tuple[float, float, float]) -> None:
        """
        arms (N, 5): centre x, y, l_alpha in mm, alpha_off, beta_off in rad; obstacles (K, 5): x0, y0, x1, y1, radius in mm; body_mm: centre line of a beta arm from x0 to x1, and its radius.
        """

    @property
    def seed(self) -> int: ...

    @seed.setter
    def seed(self, arg: int, /) -> None: ...

    @property
    def threads(self) -> int: ...

    @threads.setter
    def threads(self, arg: int, /) -> None: ...

    @property
    def neighbours(self) -> bool:
        """arms that touch push each other"""

    @neighbours.setter
    def neighbours(self, arg: bool, /) -> None: ...

    @property
    def skip_resting(self) -> bool:
        """leave out what would change nothing"""

    @skip_resting.setter
    def skip_resting(self, arg: bool, /) -> None: ...

    @property
    def side_by_side(self) -> bool:
        """laws of several axes at once; the same bits"""

    @side_by_side.setter
    def side_by_side(self, arg: bool, /) -> None: ...

    @property
    def sort_lanes(self) -> bool:
        """
        at START positioners whose ways end about together are stepped together; the same bytes
        """

    @sort_lanes.setter
    def sort_lanes(self, arg: bool, /) -> None: ...

    @property
    def substeps(self) -> tuple[int, int]:
        """
        of the plant in a tick: of any axis, and of one that pushes its gear all the time; one number for both
        """

    @substeps.setter
    def substeps(self, arg: int | tuple[int, int], /) -> None: ...

    @property
    def kernel(self) -> str:
        """one of KERNELS, or empty for the best"""

    @kernel.setter
    def kernel(self, arg: str, /) -> None: ...

    @property
    def bound_scale(self) -> float:
        """
        of how far arms may come until they are looked at again: above 1 shorter slices, the same bytes
        """

    @bound_scale.setter
    def bound_scale(self, arg: float, /) -> None: ...

class Twin:
    """Positioners with firmware on a virtual bus."""

    def __init__(self, setup: TwinSetup) -> None:
        """ValueError where the setup is not sound."""

    def send(self, id: int, data: bytes) -> None: ...

    def connect(self, index: int, bus: int) -> None: ...

    def run(self, ticks: int) -> list[tuple[int, bytes, float]]:
        """Replies (id, data, time_s) since the last call."""

    def run_until_reply(self, ticks: int, slices: int) -> list[tuple[int, bytes, float]]:
        """
        So many slices of ticks, none after one that has brought replies (id, data, time_s).
        """

    def fault(self, index: int, axis: int, kind: str, on: bool) -> None:
        """kind: dead, blocked, lying, stuck_hall, deaf or mute."""

    def slip(self, index: int, axis: int, up: float, down: float) -> None:
        """
        Share of the gear's way that the arm makes, upwards and downwards; 1 and 1: no fault.
        """

    def power_cycle(self, index: int, bootloader: bool = False) -> None: ...

    def set_temperature(self, index: int, counts: int) -> None:
        """
        What the temperature sensor of a positioner reads, in the sensor's counts.
        """

    def power_up(self, index: int, alpha_turns: int, beta_turns: int) -> None:
        """
        Power off and on at rest, no datum on record, counters off by so many whole motor turns.
        """

    def set_external_torque(self, index: int, axis: int, torque_Nm: float) -> None: ...

    def set_loads(self, rows: Annotated[NDArray[numpy.float64], dict(shape=(None, 12), order='C', device='cpu', writable=False)]) -> None:
        """
        (N, 12): of alpha, then of beta moment_x and moment_y (kg m, in the frame of the arm), fibre_rate (Nm/rad), fibre_free (rad), fibre_friction (Nm), fibre_slip (rad).
        """

    def point(self, x_m_s2: float, y_m_s2: float) -> None:
        """Gravity along the focal plane from now on."""

    def set_transmission(self, index: int, axis: int, row: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> None: ...

    def set_params(self, index: int, axis: int, row: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> None: ...

    def outputs_rad(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 2))]:
        """Output angles (N, 2)."""

    def motors_rad(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 2))]:
        """Motor angles (N, 2)."""

    def scope(self, index: int, axis: int, on: bool) -> None:
        """Records an axis in every tick from now on, or no longer."""

    def take_scope(self, index: int, axis: int) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 19))]:
        """Rows of SCOPE_FIELDS since the last call."""

    def take_touches(self) -> list[tuple[float, int, int]]:
        """First moments of contact since the last call."""

    def backlash_rad(self, index: int, axis: int) -> float:
        """Where the gear is, motor rad."""

    def asleep(self, index: int) -> bool: ...

    @property
    def resting(self) -> bool: ...

    @property
    def bytes_per_positioner(self) -> int:
        """Memory of one positioner beside its firmware's state, before any log."""

    @property
    def tick(self) -> int: ...

    @property
    def ticks_run(self) -> int: ...

    @property
    def single_ticks(self) -> int: ...

    @property
    def ticks_skipped(self) -> int: ...

    @property
    def group_ticks(self) -> int:
        """Ticks of groups of lanes in which one of their positioners was awake."""

    @property
    def slices(self) -> int:
        """Spans of time in which threads did not wait for each other."""

    def bounds_mm(self, ticks: int) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]:
        """
        The farthest (N,) that arms can come within 4 to 256 ticks from now, unless one begins to push another.
        """

    @property
    def kernel(self) -> str: ...

class RealTime:
    """A thread that computes each tick of a Twin when it is due."""

    def __init__(self, twin: Twin, speed: float, wake_fd: int, first: bool = False) -> None: ...

    def post(self, frames: Sequence[tuple[int, bytes, int, int]]) -> None:
        """Frames (id, data, bus, tick)."""

    def take(self) -> list[tuple[int, bytes, float]]: ...

    @property
    def tick_now(self) -> float: ...

    def pace(self) -> dict[str, Any]: ...

    def hold(self) -> None: ...

    def release(self) -> None: ...

    @property
    def first(self) -> bool: ...

    def stop(self) -> None: ...
