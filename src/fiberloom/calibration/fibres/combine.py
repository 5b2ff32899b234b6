"""Offsets from several fields (or nights): inverse covariance, the guider's patterns, fibres that changed.

Of field f and fibre n a vector is known, d_fn = o_n + M_fn c_f + noise(C_fn + place^2), with o_n the offset
in the frame of the arm and c_f the sizes of the four patterns that field f could not tell (`estimate`). Arms
point elsewhere in each field, so that the differences between fields tell c_f: least squares over all o_n
and c_f, the former taken out. What fields disagree by beyond the noise of their light (metrology of each
field, the stars' places) is `place`, the same for all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import chi2 as chi2_of

from fiberloom.calibration.fibres.estimate import FieldOffsets
from fiberloom.calibration.fibres.model import MODES
from fiberloom.errors import InputError
from fiberloom.typing import Floats, Ints

PLACE_UM = 0.5
"""Least error per coordinate of where a fibre is against its star in one field, beyond photons: SDSS-V's
metrology camera alone has 0.669 um in two dimensions."""
_MOST_PLACE_UM = 20.0
_UNLIKELY = (1e-5, 1e-3)
"""Chance below which two fields, or three and more, disagree on a fibre. Of three one is left
out, which costs little where it was right; of two both are."""


@dataclass(frozen=True, eq=False)
class Combined:
    """Offsets of K fibres from F fields."""

    positioner_id: Ints
    fibre: NDArray[np.str_]
    offset_um: Floats
    """(K, 2) in the frame of the arm; 0 for a fibre with a reason."""
    covariance_um2: Floats
    """(K, 2, 2) with everything; NaN for a fibre with a reason."""
    n_fields: Ints
    """(K,) fields that count."""
    n_left_out: Ints
    """(K,) fields that disagree with the others."""
    reason: list[str]
    place_um: float
    """What the fields disagree by beyond the noise of their light, per coordinate."""


def combine(fields: Sequence[FieldOffsets], place_um: float = PLACE_UM) -> Combined:
    """The offsets that fit several fields best.

    Parameters
    ----------
    fields : sequence of FieldOffsets
        In the order of time.
    place_um : float
        Least error of the place of a fibre against its star in a field, um per coordinate.

    Returns
    -------
    Combined
        Every fibre of any field, in the order of positioner and name. Of three fields or more the one
        that disagrees is left out; where two disagree the fibre has a reason and no offset.

    Raises
    ------
    InputError
        No field.
    """
    if not fields:
        raise InputError("fibres: no field of stars; give one or more")
    all_of = _Entries.of(fields, place_um)
    for _ in range(len(fields) + 1):
        all_of.place_um = all_of.found_place_um(place_um)
        worst = all_of.disagreeing()
        if not len(worst):
            break
        all_of.used[worst] = False
    return all_of.result(fields)


class _Entries:
    """One entry for each field and fibre that was found."""

    def __init__(
        self, fibre_of: Ints, field_of: Ints, n: tuple[int, int], values: tuple[Floats, ...]
    ) -> None:
        self.fibre_of, self.field_of, (self.n_fibres, self.n_fields) = fibre_of, field_of, n
        self.d, self.c, self.modes, self.mode_um = values
        self.used = np.ones(len(self.d), dtype=bool)
        self.changed = np.zeros(self.n_fibres, dtype=bool)
        self.place_um = 0.0

    @classmethod
    def of(cls, fields: Sequence[FieldOffsets], place_um: float) -> _Entries:
        keys = sorted({key for f in fields for key in _keys(f)})
        number = {key: k for k, key in enumerate(keys)}
        fibre_of = [np.array([number[key] for key in _keys(f)], dtype=np.int64)[f.ok] for f in fields]
        field_of = [np.full(len(rows), k) for k, rows in enumerate(fibre_of)]
        values = (
            np.concatenate([f.offset_um[f.ok] for f in fields]),
            np.concatenate([f.covariance_um2[f.ok] for f in fields]),
            np.concatenate([f.modes[f.ok] for f in fields]),
            np.array([f.mode_um for f in fields]),
        )
        made = cls(np.concatenate(fibre_of), np.concatenate(field_of), (len(keys), len(fields)), values)
        made.place_um = place_um
        return made

    def solved(self) -> _Solution:
        return _Solution(self)

    def found_place_um(self, least_um: float) -> float:
        """With which the median fibre's fields agree as well as noise lets them."""

        def too_far(place_um: float) -> float:
            self.place_um = place_um
            square, dof = self.solved().chi2()
            several = dof > 0
            if not several.any():
                return -1.0
            return float(np.median(square[several] / chi2_of.ppf(0.5, dof[several]))) - 1.0

        if too_far(least_um) <= 0.0:
            return least_um
        if too_far(_MOST_PLACE_UM) >= 0.0:
            return _MOST_PLACE_UM
        return float(brentq(too_far, least_um, _MOST_PLACE_UM, xtol=0.01))

    def disagreeing(self) -> Ints:
        """The worst entry of each fibre whose fields disagree; all of those that have two left."""
        solution = self.solved()
        square, dof = solution.chi2()
        bad = square > chi2_of.isf(np.where(dof > 2, _UNLIKELY[1], _UNLIKELY[0]), np.maximum(dof, 1))
        off = np.where(self.used & bad[self.fibre_of], solution.alone(), -1.0)
        out: list[int] = []
        for fibre in np.flatnonzero(bad):
            rows = np.flatnonzero((self.fibre_of == fibre) & self.used)
            if len(rows) == 2:
                self.changed[fibre] = True
                out.extend(rows.tolist())
            else:
                out.append(int(rows[off[rows].argmax()]))
        return np.array(out, dtype=np.int64)

    def result(self, fields: Sequence[FieldOffsets]) -> Combined:
        keys = sorted({key for f in fields for key in _keys(f)})
        solution = self.solved()
        count = np.bincount(self.fibre_of[self.used], minlength=self.n_fibres)
        left_out = np.bincount(self.fibre_of[~self.used], minlength=self.n_fibres)
        why = _first_reasons(fields)
        reason = ["" if count[k] else _why(bool(self.changed[k]), why[key]) for k, key in enumerate(keys)]
        good = count > 0
        offset, covariance = np.zeros((len(keys), 2)), np.full((len(keys), 2, 2), np.nan)
        offset[good], covariance[good] = solution.offset[good], solution.covariance()[good]
        return Combined(
            positioner_id=np.array([key[0] for key in keys], dtype=np.int64),
            fibre=np.array([key[1] for key in keys], dtype=np.str_),
            offset_um=offset,
            covariance_um2=covariance,
            n_fields=count,
            n_left_out=left_out,
            reason=reason,
            place_um=self.place_um,
        )


