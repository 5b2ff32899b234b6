"""Offsets of the science fibres as they are kept and used: arrays, a file, a corrected layout."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fiberloom.calibration.covariances import are_covariances
from fiberloom.calibration.fibres.combine import Combined, combine
from fiberloom.calibration.fibres.estimate import FieldOffsets
from fiberloom.calibration.fibres.frame import FrameOffset
from fiberloom.calibration.fibres.model import MODES
from fiberloom.errors import InputError, one_line
from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.tables import TableFile, read_table, write_columns
from fiberloom.targets import TargetList
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import MM_PER_UM, UM_PER_MM

FORMAT = "fiberloom fibre offsets"
FORMAT_VERSION = 2
_COLUMNS = (
    *("positioner_id", "fibre", "offset_x_mm", "offset_y_mm"),
    *("var_x_mm2", "cov_xy_mm2", "var_y_mm2", "lever_x_mm", "lever_y_mm", "n_fields", "reason"),
)
MOST_MM = 1.0
"""Of an offset: a fibre that is farther off was never glued so."""
_SAME_LEVER_MM = 1e-3
"""By which the layout's fibres may be elsewhere against each other than when stars were measured."""


@dataclass(frozen=True, eq=False)
class FibreOffsets:
    """Where science fibres are against the layout, one row for each positioner and fibre.

    Raises
    ------
    InputError
        Arrays that do not fit each other, a fibre twice, a number that cannot be one.

    Examples
    --------
    >>> import numpy as np
    >>> import fiberloom as fl
    >>> from fiberloom.calibration.fibres.offsets import FibreOffsets
    >>> plane = fl.FocalPlane.of("sdssv", n=7)
    >>> first = plane.positioner_id[:1]
    >>> found = FibreOffsets(
    ...     first, np.array(["BOSS"]), np.array([[0.010, -0.004]]), 1e-6 * np.eye(2)[None]
    ... )
    >>> moved = found.applied(plane).points["BOSS"] - plane.points["BOSS"]
    >>> np.round(moved[:2], 4).tolist()
    [[0.01, -0.004], [0.0, 0.0]]
    """

    positioner_id: Ints
    """(N,) number on the bus."""
    fibre: NDArray[np.str_]
    """(N,) name of the science fibre."""
    offset_mm: Floats
    """(N, 2) truth less layout in the frame of the beta arm: x outwards along the arm; 0 with a reason."""
    covariance_mm2: Floats
    """(N, 2, 2) of it; NaN with a reason."""
    lever_mm: Floats = field(default_factory=lambda: np.empty(0))
    """(N, 2) the layout's science fibre less its metrology fibre, to which the offset is added."""
    n_fields: Ints = field(default_factory=lambda: np.empty(0, np.int64))
    """(N,) fields of stars behind it."""
    reason: NDArray[np.str_] = field(default_factory=lambda: np.empty(0, np.str_))
    """(N,) why nothing is known; empty where it is."""
    frame: FrameOffset | None = None
    """By how much the camera's frame is off, to which the offsets belong; None: not at all."""

    def __post_init__(self) -> None:
        n = len(self.positioner_id)
        usual = {"lever_mm": np.full((n, 2), np.nan), "n_fields": np.ones(n, np.int64)}
        for name, value in (usual | {"reason": np.zeros(n, "U1")}).items():
            if not len(getattr(self, name)):
                object.__setattr__(self, name, value)
        shapes = {
            **{"fibre": (n,), "offset_mm": (n, 2), "covariance_mm2": (n, 2, 2)},
            **{"lever_mm": (n, 2), "n_fields": (n,), "reason": (n,)},
        }
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise InputError(f"fibre offsets: {name} has shape {getattr(self, name).shape}, not {shape}")
        self._check()

    def _check(self) -> None:
        if len(set(self._keys())) < len(self.positioner_id):
            raise InputError("fibre offsets: a fibre appears twice")
        small: Flags = np.all(np.abs(self.offset_mm) <= MOST_MM, axis=1)
        sound = are_covariances(self.covariance_mm2, MOST_MM**2)
        for row in np.flatnonzero(self.ok & ~(small & sound))[:1]:
            if not small[row]:
                raise InputError(f"{self._name(row)}: an offset beyond {MOST_MM:g} mm, or none")
            raise InputError(f"{self._name(row)}: its covariance is none")

    def __len__(self) -> int:
        return len(self.positioner_id)

    def __repr__(self) -> str:
        return f"FibreOffsets({int(self.ok.sum())} of {len(self)} fibres, {self.rms_um:.1f} um rms)"

    @property
    def ok(self) -> Flags:
        """(N,) True where an offset is known."""
        return np.array([not r for r in self.reason], dtype=bool)

    @property
    def rms_um(self) -> float:
        """Of the offsets that are known, two-dimensional; 0 where none is."""
        found = self.offset_mm[self.ok]
        return float(UM_PER_MM * np.sqrt((found**2).sum(axis=1).mean())) if len(found) else 0.0

    @property
    def formal_um(self) -> float:
        """Rms of their standard errors, two-dimensional; 0 where none is."""
        found = self.covariance_mm2[self.ok]
        return float(UM_PER_MM * np.sqrt(np.einsum("nii->n", found).mean())) if len(found) else 0.0

    @classmethod
    def of(cls, found: Combined, plane: FocalPlane) -> FibreOffsets:
        """Of fields that were combined, for a layout; InputError for a fibre that it has not."""
        lever = _levers_mm(plane, found.positioner_id, found.fibre)
        return cls(
            positioner_id=found.positioner_id,
            fibre=found.fibre,
            offset_mm=found.offset_um * MM_PER_UM,
            covariance_mm2=found.covariance_um2 * MM_PER_UM**2,
            lever_mm=lever.reshape(-1, 2),
            n_fields=found.n_fields,
            reason=np.array(found.reason, dtype=np.str_),
            frame=found.frame,
        )

    @classmethod
    def combined(cls, nights: Sequence[FibreOffsets]) -> FibreOffsets:
        """Several nights in one, by inverse covariance.

        Parameters
        ----------
        nights : sequence of FibreOffsets
            In the order of time.

        Returns
        -------
        FibreOffsets
            Of three nights or more the one that disagrees on a fibre is left out; where two disagree the
            fibre has changed, has a reason and no offset.

        Raises
        ------
        InputError
            No night, or nights of different layouts.
        """
        levers = _common_levers(nights)
        found = combine([night._as_field(k) for k, night in enumerate(nights)], place_um=0.0)
        keys = list(zip(found.positioner_id.tolist(), found.fibre.tolist(), strict=True))
        frames = [night.frame for night in nights if night.frame is not None]
        reason = [
            "" if not r else r.replace("its fields disagree", "its nights disagree") for r in found.reason
        ]
        fields = dict.fromkeys(keys, 0)
        for night in nights:
            for key, n in zip(night._keys(), night.n_fields.tolist(), strict=True):
                fields[key] += n
        return cls(
            positioner_id=found.positioner_id,
            fibre=found.fibre,
            offset_mm=found.offset_um * MM_PER_UM,
            covariance_mm2=found.covariance_um2 * MM_PER_UM**2,
            lever_mm=np.array([levers[key] for key in keys]).reshape(-1, 2),
            n_fields=np.array([fields[key] for key in keys], dtype=np.int64),
            reason=np.array(reason, dtype=np.str_),
            frame=FrameOffset.mean(frames) if frames else None,
        )

    def _as_field(self, number: int) -> FieldOffsets:
        n = len(self)
        return FieldOffsets(
            name=f"night {number + 1}",
            positioner_id=self.positioner_id,
            fibre=self.fibre,
            offset_um=self.offset_mm * UM_PER_MM,
            covariance_um2=self.covariance_mm2 * UM_PER_MM**2,
            reason=self.reason.tolist(),
            # what the fields of a night have in common is taken out already
            fibre_mm=np.zeros((n, 2)),
            turned=np.zeros((n, 2, 2)),
            modes=np.zeros((n, 2, MODES)),
            mode_um=1.0,
            chi2_dof=np.full(n, np.nan),
            n_outliers=np.zeros(n, np.int64),
            exposures=np.empty((0, 0)),
        )

    def aims(self, targets: TargetList) -> TargetList:
        """The targets (N) where the camera, whose frame is off, will see fibres that are on them, in mm."""
        if self.frame is None:
            return targets
        xy_mm = np.column_stack([targets.x_mm, targets.y_mm])
        return targets.moved(-self.frame.at_mm(xy_mm))

    def applied(self, plane: FocalPlane) -> FocalPlane:
        """The layout with its science fibres where they are.

        Parameters
        ----------
        plane : FocalPlane
            As it was when the stars were measured; its arms may have been calibrated since.

        Returns
        -------
        FocalPlane
            A fibre without an offset stays.

        Raises
        ------
        InputError
            The layout has none of the positioners, or its fibres were corrected before.
        """
        points = {name: xy.copy() for name, xy in plane.points.items()}
        rows = np.flatnonzero(self.ok & np.isin(self.positioner_id, plane.positioner_id))
        if not len(rows):
            raise InputError(f"fibre offsets: of none of the {plane.n} positioners of this layout")
        lever, known = _levers_mm(plane, self.positioner_id[rows], self.fibre[rows]), self.lever_mm[rows]
        elsewhere = np.isfinite(known).all(axis=1) & (np.abs(lever - known).max(axis=1) > _SAME_LEVER_MM)
        for k in rows[elsewhere][:1]:
            raise InputError(
                f"{self._name(k)}: the layout has it elsewhere than when it was measured; apply offsets "
                "to the layout that they were measured with, and once"
            )
        for name in np.unique(self.fibre[rows]).tolist():
            of = rows[self.fibre[rows] == name]
            points[name][plane.index_of(self.positioner_id[of])] += self.offset_mm[of]
        return replace(plane, points=points)

    def write(self, path: str | Path, marks: Mapping[str, Any]) -> None:
        """Writes the file, whole or not at all; `marks`: version, seed, ... for its head."""
        wide = self.covariance_mm2
        columns = (
            *(self.positioner_id, self.fibre, *self.offset_mm.T),
            *(wide[:, 0, 0], wide[:, 0, 1], wide[:, 1, 1], *self.lever_mm.T, self.n_fields, self.reason),
        )
        frame = {} if self.frame is None else {"camera_frame": self.frame.to_text()}
        head = {"format": FORMAT, "format_version": FORMAT_VERSION, **frame, **marks}
        write_columns(Path(path), dict(zip(_COLUMNS, columns, strict=True)), head)

    @classmethod
    def load(cls, path: str | Path) -> FibreOffsets:
        """Reads the file; InputError, with its name, for one that is no such file or holds nonsense."""
        path = Path(path)
        if not path.is_file():
            raise InputError(f"{path}: no such file; make one with 'fiberloom calibrate fibres'")
        table = read_table(path)
        table.require(*_COLUMNS)
        try:
            return _read(cls, table)
        except InputError as error:
            raise InputError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError(f"{path}: {one_line(error)}; calibrate again") from None

    def _keys(self) -> list[tuple[int, str]]:
        return list(zip(self.positioner_id.tolist(), self.fibre.tolist(), strict=True))

    def _name(self, row: Any) -> str:
        return f"positioner {self.positioner_id[row]}, fibre {self.fibre[row]}"


