"""Collision-free motion of all positioners, and its verification."""

from collections.abc import Callable, Sequence
from typing import Annotated, Any

import numpy
from numpy.typing import NDArray


class Bodies:
    """Bodies of a focal plane: capsules fixed to arms, and what is fixed."""

    def __init__(self, arms: Annotated[NDArray[numpy.float64], dict(shape=(None, 5), order='C', device='cpu', writable=False)], parts: Annotated[NDArray[numpy.float64], dict(shape=(None, 8), order='C', device='cpu', writable=False)], obstacles: Annotated[NDArray[numpy.float64], dict(shape=(None, 7), order='C', device='cpu', writable=False)]) -> None:
        """
        arms (N, 5): centre x, y in mm, l_alpha in mm, alpha_off, beta_off in rad. parts (P, 8), in any order, at least one for each positioner: its index, the arm (0 alpha, 1 beta), x0, y0, x1, y1 in its frame and radius in mm, with the collision buffer, and layers. obstacles (K, 7): x0, y0, x1, y1, radius in mm, layers, and the index of the positioner whose uncertain place it covers, or -1. Layers: an integer of which each bit is a height; what has none in common cannot touch. ValueError where one is not from 1 to 2^32 - 1, or an index is not of a positioner.
        """

class Task:
    """What a plan must do."""

    def __init__(self, start: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order='C', device='cpu', writable=False)], goal: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order='C', device='cpu', writable=False)], approach: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], fixed: Annotated[NDArray[numpy.bool_], dict(shape=(None,), order='C', device='cpu', writable=False)], travel: Annotated[NDArray[numpy.float64], dict(shape=(2, 2), order='C', device='cpu', writable=False)]) -> None:
        """
        start, goal (N, 2) in rad; approach (N,): rad above the goal, on both axes, from which the last leg starts; fixed (N,): cannot move; travel [[alpha_min, alpha_max], [beta_min, beta_max]] in rad. ValueError where the numbers of rows differ.
        """

    def may_shorten(self, least: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> None:
        """
        Approaches that would touch may be shortened to this, rad (N,). Without it none may.
        """

    def set_sides(self, sides: Sequence[float]) -> None:
        """
        From which side of their goals alpha and beta come: 1 from above, -1 from below.
        """

    def set_travels(self, travels: Annotated[NDArray[numpy.float64], dict(shape=(None, 2, 2), order='C', device='cpu', writable=False)]) -> None:
        """The room of each positioner (N, 2, 2), instead of that of all, rad."""

    def set_paces(self, speed: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], acceleration: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> None:
        """
        Speed in rad/s and acceleration in rad/s2 of each positioner (N,), instead of the settings'. ValueError where the numbers of rows differ.
        """

class Settings:
    """Speeds, and how hard the planner tries."""

    def __init__(self, *, speed: float, acceleration: float, grid: float) -> None:
        """rad/s, rad/s2, and the widest step of the search grid in rad."""

    @property
    def clearance_mm(self) -> float:
        """kept beyond touching"""

    @clearance_mm.setter
    def clearance_mm(self, arg: float, /) -> None: ...

    @property
    def in_hand_mm(self) -> float:
        """kept beyond that by an arm on its way"""

    @in_hand_mm.setter
    def in_hand_mm(self, arg: float, /) -> None: ...

    @property
    def late_s(self) -> float:
        """
        any one positioner may be late by so much, the others being on time; inf: it stops for good
        """

    @late_s.setter
    def late_s(self, arg: float, /) -> None: ...

    @property
    def first_deadline(self) -> float:
        """over the time that the longest path needs"""

    @first_deadline.setter
    def first_deadline(self, arg: float, /) -> None: ...

    @property
    def last_deadline(self) -> float:
        """beyond this a positioner is given up"""

    @last_deadline.setter
    def last_deadline(self, arg: float, /) -> None: ...

    @property
    def effort(self) -> float:
        """scales how long the repair goes on"""

    @effort.setter
    def effort(self, arg: float, /) -> None: ...

    @property
    def most_points(self) -> int:
        """of an axis over the bus, where that keeps all clear"""

    @most_points.setter
    def most_points(self, arg: int, /) -> None: ...

    @property
    def approach_turns(self) -> int:
        """
        positioners may come down to their goals in so many turns, if they must; 1: all together
        """

    @approach_turns.setter
    def approach_turns(self, arg: int, /) -> None: ...

    @property
    def seed(self) -> int: ...

    @seed.setter
    def seed(self, arg: int, /) -> None: ...

    def tell(self, watch: Callable[[str, int, int], None]) -> None:
        """
        While a plan is made, `watch` is called with the name of a stage, how many of its parts are done, and of how many. It must not raise.
        """

    def end_when(self, enough: Callable[[], bool]) -> None:
        """
        While a plan is made, `enough` is called often: whether it shall come to an end. It must not raise.
        """

def clock(task: Task, settings: Settings) -> tuple[float, list[float], int]:
    """
    The common clock of a plan: quarter of a step in s, widest move of each positioner in a step in rad, and how many quarters an approach lasts.
    """

def plan(bodies: Bodies, task: Task, settings: Settings) -> tuple[list[Annotated[NDArray[numpy.float64], dict(shape=(None, 3))]], list[tuple[int, str, int, int]], dict[str, Any], list[tuple[int, list[float], list[float]]]]:
    """
    Motions (list of (n, 3): time_s, alpha_rad, beta_rad); positioners that do not arrive (index, why, other or -1, obstacle or -1); statistics; positioners that do not come to their goals as all others do (index, last leg of alpha, of beta: height in rad, begin and end in s).
    """

class Rules:
    """What a plan is held to."""

    def __init__(self, *, speed: float, acceleration: float, rounding: float, travel: Annotated[NDArray[numpy.float64], dict(shape=(2, 2), order='C', device='cpu', writable=False)]) -> None:
        """
        rad/s, rad/s2, by how many rad angles may be off, and [[alpha_min, alpha_max], [beta_min, beta_max]] in rad.
        """

    def expect(self, start: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order='C', device='cpu', writable=False)], goal: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order='C', device='cpu', writable=False)], arrives: Annotated[NDArray[numpy.bool_], dict(shape=(None,), order='C', device='cpu', writable=False)], approach: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> None:
        """
        Also check where motions start and end, rad (N, 2), the goal only where `arrives`, and the approach, rad (N,). Empty: not checked.
        """

    def say(self, robot: int, alpha: Sequence[float], beta: Sequence[float]) -> None:
        """
        Also check the last legs of one positioner (index): height above its end in rad, begin and end in s.
        """

    def set_sides(self, sides: Sequence[float]) -> None:
        """
        From which side of their goals alpha and beta come: 1 from above, -1 from below.
        """

    def set_travels(self, travels: Annotated[NDArray[numpy.float64], dict(shape=(None, 2, 2), order='C', device='cpu', writable=False)]) -> None:
        """The room of each positioner (N, 2, 2), instead of that of all, rad."""

    def set_paces(self, speed: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], acceleration: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> None:
        """
        Limits of each positioner instead of those of all: rad/s and rad/s2 (N,).
        """

    @property
    def separating(self) -> bool:
        """bodies that overlap at the start may move if they only move apart"""

    @separating.setter
    def separating(self, arg: bool, /) -> None: ...

