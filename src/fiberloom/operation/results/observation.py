"""An observed field: its moves and the errors of its fibres."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fiberloom.errors import InputError
from fiberloom.operation.results.files import MARKS, fibres_columns, picture, write_results
from fiberloom.operation.results.observed import ObservedField
from fiberloom.operation.results.summary import summarise
from fiberloom.report.figures import new_axes
from fiberloom.report.focal_plane import draw_focal_plane, frame_positioners
from fiberloom.report.outputs import prepare_folder
from fiberloom.richtext import html_rows

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.axes import Axes

_UNITS = ("mm", "deg", "um")
"""At the end of the name of a column; astropy calls them so too."""


@dataclass(frozen=True)
class Observation(ObservedField):
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
    contacts_true : int or None
        Contacts of arms while they moved, as only a twin knows.
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
        notes = [*self.assignment.notes, *about.pop("notes", [])]
        summary = summarise(self) | about | {"wall_s": self.wall_s, "not_assigned": self.assignment.reasons()}
        return summary | {"notes": notes} | put_in | learnt

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
        from astropy.table import QTable  # takes a third of a second: only where it is needed

        table = QTable(fibres_columns(self))
        for name in table.colnames:
            if (unit := name.rpartition("_")[2]) in _UNITS:
                table[name].unit = unit
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
