"""The drive port: all that operation asks of the motors of an array, whatever they are.

A plan is what is wanted. A programme is what the motors are told, with the way that arms will really go and
how far they may be from it: that is what the verifier checks, not the plan. Some drives report where they
are; others add up what they were told, and the camera corrects them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from fiberloom.bus.motion import MotionWatch
from fiberloom.bus.outcome import Results
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.axis import DriveTable
from fiberloom.instruments.handicaps import Handicaps
from fiberloom.metrology import Measurement
from fiberloom.metrology.noise import CorrectionNoise
from fiberloom.planning import Plan, Verification, verify
from fiberloom.typing import Flags, Floats, Ints

_SAID = DriveTable()
"""Where no instrument is named."""


@dataclass(frozen=True)
class DriveModel:
    """How good the moves of a drive are. Correction, judgement and begin check use it."""

    noise: CorrectionNoise
    """Of blind moves, arrivals and the camera, for the correction."""
    astray_mm: float = _SAID.astray_mm
    """Beyond this from where it is believed after a move, a positioner is not there."""
    astray_share: float = _SAID.astray_share
    """The same, of the way that its fibre went: added to `astray_mm`."""
    still_share: float = _SAID.still_share
    """A positioner that moved less than this share of its way did not move."""
    scatter_mm: float = _SAID.scatter_mm
    """Of healthy positioners about where they are believed to be, per coordinate."""
    allowed_mm: float = _SAID.allowed_mm
    """How far an arm may be from where it is believed, to be let move at all."""
    step_deg: tuple[float, float] = (0.0, 0.0)
    """Smallest steps of alpha and beta, of which corrections are made; 0: the drive itself sees to it."""
    seen_is_believed: bool = False
    """After an image the drive believes what it shows: it is told the goal again, not a correction of it."""
    blind: bool = False
    """No camera looks while the instrument observes: what an image shows scores, and decides nothing."""
    reports: bool = True
    """Positioners tell where they are; else the drive adds up what it has told them."""

    @classmethod
    def of(cls, plane: FocalPlane, **others: Any) -> DriveModel:
        """As the instrument's file says; `others`: fields that the drive knows itself."""
        said = plane.instrument.drive
        known = {
            "astray_mm": said.astray_mm,
            "astray_share": said.astray_share,
            "still_share": said.still_share,
            "scatter_mm": said.scatter_mm,
            "allowed_mm": said.allowed_mm,
            "blind": not plane.instrument.metrology.present,
        }
        return cls(CorrectionNoise.of(plane), **(known | others))

    def astray_of_mm(self, way_mm: Floats) -> Floats:
        """(N,) mm beyond which one whose fibre went `way_mm` (N,) is astray."""
        return np.asarray(self.astray_mm + self.astray_share * np.nan_to_num(way_mm))


@dataclass(frozen=True, eq=False)
class Wanted:
    """A move that is asked for. Arrays over N positioners."""

    obstacles: FocalPlane
    """The focal plane, with those that do not move as obstacles where they are."""
    here_deg: Floats
    """(N, 2) where they are believed to be."""
    goal_deg: Floats
    """(N, 2) where they shall be; as `here_deg` for one that stays."""
    approach_deg: Floats
    """(N,) overshoot of the last leg."""
    seed: int = 0
    small: bool = False
    """A correction: all straight and at once where that touches nothing."""


@dataclass(frozen=True, eq=False)
class Programme:
    """What a drive will be told, and what its arms will do then."""

    plan: Plan
    """The way that will be executed, of all N positioners."""
    tube_mm: Floats | None = None
    """(N,) how far from it an arm may be on the way, mm; None: nowhere."""
    commands: Any = None
    """The drive's own."""
    about: dict[str, Any] = field(default_factory=dict)
    """For the record."""

    def timed(self, begun_s: float) -> Programme:
        """The same, whose plan tells the CPU time since `begun_s` of `time.thread_time`."""
        return replace(self, plan=replace(self.plan, cpu_s=time.thread_time() - begun_s))

    @property
    def moving(self) -> list[int]:
        """Positioners that move."""
        return [robot.positioner_id for robot in self.plan.robots if robot.moves]


@dataclass(frozen=True, eq=False)
class BelievedPlaces:
    """Where n positioners are, as their drive has it."""

    angles_deg: Floats
    """(n, 2) of the arms."""
    wire_deg: Floats
    """(n, 2) in the drive's own angles: of the motor over its nominal gear, for the record."""
    answered: Flags
    """(n,) of which this is known."""


class Suspect(NamedTuple):
    """A positioner whose motors do not do what they are told."""

    moves: bool
    """False: it stands where it is."""
    why: str


