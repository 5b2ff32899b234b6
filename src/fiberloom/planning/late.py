"""Proof that a plan stays free of collisions if one positioner is late: other code than the planner's."""

import math
from dataclasses import dataclass

from fiberloom._core import planning as core
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.planning.bodies import CollisionBodies
from fiberloom.planning.trajectories import Plan
from fiberloom.planning.verification import motions_rad


@dataclass(frozen=True)
class LatePair:
    """One positioner that touches another one if it is late; the other is on time."""

    late_id: int
    other_id: int
    bears_s: float
    """No lateness below this makes them touch; one that is 0.001 s longer does."""
    late_at_s: float
    """Where the late one is then: at this moment of the plan ..."""
    other_at_s: float
    """... and the other one at this. The deepest of all moments that are no later than was asked for; the
    first touch where that is later."""
    depth_mm: float
    """How deep the buffers overlap, to 0.01 mm; 0 where they touch only if it is later than was asked for."""

    def __str__(self) -> str:
        return (
            f"positioner {self.late_id} meets {self.other_id} if it is late by {self.bears_s:.2f} s, "
            f"{self.depth_mm:.2f} mm deep when it is where it shall be at {self.late_at_s:.2f} s and the "
            f"other at {self.other_at_s:.2f} s"
        )


@dataclass(frozen=True)
class LateVerification:
    """What a plan bears. `ok`: any one positioner may be late by so much, and touches no other."""

    late_s: float
    """What was asked for; inf: one stops on its way and stays, the others go on to the end."""
    touching: tuple[LatePair, ...]
    """Those that touch at some lateness, whatever was asked for."""
    n_pairs: int
    """Positioners that both move and can meet."""

    @property
    def ok(self) -> bool:
        """Does every pair bear it?"""
        return not self.failing

    @property
    def failing(self) -> tuple[LatePair, ...]:
        """Those that touch within the lateness asked for; the least lateness first."""
        return tuple(sorted((p for p in self.touching if p.bears_s <= self.late_s), key=lambda p: p.bears_s))

    @property
    def failing_pairs(self) -> tuple[tuple[int, int], ...]:
        """The same as pairs of positioner_id, the lower one first, whichever of the two is late."""
        pairs = {(min(p.late_id, p.other_id), max(p.late_id, p.other_id)) for p in self.failing}
        return tuple(sorted(pairs))

    @property
    def bears_s(self) -> float:
        """The lateness of any one positioner that all pairs bear, s."""
        return min((p.bears_s for p in self.touching), default=math.inf)

    def __str__(self) -> str:
        n, of = len(self.failing_pairs), f"of {self.n_pairs} that can meet"
        late = "of any length" if math.isinf(self.late_s) else f"of up to {self.late_s:g} s"
        but = f"in all pairs but {n} {of}" if n else f"in all pairs {of}"
        worst = f"; {self.failing[0]}" if n else ""
        return f"bears a lateness {late} of any one positioner {but}{worst}"


def require_late(name: str, late_s: float) -> None:
    """Raises InputError for a lateness that is none; inf is one."""
    if not late_s >= 0.0:
        raise InputError(f"{name} {late_s:g}: must be a number of seconds from 0 on, or inf")


def verify_late(plane: FocalPlane, plan: Plan, late_s: float = math.inf) -> LateVerification:
    """Prove in continuous time what a plan bears if any one positioner is late, all others being on time.

    A positioner that is late is where the plan has it at some moment t when the others are where the plan has
    them at s, 0 <= s - t <= late_s. Before its start it is at its start, after its end at its goal. Whatever
    is at rest is no matter: `verify` has seen it. So of each two positioners that move, all such moments are
    looked at, in both orders. Gaps are of the plan's own collision buffer, proven above -1e-6 mm.

    Parameters
    ----------
    plane : FocalPlane
        N positioners.
    plan : Plan
        What is to be proven.
    late_s : float
        How late one may be, s; inf: it stops on its way and stays there.

    Returns
    -------
    LateVerification
        The pairs that touch within late_s, which of them is late, where both are then, how deep in mm; and
        the lateness that each pair bears, s.

    Raises
    ------
    InputError
        late_s is negative or no number; times that do not rise; or as `verify`.

    Examples
    --------
    >>> import fiberloom as fl
    >>> from fiberloom.planning import verify_late
    >>> plane = fl.FocalPlane.of("sdssv", n=7)
    >>> made = fl.plan(plane, plane.park_deg, plane.park_deg - [0.0, 30.0])
    >>> print(verify_late(plane, made))
    bears a lateness of any length of any one positioner in all pairs of 12 that can meet
    """
    require_late("late_s", late_s)
    bodies = CollisionBodies.of(plane, plan.collision_buffer_mm)
    motions = motions_rad(plane, plan)
    try:
        found, looked_at = core.lateness(bodies.compiled, motions, late_s)
    except ValueError as error:
        raise InputError(f"the plan cannot be looked at: {error}") from None
    names = plane.positioner_id
    touching = tuple(LatePair(int(names[i]), int(names[j]), *rest) for i, j, *rest in found)
    return LateVerification(late_s, touching, looked_at // 2)
