"""The results of an observation: summary.json, fibres.ecsv, trajectories.json, figures."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from astropy import units as u
from astropy.table import QTable, Table, vstack
from numpy.typing import NDArray

from fiberloom.assignment import Assignment
from fiberloom.errors import InputError
from fiberloom.health.status import FAULTS, FibreFlag, FibreStatus, grade
from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.operation.move import Move
from fiberloom.report.figures import new_axes
from fiberloom.report.focal_plane import (
    FieldPicture,
    draw_focal_plane,
    errors_title,
    frame_positioners,
    plot_errors,
    plot_focal_plane,
)
from fiberloom.report.outputs import prepare_folder
from fiberloom.richtext import html_rows
from fiberloom.tables import write_summed
from fiberloom.targets import TargetList
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import UM_PER_MM
from fiberloom.wholefile import write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKS = ("version", "seed", "instrument", "config_hash", "utc")
"""Entries that every result file has."""

_UNITS = {"mm": u.mm, "deg": u.deg, "um": u.um}

TRULY_OFF = "truly_off_target"
"""On target as measured, not in truth: the twin knows."""

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
        draw_focal_plane(axes, self.plane, _picture(self))
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

    def true_metrology_error_um(self, move: Move) -> Floats | None:
        """True distance of the metrology fibres from where the camera is to see them.

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
        return _apart_um(move.true_metrology_mm, self.metrology_goal_mm())

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


def summarise(observed: Observation) -> dict[str, Any]:
    """The figures of summary.json that come from the moves."""
    final = observed.final
    assigned = observed.assignment.n_assigned
    within = int(observed.on_target(final).sum())
    return {
        "n_positioners": len(observed.plane),
        "n_targets": len(observed.targets),
        "n_assigned": assigned,
        "n_valid": int(observed.counted(final).sum()),
        "n_within_requirement": within,
        "share_within_requirement": within / assigned if assigned else 0.0,
        "requirement_um": observed.requirement_um,
        "collisions_verified": observed.collisions_verified,
        "plan_cpu_s": sum(m.plan.cpu_s for m in observed.moves),
        "motion_s": sum(m.motion_s for m in observed.moves if not m.comparison),
        "stopped": observed.stopped,
        "moves": [_summarise_move(observed, move) for move in observed.moves],
        "faults": _faults(observed, final),
        "not_on_target": _not_on_target(observed, final),
    }


def _not_on_target(observed: Observation, move: Move) -> dict[str, int]:
    """How many of the assigned fibres are not on target, by their status; the most frequent first."""
    missed = (observed.assignment.target >= 0) & ~observed.on_target(move)
    why = [TRULY_OFF if status is FibreStatus.ON_TARGET else status.value for status in move.status]
    return dict(Counter(np.array(why, dtype=object)[missed].tolist()).most_common())


def _summarise_move(observed: Observation, move: Move) -> dict[str, Any]:
    counted = observed.counted(move)
    measured = move.measured_error_um[counted]
    true, metrology = observed.true_error_um(move), observed.true_metrology_error_um(move)
    error = observed.error_um(move)[counted]
    return {
        "move": move.number,
        "label": move.label,
        "interrupted": move.interrupted,
        "comparison": move.comparison,
        "motion_s": move.motion_s,
        "n_fibres": int(counted.sum()),
        "n_within_requirement": int((error <= observed.requirement_um).sum()),
        "measured_rms_um": _rms(measured),
        "true_metrology_rms_um": None if metrology is None else _rms(metrology[counted]),
        "true_rms_um": None if true is None else _rms(true[counted]),
        "p95_um": _percentile(error, 95),
        "max_um": _percentile(error, 100),
    }


def _rms(values: Floats) -> float | None:
    good = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(good**2))) if len(good) else None


def _percentile(values: Floats, share: float) -> float | None:
    good = values[np.isfinite(values)]
    return float(np.percentile(good, share)) if len(good) else None


def _faults(observed: Observation, move: Move) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {}
    for positioner, status in zip(observed.plane.positioner_id, move.status, strict=True):
        if status in FAULTS or status is FibreStatus.BLOCKED:
            found.setdefault(status.value, []).append(int(positioner))
    return found


def fibres_table(observed: Observation) -> Table:
    """One row for every positioner and move, with the columns of docs/files.md."""
    return vstack([_fibres_of(observed, move) for move in observed.moves])


