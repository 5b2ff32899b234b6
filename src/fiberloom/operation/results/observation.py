"""An observed field: its moves and the errors of its fibres."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from astropy import units as u
from astropy.table import QTable

from fiberloom.assignment import Assignment
from fiberloom.calibration.fibres.guider import guided
from fiberloom.errors import InputError
from fiberloom.health.status import FAULTS, FibreStatus
from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.operation.move import Move
from fiberloom.operation.results.files import MARKS, fibres_table, picture, write_results
from fiberloom.operation.results.summary import summarise
from fiberloom.report.figures import new_axes
from fiberloom.report.focal_plane import draw_focal_plane, frame_positioners
from fiberloom.report.outputs import prepare_folder
from fiberloom.richtext import html_rows
from fiberloom.targets import TargetList
from fiberloom.typing import Flags, Floats
from fiberloom.units import UM_PER_MM

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_UNITS = {"mm": u.mm, "deg": u.deg, "um": u.um}

NOT_COUNTED = FAULTS | {FibreStatus.PARKED, FibreStatus.OFFLINE, FibreStatus.BLOCKED}
"""Status of a positioner whose error does not count."""


@dataclass(frozen=True)
class Observation:
    """An observed field: every move, the image after it, and the errors of the fibres.

    Made by `Field.observe`.

    Attributes
    ----------
    plane : FocalPlane
        The layout by which the field was planned.
    targets : TargetList
        The targets of the observation.
    assignment : Assignment
        Which positioner took which target.
    moves : list of Move
        Blind move, corrections, and comparisons where they were asked for.
    collisions_verified : int
        Collisions that the verifier found in plans that were carried out; 0.
    stopped : str
        Why the loop made no further correction.
    about : dict
        Further entries of `summary`: version, seed, instrument, configuration hash, UTC.
    wall_s : float
        Duration of the observation, s of wall-clock time.

    Examples
    --------
    >>> import fiberloom as fl
    >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
    >>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1)
    >>> seen
    Observation('sdssv', 7 positioners, 7 with a target, 2 moves, 7 within 5 um)
    """

    plane: FocalPlane
    targets: TargetList
    assignment: Assignment
    moves: list[Move]
    collisions_verified: int = 0
    stopped: str = ""
    about: dict[str, Any] = field(default_factory=dict)
    wall_s: float = 0.0

    def __repr__(self) -> str:
        name, n = self.plane.instrument.name, len(self.plane)
        own = [move for move in self.moves if not move.comparison]
        made = f"{n} positioners, {self.assignment.n_assigned} with a target, {len(own)} moves"
        if not own:
            return f"Observation({name!r}, {made})"
        within = int(self.on_target(own[-1]).sum())
        return f"Observation({name!r}, {made}, {within} within {self.requirement_um:g} um)"

    def _repr_html_(self) -> str:
        if not self.moves:
            return html_rows(repr(self), [])
        rows = [
            {
                "move": move["label"],
                "measured rms [um]": move["measured_rms_um"],
                "metrology fibre true rms [um]": move["true_metrology_rms_um"],
                "science fibre true rms [um]": move["true_rms_um"],
                "guided rms [um]": move["guided_rms_um"],
                "95 % below [um]": move["p95_um"],
                "worst [um]": move["max_um"],
                f"within {self.requirement_um:g} um": f"{move['n_within_requirement']} of {move['n_fibres']}",
            }
            for move in self.summary()["moves"]
        ]
        return html_rows(repr(self), rows)

    def summary(self) -> dict[str, Any]:
        """The figures of the observation, as in summary.json.

        Returns
        -------
        dict
            n_positioners, n_targets, n_assigned, n_valid, n_within_requirement, requirement_um,
            share_within_requirement (of the assigned), a row for each of `moves` (errors in um, motion
            in s), `faults` by kind, `not_on_target` and `not_assigned` counted by reason, and version,
            seed, instrument, config_hash, utc of the observation.

        Examples
        --------
        >>> import fiberloom as fl
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
        >>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1)
        >>> [move["label"] for move in seen.summary()["moves"]]
        ['blind', 'correction 1']
        """
        about = dict(self.about)
        learnt = {"learnt": about.pop("learnt")} if "learnt" in about else {}
        put_in = {"put_in": about.pop("put_in")} if "put_in" in about else {}
        summary = summarise(self) | about | {"wall_s": self.wall_s, "not_assigned": self.assignment.reasons()}
        return summary | {"notes": self.assignment.notes} | put_in | learnt

    def table(self) -> QTable:
        """One row for every positioner and move, with units.

        Returns
        -------
        astropy.table.QTable
            The columns of fibres.ecsv (docs/files.md): angles in deg, positions in mm, errors in um;
            NaN where a fibre was not seen or has no target.

        Examples
        --------
        >>> import fiberloom as fl
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
        >>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1)
        >>> table = seen.table()
        >>> len(table), str(table["x_measured_mm"].unit), str(table["error_um"].unit)
        (14, 'mm', 'um')
        """
        table = QTable(fibres_table(self))
        for name in table.colnames:
            unit = _UNITS.get(name.rpartition("_")[2])
            if unit is not None:
                table[name] = table[name] * unit
        table.meta = {key: value for key, value in self.about.items() if key in MARKS}
        return table

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draws the focal plane after the last move, every fibre coloured by its error.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Where to draw; a new figure when left out.

        Returns
        -------
        matplotlib.axes.Axes
            The axes, in mm of the focal plane.

        Raises
        ------
        InputError
            Nothing has moved yet.

        Examples
        --------
        >>> import fiberloom as fl
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
        >>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1)
        >>> seen.plot().get_xlabel()
        'x [mm]'
        """
        if not self.moves:
            raise InputError("nothing to plot: no move was made")
        axes = new_axes((7.0, 6.4)) if ax is None else ax
        draw_focal_plane(axes, self.plane, picture(self))
        frame_positioners(axes, self.plane)
        return axes

    def save(self, folder: str | Path) -> None:
        """Writes summary.json, fibres.ecsv, trajectories.json and two figures.

        Parameters
        ----------
        folder : str or Path
            Created where it does not exist; files of an earlier observation are overwritten.

        Raises
        ------
        InputError
            The folder cannot be written, or nothing has moved yet.

        Examples
        --------
        >>> import fiberloom as fl
        >>> from pathlib import Path
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
        >>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1)
        >>> seen.save("night")
        >>> sorted(path.name for path in Path("night").iterdir())
        ['errors.png', 'fibres.ecsv', 'focal_plane.png', 'summary.json', 'trajectories.json']
        """
        if not self.moves:
            raise InputError("nothing to save: no move was made")
        write_results(self, self.summary(), prepare_folder(Path(folder)))

    @property
    def requirement_um(self) -> float:
        """Largest error that the instrument accepts."""
        return self.plane.instrument.operation.requirement_um

    def target_mm(self) -> Floats:
        """Where the science fibre of each positioner should be.

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
        xy = np.full((len(self.plane), 2), np.nan)
        has = self.assignment.target >= 0
        chosen = self.assignment.target[has]
        xy[has] = np.stack([self.targets.x_mm[chosen], self.targets.y_mm[chosen]], axis=1)
        return xy

    def metrology_goal_mm(self) -> Floats:
        """Where the metrology fibre of each positioner is when the science fibre is on its target.

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
        return metrology_goals_mm(self.plane, self.assignment)

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
        return _apart_um(move.true_mm, self.target_mm())

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
        star_mm = self.target_mm()
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
        return _apart_um(move.true_metrology_mm, self.metrology_goal_mm() + self.frame_mm())

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
        known_mm: Floats = self.target_mm() - aimed
        return known_mm

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