def _read(cls: type[FibreOffsets], table: TableFile) -> FibreOffsets:
    numbers = {name: _numbers(table, name) for name in _COLUMNS if name.endswith(("_mm", "_mm2"))}
    xy = numbers["cov_xy_mm2"]
    wide = np.stack([numbers["var_x_mm2"], xy, xy, numbers["var_y_mm2"]], axis=-1).reshape(-1, 2, 2)
    return cls(
        positioner_id=table.integers("positioner_id"),
        fibre=table.strings("fibre"),
        offset_mm=np.column_stack([numbers["offset_x_mm"], numbers["offset_y_mm"]]),
        covariance_mm2=wide,
        lever_mm=np.column_stack([numbers["lever_x_mm"], numbers["lever_y_mm"]]),
        n_fields=table.integers("n_fields"),
        reason=table.strings("reason"),
        frame=_frame(table.head.get("camera_frame")),
    )


def _frame(meta: Any) -> FrameOffset | None:
    if meta is None:
        return None
    # files of format 1 have its numbers one by one
    return FrameOffset.of_text(meta) if isinstance(meta, str) else FrameOffset.of_meta(meta)


def _numbers(table: TableFile, name: str) -> Floats:
    """A column of numbers, NaN allowed: of a fibre with a reason."""
    out = np.empty(len(table))
    for row, cell in enumerate(table.columns[name]):
        try:
            out[row] = float(cell)
        except (TypeError, ValueError):
            raise table.error(row, name, f"= '{cell}' is not a number") from None
    return out


def _levers_mm(plane: FocalPlane, positioner_id: Ints, fibre: NDArray[np.str_]) -> Floats:
    """(M, 2) where the layout has fibres (M,) of positioners (M,), from their metrology fibres."""
    rows, levers = plane.index_of(positioner_id), np.empty((len(fibre), 2))
    for name in np.unique(fibre).tolist():
        of = fibre == name
        lacking = of & ~plane.carries(name)[rows]
        if lacking.any():
            raise InputError(f"positioner {positioner_id[lacking][0]}: has no fibre {name} in this layout")
        levers[of] = (plane.points[name] - plane.points[METROLOGY])[rows[of]]
    return levers


def _common_levers(nights: Sequence[FibreOffsets]) -> dict[tuple[int, str], Floats]:
    found: dict[tuple[int, str], Floats] = {}
    for night in nights:
        for k, key in enumerate(night._keys()):
            lever = found.setdefault(key, night.lever_mm[k])
            if np.abs(lever - night.lever_mm[k]).max() > _SAME_LEVER_MM:
                raise InputError(f"{night._name(k)}: was measured on different layouts in these nights")
    return found