class _Solution:
    """Least squares over all offsets and patterns."""

    def __init__(self, entries: _Entries) -> None:
        self.e = e = entries
        place = e.place_um**2 * np.eye(2)
        self.weight = np.linalg.inv(e.c + place) * e.used[:, None, None]
        own = np.zeros((e.n_fibres, 2, 2))
        np.add.at(own, e.fibre_of, self.weight)
        self.known = np.einsum("nii->n", own) > 0.0
        own[~self.known] = np.eye(2)
        self.own = np.linalg.inv(own)
        felt = self.weight @ e.modes  # (entries, 2, 4)
        # a fibre has one entry of a field at most
        shared = np.zeros((e.n_fibres, 2, e.n_fields, MODES))
        shared[e.fibre_of, :, e.field_of] = felt
        self.shared: Floats = shared.reshape(e.n_fibres, 2, -1)
        pulled = np.zeros((e.n_fibres, 2))
        np.add.at(pulled, e.fibre_of, np.einsum("kij,kj->ki", self.weight, e.d))
        right = np.zeros((e.n_fields, MODES))
        np.add.at(right, e.field_of, np.einsum("kij,ki->kj", felt, e.d))
        blocks = np.zeros((e.n_fields, MODES, e.n_fields, MODES))
        squares = e.modes.swapaxes(-1, -2) @ felt
        for k in range(e.n_fields):
            blocks[k, :, k] = squares[e.field_of == k].sum(axis=0)
        size = e.n_fields * MODES
        weak = np.repeat(np.maximum(e.mode_um, 1e-6) ** -2.0, MODES)
        matrix = blocks.reshape(size, size) + np.diag(weak)
        matrix -= np.einsum("nip,nij,njq->pq", self.shared, self.own, self.shared, optimize=True)
        self.modes = np.linalg.inv(matrix)
        taken = np.einsum("nip,nij,nj->p", self.shared, self.own, pulled, optimize=True)
        self.size = self.modes @ (right.ravel() - taken)
        self.offset = np.einsum("nij,nj->ni", self.own, pulled - self.shared @ self.size)

    def left(self) -> Floats:
        """(entries, 2) um: of each field from the common offset."""
        e = self.e
        patterns = np.einsum("kij,kj->ki", e.modes, self.size.reshape(-1, MODES)[e.field_of])
        left: Floats = e.d - patterns - self.offset[e.fibre_of]
        return left

    def chi2(self) -> tuple[Floats, Ints]:
        """By fibre: squared disagreement in sigmas, and its degrees of freedom."""
        e, left = self.e, self.left()
        each = np.einsum("ki,kij,kj->k", left, self.weight, left)
        square = np.bincount(e.fibre_of, each, minlength=e.n_fibres).astype(np.float64)
        count = np.bincount(e.fibre_of[e.used], minlength=e.n_fibres)
        return square, (2 * np.maximum(count - 1, 0)).astype(np.int64)

    def alone(self) -> Floats:
        """(entries,) sigmas squared of each entry against the others of its fibre."""
        e, left = self.e, self.left()
        spread = e.c + e.place_um**2 * np.eye(2) - self.own[e.fibre_of]
        spread += 1e-6 * np.eye(2)
        square: Floats = np.einsum("ki,ki->k", left, np.linalg.solve(spread, left[..., None])[..., 0])
        return square

    def covariance(self) -> Floats:
        """(K, 2, 2) um^2."""
        lever = self.own @ self.shared
        covariance: Floats = self.own + lever @ self.modes @ lever.swapaxes(-1, -2)
        return covariance


def _keys(field: FieldOffsets) -> list[tuple[int, str]]:
    return list(zip(field.positioner_id.tolist(), field.fibre.tolist(), strict=True))


def _first_reasons(fields: Sequence[FieldOffsets]) -> dict[tuple[int, str], str]:
    found: dict[tuple[int, str], str] = {}
    for field in fields:
        for key, reason in zip(_keys(field), field.reason, strict=True):
            if not found.get(key):
                found[key] = reason
    return found


def _why(changed: bool, reason: str) -> str:
    return "its fields disagree: a double star, or the fibre changed" if changed else reason