def _fibres_of(observed: Observation, move: Move) -> Table:
    plane, assignment = observed.plane, observed.assignment
    target, goal = observed.target_mm(), observed.metrology_goal_mm()
    names = np.append(observed.targets.target_id, "")  # index -1: no target
    nothing = np.full((len(plane), 2), np.nan)
    true, true_um = move.true_mm, observed.true_error_um(move)
    seen = move.measurement.seen
    return Table(
        {
            "positioner_id": plane.positioner_id,
            "fibre": assignment.fibre,
            "target_id": names[assignment.target],
            "move": np.full(len(plane), move.number),
            **_pair("target", target),
            "alpha_deg": assignment.alpha_deg,
            "beta_deg": assignment.beta_deg,
            **_pair("metrology_goal", goal),
            **_pair("measured", np.where(seen[:, None], move.measurement.xy_mm, np.nan)),
            **_pair("true", nothing if true is None else true),
            "measured_error_um": move.measured_error_um,
            "true_error_um": nothing[:, 0] if true_um is None else true_um,
            "error_um": observed.error_um(move),
            "status": np.array([status.value for status in move.status]),
            "grade": _grades(observed, move),
            "flags": _flags(observed, move),
        }
    )


def _pair(name: str, xy_mm: Floats) -> dict[str, Floats]:
    return {f"x_{name}_mm": xy_mm[:, 0], f"y_{name}_mm": xy_mm[:, 1]}


def _grades(observed: Observation, move: Move) -> NDArray[np.str_]:
    has = (observed.assignment.target >= 0).tolist()
    errors = observed.error_um(move).tolist()
    return np.array([grade(e, observed.requirement_um, h) for e, h in zip(errors, has, strict=True)])


def _flags(observed: Observation, move: Move) -> Ints:
    """(N,) bits of `FibreFlag`."""
    flags = np.array([_OF_STATUS.get(status, 0) for status in move.status], dtype=np.int64)
    ambiguous = move.measurement.ambiguous
    for flag, where in (
        (FibreFlag.NO_TARGET, observed.assignment.target < 0),
        (FibreFlag.NOT_SEEN, ~move.measurement.seen),
        (FibreFlag.AMBIGUOUS, np.zeros(len(flags), dtype=bool) if ambiguous is None else ambiguous),
        (FibreFlag.OFF_TARGET, observed.error_um(move) > observed.requirement_um),
        (FibreFlag.INTERRUPTED, np.full(len(flags), move.interrupted)),
        (FibreFlag.COMPARISON, np.full(len(flags), move.comparison)),
    ):
        flags |= np.where(where, int(flag), 0)
    return flags


_OF_STATUS = {
    status: int(FibreFlag[status.name]) for status in FibreStatus if status.name in FibreFlag.__members__
}


def write_results(observed: Observation, summary: Mapping[str, Any], out: Path) -> None:
    """Writes every result file into the folder `out`, which exists."""
    table = fibres_table(observed)
    table.meta = {k: summary[k] for k in MARKS}
    table.meta["flags"] = {flag.name: int(flag) for flag in FibreFlag}
    write_summed(out / "fibres.ecsv", table)
    plans = {"plans": [move.plan.to_dict() for move in observed.moves]}
    plans |= {k: summary[k] for k in MARKS}
    write_whole(out / "trajectories.json", json.dumps(plans) + "\n")
    _plot(observed, out)
    # last: where it is, all are
    write_whole(out / "summary.json", json.dumps(summary, indent=2) + "\n")


def _plot(observed: Observation, out: Path) -> None:
    plot_focal_plane(out / "focal_plane.png", observed.plane, _picture(observed))
    ended = [move for move in observed.moves if not move.interrupted]
    errors = [observed.error_um(m)[observed.counted(m)] for m in ended]
    own = [error for error, m in zip(errors, ended, strict=True) if not m.comparison]
    plot_errors(
        out / "errors.png",
        errors,
        [f"move {m.number} ({m.label})" for m in ended],
        observed.requirement_um,
        errors_title(own, observed.assignment.n_assigned, observed.requirement_um),
    )


def _picture(observed: Observation) -> FieldPicture:
    final = observed.final
    error = observed.error_um(final)
    counted = observed.counted(final)
    flagged = np.array([s in FAULTS or s is FibreStatus.BLOCKED for s in final.status])
    within = int(observed.on_target(final).sum())
    title = (
        f"{within} of {observed.assignment.n_assigned} assigned fibres within {observed.requirement_um:g} µm "
        f"after move {final.number}"
        + (f"; {int(flagged.sum())} positioners flagged" if flagged.any() else "")
    )
    return FieldPicture(
        final.commanded_deg, np.where(counted, error, np.nan), flagged, observed.requirement_um, title
    )
