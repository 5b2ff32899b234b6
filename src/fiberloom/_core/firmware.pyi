"""The positioner's firmware, compiled for the host."""

from typing import Annotated, Any

import numpy
from numpy.typing import NDArray


AXIS_PARAMS: list[tuple[str, str, float, float, float, str]]

SIZEOF_POSITIONER: int

TX_QUEUE: tuple[int, int]

HEARD_TICK: tuple[int, int]

CODES: list[tuple[int, str]]

STATUS_BITS: list[tuple[int, str]]

TICK_HZ: int

PATH_POINTS: int = 1000

def encode_identifier(positioner: int, command: int, uid: int = 0, code: int = 0) -> int: ...

def decode_identifier(id: int) -> tuple[int, int, int, int]:
    """(positioner, command, uid, code)"""

def sincos(angle_cnt: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.float32], dict(shape=(None, 2))]:
    """(n, 2) sine and cosine of motor angles, 2**20 a turn."""

def atan2_cnt(sin: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], cos: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.int32], dict(shape=(None,))]: ...

def sqrt(x: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.float32], dict(shape=(None,))]: ...

def hall_angle(params: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], adc_cnt: Annotated[NDArray[numpy.uint16], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.int32], dict(shape=(None,))]:
    """Unwrapped rotor angle in counts."""

def commutate(voltage: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], rotor: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], lead_rad: float = 0.0) -> Annotated[NDArray[numpy.float32], dict(shape=(None, 3))]:
    """Duties (n, 3). Eq. 18 and 20."""

def rotating_field(u: float, field_cnt: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.float32], dict(shape=(None, 3))]:
    """Duties (n, 3). Eq. 18."""

def servo(params: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], rows: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], settling: bool = False) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 5))]:
    """
    Eq. 21 and 22 along rows of command_cnt, measured_cnt, speed_rad_s, acceleration_rad_s2.
    """

def regulator(params: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], rows: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], zero_cnt: int = 0) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 6))]:
    """
    Law 1 along rows of command_cnt, measured_cnt, speed_rad_s, acceleration_rad_s2: (torque_Nm, feedforward_Nm, watched_Nm, voltage, load_Nm, gap below the rotor in counts).
    """

def touch(params: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], rows: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 7))]:
    """
    (rise_Nm, limit_Nm, touched, four coefficients of fl_ripple.h in Nm) along rows of error_rad, beyond_Nm, excess_Nms, speed_rad_s, direction, acceleration_rad_s2, drag_doubt, touching, sine and cosine of the rotor, from power-up.
    """

