"""Kinds of faults, and which command can act on which. Nothing heavy is imported: a refusal is quick."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class FaultKind(StrEnum):
    """Faults of the hardware of one positioner, and what acts."""

    DEAD = "dead"  # no supply at the bridges: the motor does not turn
    LYING = "lying"  # the motor turns, the arm does not follow: the firmware reports arrival
    DARK = "dark"  # the camera does not see the fibre
    STUCK_HALL = "stuck_hall"  # the hall channels repeat what they showed
    BLOCKED = "blocked"  # the rotor cannot turn
    DEAF = "deaf"  # frames to it are lost
    MUTE = "mute"  # frames from it are lost
    NO_START = "nostart"  # it misses one START
    REFUSE = "refuse"  # it answers one START with an error, and stays
    REBOOT = "reboot"  # it restarts in its bootloader at one START


PER_POSITIONER = frozenset(set(FaultKind) - {"dead", "lying", "stuck_hall", "blocked"})
"""Kinds that are the same for both axes."""


class ServiceKind(StrEnum):
    """Faults of supply and bus, where a twin is served in real time."""

    POWER_CUT = "powercut"  # the positioner restarts in its bootloader when power is back
    CUT = "cut"  # a gateway's connection is cut; it takes none meanwhile
    BUS_OFF = "busoff"  # a CAN port neither sends nor receives
    LOST = "lost"  # a share of the replies does not arrive
    LATE = "late"  # a share of the replies arrives later


SHARES = frozenset({ServiceKind.LOST, ServiceKind.LATE})
"""Kinds that act on a share of the replies, not on a positioner."""


class CameraFaultKind(StrEnum):
    """Faults of the camera, where a twin is served with one."""

    HANG = "camera_hang"  # an exposure that begins never ends
    ERROR = "camera_error"  # answers 500 to every request; writes no file
    HALF = "camera_half"  # half of the image, then nothing
    STALE = "camera_stale"  # hands out the image before, or one of yesterday


class AilmentKind(StrEnum):
    """Faults that come with age, and how they show."""

    BROKEN_TOOTH = "broken_tooth"  # a jump of the map over one tooth pairing, at once
    STUCK = "stuck"  # the axis does not move; the firmware reports a collision
    NON_MOVES = "non_moves"  # some moves do not happen; the firmware reports arrival
    LOOSE_ARM = "loose_arm"  # the beta arm's length differs from move to move, more and more
    WEAK_HALL = "weak_hall"  # a hall channel fades: positions waver with the motor turn, then it stalls
    SLIPPING = "slipping"  # the arm makes a share of the way, another one in each direction
    FRICTION = "friction"  # grows until the motor stalls
    DARK = "dark"  # the camera does not see the fibre


class WiringKind(StrEnum):
    """Faults of plugs, where units know their own numbers."""

    SWAPPED = "swapped"  # its plug and that of its nearest neighbour are exchanged


@dataclass(frozen=True)
class Reach:
    """The faults that a command can act on."""

    kinds: tuple[str, ...]
    timed: bool = False
    """Whether faults may begin and end while the command runs (@START, +DURATION)."""


OBSERVED = Reach((*sorted(FaultKind), ServiceKind.LOST), timed=True)
"""`observe`, `calibrate focal-plane` and the bench: a camera looks; one bus without gateways."""
SERVED = Reach((*sorted(set(FaultKind) - {FaultKind.DARK}), *ServiceKind), timed=True)
"""`twin`: no camera looks, but there is a bus and a clock."""
SEEN = Reach((*sorted(FaultKind), *ServiceKind, *CameraFaultKind), timed=True)
"""`twin` with a camera."""
AGED = Reach(tuple(sorted(AilmentKind)))
"""`lifetime`: faults begin half-way through the cycles."""
ANYWHERE = Reach(
    tuple(sorted({*FaultKind, *ServiceKind, *CameraFaultKind, *AilmentKind, *WiringKind})), timed=True
)
"""All that the grammar knows."""