class Drive(Protocol):
    """The motors of an array. Every positioner is named by its number in the focal plane."""

    @property
    def model(self) -> DriveModel:
        """How good its moves are."""
        ...

    @property
    def ids(self) -> list[int]:
        """Positioners that have answered, or that need not answer."""
        ...

    @property
    def time_s(self) -> float:
        """Of the bus."""
        ...

    async def sleep(self, duration_s: float) -> None:
        """Lets time pass, s."""
        ...

    async def connect(self) -> None:
        """Finds the positioners. InputError where none of the layout's answers."""
        ...

    async def rest(self, alarm: Callable[[str], None], left_moving: bool = False) -> None:
        """Brings to rest whatever still moves, as a host that was killed leaves it.

        `alarm`: told of what was found; `left_moving`: the record says that something may move.
        """
        ...

    async def believed(self, ids: Ints) -> BelievedPlaces:
        """Where these (n,) are."""
        ...

    async def heard_again(self, silent: Iterable[int]) -> list[int]:
        """Those of the `silent` that answer now."""
        ...

    async def prepare(self, wanted: Wanted) -> Programme:
        """What to tell the motors for a move. Who cannot make it is named in the plan's `refused`."""
        ...

    async def compile(self, plan: Plan) -> Programme:
        """What to tell the motors for a plan that was made elsewhere."""
        ...

    def verify(self, obstacles: FocalPlane, programme: Programme) -> Verification:
        """Proves what will be executed: by default `verified`."""
        ...

    async def run(self, programme: Programme, watch: MotionWatch, say: Callable[[str], None]) -> Results:
        """Executes it and waits for its end; how each positioner ended that moves.

        `watch`: who goes on where one does not do its part; `say`: told of a wait.
        """
        ...

    def arrived(self, goal_deg: Floats, last: bool = False) -> Flags | None:
        """(N,) whose fibres are surely within the requirement of their goals (N, 2) in deg; such a one rests.

        By all images since they moved; before the `last` correction those that a move would less likely bring
        there. None: the last image alone is what tells.
        """
        ...

    async def settle(self, ids: list[int]) -> None:
        """After a move that went wrong: stops these, and makes them ready to move again."""
        ...

    async def stop(self) -> list[int]:
        """Brings every positioner to rest that can be reached; returns which have answered."""
        ...

    def excused(self, image: Measurement) -> Flags | None:
        """(N,) of which an `image` after a move shows no fibre though they are not lost; None: none is."""
        ...

    def seen(self, image: Measurement, mobile: Flags) -> Floats | None:
        """What an image after a move shows, to learn from; `mobile` (N,): of these it may tell.

        Returns (N, 2) angles in deg where arms are believed to be now; None: as before.
        """
        ...

    def suspects(self) -> dict[int, Suspect]:
        """Positioners that again and again do not go where their motors were told, by what was seen."""
        ...

    async def close(self) -> None:
        """Lets go of the bus."""
        ...


class UnitSays(NamedTuple):
    """What a positioner says of itself, asked without moving it."""

    datum: bool | None
    """It knows its place; None: such a one never says."""
    moving: bool = False
    trouble: str = ""
    """Why it must not move; "": nothing is known against it."""


@runtime_checkable
class LooksOnly(Protocol):
    """A drive that can ask its positioners without moving any."""

    async def look(self) -> dict[int, UnitSays]:
        """What those of the layout say that answer, by number."""
        ...


class SearchesStops(Protocol):
    """A drive without encoders: its positioners are found again by their stops."""

    async def home(self, ids: Iterable[int]) -> Results:
        """Searches the stops of these, folded, all at once; how each ended. Who ends well is there."""
        ...


@runtime_checkable
class CountsSteps(Protocol):
    """A drive whose positioners count from a datum: a search of it tells what was lost since the last one."""

    def lost_steps(self) -> dict[int, str]:
        """What the latest searches have found to be lost, by number; each is told once."""
        ...

    def near_datum(self) -> Flags:
        """(N,) which have counted so near to their datum that a search finds it at once: they are folded."""
        ...


def with_tube(obstacles: FocalPlane, tube_mm: Floats | None) -> FocalPlane:
    """The plane with arms as much thicker as each may be off its way: `tube_mm` (N,), mm."""
    if tube_mm is None or not tube_mm.any():
        return obstacles
    known = obstacles.handicaps or Handicaps.none(obstacles.n)
    return replace(obstacles, handicaps=replace(known, wider_mm=known.wider_mm + tube_mm))


def verified(obstacles: FocalPlane, programme: Programme) -> Verification:
    """The independent verifier on what will be executed, with arms as thick as their tubes.

    `obstacles`: the focal plane of N positioners; `programme`: of these.
    """
    return verify(with_tube(obstacles, programme.tube_mm), programme.plan)


def none_answers(plane: FocalPlane) -> InputError:
    """The error where no positioner of a layout answers."""
    return InputError(
        f"none of the {len(plane)} positioners of this layout answers on the bus; check its power and address"
    )