def smooth(raw_cnt: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C', device='cpu', writable=False)], start_cnt: int) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 3))]: ...

def profile(from_cnt: int, to_cnt: int, speed_rpm: float, acceleration_rad_s2: float) -> Annotated[NDArray[numpy.int32], dict(shape=(None,))]: ...

def rows_trace(config: Annotated[NDArray[numpy.uint32], dict(shape=(4), order='C', device='cpu', writable=False)], table: Annotated[NDArray[numpy.int32], dict(shape=(None, 5), order='C', device='cpu', writable=False)], ticks: int) -> Annotated[NDArray[numpy.int32], dict(shape=(None, 4))]:
    """
    (ticks, 4) fields of both motors in tenths of a motor deg and their phases, at the end of each tick of a table: rows of steps (2), cruise (2), pause. config: creep_ticks, cruise_tenths, ramp_ticks, pause_ticks.
    """

def rows_ends(config: Annotated[NDArray[numpy.uint32], dict(shape=(4), order='C', device='cpu', writable=False)], tables: Annotated[NDArray[numpy.int32], dict(shape=(None, None, 5), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.int32], dict(shape=(None, None, 3))]:
    """
    (n, R, 3) fields of both motors in tenths of a motor deg, and the tick, at the end of each row.
    """

def steps_trace(config: Annotated[NDArray[numpy.int32], dict(shape=(5), order='C', device='cpu', writable=False)], position: int, goal: int, ticks: int, stop_tick: int = -1) -> Annotated[NDArray[numpy.int32], dict(shape=(None, 4))]:
    """
    (ticks, 4) position, segment, field in microsteps and whether it is at rest, at the end of each tick of a way; braked from stop_tick on. config: segment_ticks, start, most, change, field_steps.
    """

def steps_seek(config: Annotated[NDArray[numpy.int32], dict(shape=(5), order='C', device='cpu', writable=False)], position: int, lost: int, most: int) -> tuple[bool, int, int]:
    """
    (found, slip, position) of a search of the datum by a rotor `lost` microsteps behind its count; the switch closes at 0 of the rotor.
    """

def path(points: Annotated[NDArray[numpy.int32], dict(shape=(None, None), order='C', device='cpu', writable=False)], here_cnt: int, ticks: int, landing_cnt: int = 0) -> tuple[Annotated[NDArray[numpy.int32], dict(shape=(None,))], int, bool]: ...

def supervisor(state: int, input: int, conditions: int) -> tuple[int, int]:
    """(next state, response code)"""

def command_table() -> list[dict[str, Any]]:
    """
    Rows of number, name, length (least, most), broadcast, bootloader, input, axes.
    """

def hall_fit(adc_cnt: Annotated[NDArray[numpy.uint16], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> tuple[float, float, float, float, float, float] | None:
    """(offset a, b, amplitude a, b, phase_rad, residual_rad) or None."""

def friction_fit(rows: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> tuple[float, float, float, float] | None:
    """
    (coulomb_Nm, spring_Nm, cogging_Nm, cogging_phase_rad) or None, of rows (n, 3) of direction, rotor_cnt, torque_Nm.
    """

def fade(x: float, share: float, least: float) -> float:
    """What is left of x after a tick: never below `least`."""

def follow(x: float, target: float, share: float) -> float:
    """x a tick on, where it follows the target."""

def subnormals_met() -> bool | None:
    """
    Whether a result or an operand was subnormal on this thread since the last call; None where the processor does not tell.
    """

def round_i32(x: float) -> int:
    """Nearest integer, halves away from zero."""

def params_fault(params: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> int:
    """Index of the first bad parameter, -1 if none."""

def crc32(data: bytes) -> int: ...

STATES: dict[str, int]

INPUTS: dict[str, int]

CONDITIONS: dict[str, int]

class Positioner:
    """One positioner on a bench, for tests: firmware, port, small plants."""

    def __init__(self, id: int, params: Annotated[NDArray[numpy.float32], dict(shape=(2, 58), order='C', device='cpu', writable=False)]) -> None:
        """params: (2, len(AXIS_PARAMS)) float32, alpha and beta."""

    def power_up(self) -> None:
        """As after switching on: only the storage is kept."""

    def receive(self, id: int, data: bytes = ...) -> None: ...

    def take_frames(self) -> list[tuple[int, bytes]]:
        """Frames sent since the last call: (id, data)."""

    def tick(self, n: int = 1) -> None: ...

    def run(self, n: int, axis: int) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 8))]:
        """
        n ticks; rows of command_deg, tracking_deg, speed_rad_s, feedback_Nm, feedforward_Nm, voltage, theta_rad, omega_rad_s (the last two are the plant's).
        """

    def declare_position(self) -> None:
        """Tells the firmware where the rotors are."""

    def set_position(self, alpha: int, beta: int) -> None: ...

    def enter_bootloader(self) -> None: ...

    def forget_calibration(self, axis: int, hall: bool = False, datum: bool = False) -> None:
        """As on a unit that was never calibrated."""

    def params(self, axis: int) -> Annotated[NDArray[numpy.float32], dict(shape=(None,))]: ...

    def set_params(self, axis: int, row: Annotated[NDArray[numpy.float32], dict(shape=(58), order='C', device='cpu', writable=False)]) -> bool:
        """The firmware's parameters, not the bench's sensors."""

    def sync(self) -> None: ...

    def at_rest(self) -> bool: ...

    def skip(self, n: int) -> None: ...

    def plant(self, axis: int, name: str) -> float:
        """A number of the bench's plant; KeyError if it has no such."""

    def set_plant(self, axis: int, name: str, value: float) -> None: ...

    def set_hall(self, axis: int, a_cnt: int, b_cnt: int) -> None: ...

    def duty(self, axis: int) -> tuple[float, float, float]: ...

    @property
    def driven(self) -> bool: ...

    @driven.setter
    def driven(self, arg: bool, /) -> None: ...

    @property
    def mailbox_open(self) -> bool: ...

    @mailbox_open.setter
    def mailbox_open(self, arg: bool, /) -> None: ...

    @property
    def opens(self) -> bool: ...

    @opens.setter
    def opens(self, arg: bool, /) -> None: ...

    def is_open(self, axis: int) -> bool:
        """Whether the bridge of the axis is open."""

    @property
    def hall_noise_cnt(self) -> float: ...

    @hall_noise_cnt.setter
    def hall_noise_cnt(self, arg: float, /) -> None: ...

    @property
    def write_budget(self) -> int: ...

    @write_budget.setter
    def write_budget(self, arg: int, /) -> None: ...

    @property
    def storage(self) -> bytes: ...

    @storage.setter
    def storage(self, arg: bytes, /) -> None: ...

    @property
    def status(self) -> int: ...

    @property
    def state(self) -> int: ...

    @property
    def position_cnt(self) -> tuple[int, int]: ...

    @property
    def memory(self) -> bytes: ...