def verify(bodies: Bodies, motions: Sequence[Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)]], rules: Rules) -> dict[str, Any]:
    """
    Proof in continuous time for motions (n, 3): time_s, alpha_rad, beta_rad. Violations are (fault, robot, other, time_s, depth in mm, rad, rad/s or rad/s2).
    """

def lateness(bodies: Bodies, motions: Sequence[Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)]], late: float) -> tuple[list[tuple[int, int, float, float, float, float]], int]:
    """
    Proof in continuous time for motions (n, 3): time_s, alpha_rad, beta_rad, of which one is late. Pairs that touch at some lateness: (which is late, other, the lateness that they bear in s, moment of the plan at which the late one is, and the other, in s, depth in mm; both of no more than `late` s where they touch then); and how many pairs both move and can meet, each order for itself. ValueError for motions that are not sound.
    """

def conflicts(bodies: Bodies, goals_rad: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order='C', device='cpu', writable=False)], approach_rad: float | Sequence[float]) -> Annotated[NDArray[numpy.int32], dict(shape=(None, 2))]:
    """
    Pairs (P, 2) of positioners that touch at their goals (N, 2) or on the approach that all make together: rad above both axes, or of alpha and beta with the sign of each.
    """

def static_ok(bodies: Bodies, rows: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], goals_rad: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order='C', device='cpu', writable=False)], approach_rad: float | Sequence[float]) -> Annotated[NDArray[numpy.bool_], dict(shape=(None,))]:
    """
    For positioners (n,) by index, which may repeat: whether goal (n, 2) and approach are clear of obstacles.
    """

def pairs_clear(bodies: Bodies, rows: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], goals_rad: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order='C', device='cpu', writable=False)], other_rows: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], other_goals_rad: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order='C', device='cpu', writable=False)], approach_rad: float | Sequence[float]) -> Annotated[NDArray[numpy.bool_], dict(shape=(None,))]:
    """
    One by one: whether two positioners (n,) by index, which may repeat, stay apart at their goals (n, 2) and on the approach.
    """
