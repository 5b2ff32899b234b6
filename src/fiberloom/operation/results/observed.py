"""What an observed field is, and how far its fibres are from where they should be."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fiberloom.assignment import Assignment
from fiberloom.calibration.fibres.guider import guided
from fiberloom.health.status import FAULTS, FibreStatus
from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.operation.move import Move
from fiberloom.targets import TargetList
from fiberloom.typing import Flags, Floats
from fiberloom.units import UM_PER_MM

NOT_COUNTED = FAULTS | {FibreStatus.PARKED, FibreStatus.OFFLINE, FibreStatus.BLOCKED}
"""Status of a positioner whose error does not count."""


@dataclass(frozen=True)
class ObservedField:
    """The moves of an observed field, and the errors of its fibres: what `Observation` tells of."""

    plane: FocalPlane
    targets: TargetList
    assignment: Assignment
    moves: list[Move]
    collisions_verified: int = 0
    contacts_true: int | None = None
    stopped: str = ""
    about: dict[str, Any] = field(default_factory=dict)
    wall_s: float = 0.0

    @property
    def requirement_um(self) -> float:
        """Largest error that the instrument accepts."""
        return self.plane.instrument.operation.requirement_um

    def target_mm(self, move: Move | None = None) -> Floats:
        """Where the science fibre of each positioner should be.

        Parameters
        ----------
        move : Move, optional
            One of `moves`: in a series of exposures targets on the sky go from where the list has them.

        Returns
        -------
        (N, 2) float
            mm; NaN without a target.

        Examples
        --------
        >>> import fiberloom as fl
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
        >>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1)
        >>> seen.target_mm().shape
        (7, 2)
        """
        if move is not None and move.target_mm is not None:
            return move.target_mm
        xy = np.full((len(self.plane), 2), np.nan)
        has = self.assignment.target >= 0
        chosen = self.assignment.target[has]
        xy[has] = np.stack([self.targets.x_mm[chosen], self.targets.y_mm[chosen]], axis=1)
        return xy

    def star_mm(self, move: Move) -> Floats:
        """Where the target of each positioner truly was: only a twin knows how its telescope points.

        Parameters
        ----------
        move : Move
            One of `moves`.

        Returns
        -------
        (N, 2) float
            mm; NaN without a target; `target_mm` where nothing is known, or the telescope points as it
            should.

        Examples
        --------
        >>> import fiberloom as fl
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
        >>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1)
        >>> bool((seen.star_mm(seen.final) == seen.target_mm()).all())
        True
        """
        return self.target_mm(move) if move.star_mm is None else move.star_mm

    def metrology_goal_mm(self, move: Move | None = None) -> Floats:
        """Where the camera is to see the metrology fibre of each positioner with the science fibre on target.

        Parameters
        ----------
        move : Move, optional
            One of `moves`: as far as the images before it have told how each arm is off. When left out:
            at the angles of the assignment.

        Returns
        -------
        (N, 2) float
            mm; NaN without a target. The measured error is the distance of the measured place from it.

        Examples
        --------
        >>> import fiberloom as fl
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
        >>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1)
        >>> seen.metrology_goal_mm().shape
        (7, 2)
        """
        goal_mm = metrology_goals_mm(self.plane, self.assignment)
        if move is None or move.metrology_goal_mm is None:
            return goal_mm
        return np.where(np.isfinite(goal_mm), move.metrology_goal_mm, np.nan)

    def true_error_um(self, move: Move) -> Floats | None:
        """True distance of the science fibres from their targets.

        Parameters
        ----------
        move : Move
            One of `moves`.

        Returns
        -------
        (N,) float or None
            um; NaN without a target; None where the truth is not known: on hardware.

        Examples
        --------
        >>> import fiberloom as fl
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
        >>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1)
        >>> import numpy as np
        >>> bool(np.nanmax(seen.true_error_um(seen.moves[-1])) < 5.0)
        True
        """
        return _apart_um(move.true_mm, self.star_mm(move))

    def guided_error_um(self, move: Move) -> Floats | None:
        """True distance of the science fibres from their stars, on a telescope that guides by them.

        Shift, rotation and scale of the whole field are the guider's: they are taken out of the true errors
        of the healthy fibres.

        Parameters
        ----------
        move : Move
            One of `moves`.

        Returns
        -------
        (N,) float or None
            um; NaN without a target; None where the truth is not known: on hardware.

        Examples
        --------
        >>> import fiberloom as fl
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
        >>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1)
        >>> len(seen.guided_error_um(seen.final))
        7
        """
        if move.true_mm is None:
            return None
        star_mm = self.star_mm(move)
        place_mm = np.where(np.isfinite(star_mm), star_mm, self.plane.centres_mm)
        left_mm = guided(move.true_mm - star_mm, place_mm, self.counted(move))
        return np.asarray(UM_PER_MM * np.hypot(*left_mm.T))

    def true_metrology_error_um(self, move: Move) -> Floats | None:
        """True distance of the metrology fibres from their places with the science fibres on target.

        Parameters
        ----------
        move : Move
            One of `moves`.

        Returns
        -------
        (N,) float or None
            um; NaN without a target; None where the truth is not known: on hardware.

        Examples
        --------
        >>> import fiberloom as fl
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
        >>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1)
        >>> len(seen.true_metrology_error_um(seen.final))
        7
        """
        return _apart_um(move.true_metrology_mm, self.metrology_goal_mm(move) + self.frame_mm())

    def frame_mm(self) -> Floats:
        """From where the camera is to see a fibre to where that is: how far its frame is known to be off.

        Returns
        -------
        (N, 2) float
            mm; NaN without a target; 0 without `fibres` of a calibration.

        Examples
        --------
        >>> import fiberloom as fl
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
        >>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1)
        >>> import numpy as np
        >>> bool(np.abs(seen.frame_mm()).max() < 1e-9)
        True
        """
        angles = self.assignment
        aimed = np.full((len(self.plane), 2), np.nan)
        for fibre in np.unique(angles.fibre[angles.target >= 0]).tolist():
            rows = (angles.target >= 0) & (np.asarray(angles.fibre) == fibre)
            aimed[rows] = self.plane.forward(angles.alpha_deg, angles.beta_deg, fibre)[rows]
        known_mm: Floats = self.target_mm() + self.lead_mm() - aimed
        return known_mm

    def lead_mm(self) -> Floats:
        """By which the science fibres are placed beside their targets, for what moves them later.

        Returns
        -------
        (N, 2) float
            mm; 0 without `gravity` of a calibration.

        Examples
        --------
        >>> import fiberloom as fl
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
        >>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1)
        >>> bool(seen.lead_mm().any())
        False
        """
        lead_mm = self.assignment.lead_mm
        return np.zeros((len(self.plane), 2)) if lead_mm is None else lead_mm

    def worst_error_um(self, move: Move) -> Floats | None:
        """True distance of the science fibres from their targets, the largest during the exposure.

        Parameters
        ----------
        move : Move
            One of `moves`.

        Returns
        -------
        (N,) float or None
            um, of its begin, middle and end; NaN without a target; None where the truth or the pointing is
            not known.

        Examples
        --------
        >>> import fiberloom as fl
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
        >>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1)
        >>> seen.worst_error_um(seen.final) is None
        True
        """
        middle_um = self.true_error_um(move)
        if middle_um is None or move.true_ends_mm is None:
            return None
        ends_um = UM_PER_MM * np.linalg.norm(move.true_ends_mm - self.star_mm(move), axis=2)
        return np.asarray(np.maximum(middle_um, ends_um.max(axis=0)))

    def error_um(self, move: Move) -> Floats:
        """True error where it is known, else the measured one.

        Parameters
        ----------
        move : Move
            One of `moves`.

        Returns
        -------
        (N,) float
            um; NaN without a target, or where nothing was seen.

        Examples
        --------
        >>> import fiberloom as fl
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
        >>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1)
        >>> len(seen.error_um(seen.final))
        7
        """
        true = self.true_error_um(move)
        return move.measured_error_um if true is None else true

    @property
    def final(self) -> Move:
        """The last move of the observation itself."""
        return next(m for m in reversed(self.moves) if not m.comparison)

    def counted(self, move: Move) -> Flags:
        """Positioners with a target that are healthy.

        Parameters
        ----------
        move : Move
            One of `moves`.

        Returns
        -------
        (N,) bool

        Examples
        --------
        >>> import fiberloom as fl
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
        >>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1)
        >>> int(seen.counted(seen.final).sum())
        7
        """
        return np.array([status not in NOT_COUNTED for status in move.status])

    def on_target(self, move: Move) -> Flags:
        """Positioners that are healthy and whose fibre is within the requirement of its target.

        Parameters
        ----------
        move : Move
            One of `moves`.

        Returns
        -------
        (N,) bool
            By the true error where it is known, else by the measured one.

        Examples
        --------
        >>> import fiberloom as fl
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
        >>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1)
        >>> int(seen.on_target(seen.final).sum())
        7
        """
        return self.counted(move) & (self.error_um(move) <= self.requirement_um)


def _apart_um(true_mm: Floats | None, goal_mm: Floats) -> Floats | None:
    """(N,) um between places (N, 2); None where the true ones are not known."""
    return None if true_mm is None else np.asarray(UM_PER_MM * np.hypot(*(true_mm - goal_mm).T))


def metrology_goals_mm(plane: FocalPlane, assignment: Assignment) -> Floats:
    """(N, 2) mm: where each metrology fibre is when the science fibre is on its target; NaN without one."""
    at = plane.forward(assignment.alpha_deg, assignment.beta_deg, METROLOGY)
    return np.where((assignment.target >= 0)[:, None], at, np.nan)
