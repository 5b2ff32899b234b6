"""Offsets from several fields (or nights): inverse covariance, the guider's patterns, fibres that changed.

Of field f and fibre n a vector is known,

    d_fn = o_n + M_fn c_f + R_fn^T V(x_fn) q + noise(C_fn + place^2)

with o_n the offset in the frame of the arm, c_f the sizes of the four patterns that field f could not tell
(`estimate`), and q by how much the camera's frame is off (`frame`): fixed in the focal plane, R_fn turns it
into the frame of the arm. Arms point elsewhere in each field, so that the differences between fields tell
c_f and q: least squares over all, the o_n taken out. What fields disagree by beyond the noise of their light
(metrology of each field, the stars' places) is `place`, the same for all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import chdtri

from fiberloom.calibration.fibres.estimate import FieldOffsets
from fiberloom.calibration.fibres.frame import FAR_UM, FRAME_UM, OF_CAMERA, TERMS, FrameOffset
from fiberloom.calibration.fibres.model import MODES
from fiberloom.errors import InputError
from fiberloom.timing import part
from fiberloom.typing import Floats, Ints

PLACE_UM = 0.5
"""Least error per coordinate of where a fibre is against its star in one field, beyond photons: SDSS-V's
metrology camera alone has 0.669 um in two dimensions."""
_MOST_PLACE_UM = 20.0
_FACTORS = np.geomspace(0.1, 10.0, 13)
_WITHIN = 3.0
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
    frame: FrameOffset


@part("fit")
def combine(
    fields: Sequence[FieldOffsets], place_um: float = PLACE_UM, radius_mm: float | None = None
) -> Combined:
    """The offsets that fit several fields best.

    Parameters
    ----------
    fields : sequence of FieldOffsets
        In the order of time.
    place_um : float
        Least error of the place of a fibre against its star in a field, um per coordinate.
    radius_mm : float, optional
        Of the disc in which fibres are; that of the fibres themselves when left out.

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
    if radius_mm is None:
        radius_mm = max(float(np.hypot(*f.fibre_mm.T).max(initial=1.0)) for f in fields)
    all_of = _Entries.of(fields, place_um, radius_mm)
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
        self, fibre_of: Ints, keys: list[tuple[int, str]], values: tuple[Floats, ...], radius_mm: float
    ) -> None:
        self.fibre_of, self.keys, self.n_fibres, self.radius_mm = fibre_of, keys, len(keys), radius_mm
        self.d, self.c, self.patterns, self.expected_um = values
        self.used = np.ones(len(self.d), dtype=bool)
        self.changed = np.zeros(self.n_fibres, dtype=bool)
        self.place_um = 0.0

    @classmethod
    def of(cls, fields: Sequence[FieldOffsets], place_um: float, radius_mm: float) -> _Entries:
        keys = sorted({key for f in fields for key in _keys(f)})
        number = {key: k for k, key in enumerate(keys)}
        fibre_of = [np.array([number[key] for key in _keys(f)], dtype=np.int64)[f.ok] for f in fields]
        values = (
            np.concatenate([f.offset_um[f.ok] for f in fields]),
            np.concatenate([f.covariance_um2[f.ok] for f in fields]),
            np.concatenate([_patterns(f, k, len(fields), radius_mm) for k, f in enumerate(fields)]),
            _expected_um(fields),
        )
        made = cls(np.concatenate(fibre_of), keys, values, radius_mm)
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
            return float(np.median(square[several] / chdtri(dof[several], 0.5))) - 1.0

        if too_far(least_um) <= 0.0:
            return least_um
        if too_far(_MOST_PLACE_UM) >= 0.0:
            return _MOST_PLACE_UM
        return float(brentq(too_far, least_um, _MOST_PLACE_UM, xtol=0.01))

    def disagreeing(self) -> Ints:
        """The worst entry of each fibre whose fields disagree; all of those that have two left."""
        solution = self.solved()
        square, dof = solution.chi2()
        bad = square > chdtri(np.maximum(dof, 1), np.where(dof > 2, _UNLIKELY[1], _UNLIKELY[0]))
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
        keys, solution = self.keys, self.solved()
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
            frame=solution.frame(),
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
        self.own = np.asarray(np.linalg.inv(own), dtype=np.float64)
        felt = self.weight @ e.patterns  # (entries, 2, patterns)
        self.shared = np.zeros((e.n_fibres, *felt.shape[1:]))
        np.add.at(self.shared, e.fibre_of, felt)
        pulled = np.zeros((e.n_fibres, 2))
        np.add.at(pulled, e.fibre_of, np.einsum("kij,kj->ki", self.weight, e.d))
        matrix = np.einsum("kip,kiq->pq", e.patterns, felt, optimize=True)
        matrix -= np.einsum("nip,nij,njq->pq", self.shared, self.own, self.shared, optimize=True)
        right = np.einsum("kip,ki->p", felt, e.d)
        right -= np.einsum("nip,nij,nj->p", self.shared, self.own, pulled, optimize=True)
        expected_um = _likeliest_um(matrix, right, e.expected_um)
        self.wide: Floats = np.linalg.inv(matrix + np.diag(expected_um**-2.0))
        self.size = self.wide @ right
        self.offset = np.einsum("nij,nj->ni", self.own, pulled - self.shared @ self.size)

    def frame(self) -> FrameOffset:
        """By how much the camera's frame is off."""
        last = slice(-len(TERMS), None)
        wide = self.wide[last, last]
        return FrameOffset(self.e.radius_mm, self.size[last], 0.5 * (wide + wide.T))

    def left(self) -> Floats:
        """(entries, 2) um: of each field from the common offset."""
        e = self.e
        left: Floats = e.d - e.patterns @ self.size - self.offset[e.fibre_of]
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
        shared: Floats = lever @ self.wide @ lever.swapaxes(-1, -2)
        return self.own + shared


def _patterns(field: FieldOffsets, number: int, n_fields: int, radius_mm: float) -> Floats:
    """(K, 2, 4 F + 53) what fibres have in common: the guider's of each field, and the camera's frame."""
    frame = FrameOffset.basis(field.fibre_mm, radius_mm).transpose(1, 2, 0)
    guider = np.zeros((len(frame), 2, n_fields, MODES))
    guider[:, :, number] = field.modes
    frame = field.turned.swapaxes(-1, -2) @ frame
    return np.concatenate([guider.reshape(len(frame), 2, -1), frame], axis=-1)[field.ok]


def _expected_um(fields: Sequence[FieldOffsets]) -> Floats:
    """(4 F + 53,) rms that each may have. What the guider takes of the frame's terms adds to its own."""
    guider = [max(np.hypot(f.mode_um, FRAME_UM), 1e-6) for f in fields]
    frame = np.where(np.arange(len(TERMS)) < OF_CAMERA, FRAME_UM, FAR_UM)
    return np.concatenate([np.repeat(guider, MODES), frame])


def _likeliest_um(matrix: Floats, right: Floats, expected_um: Floats) -> Floats:
    """`expected_um` with the sizes of the frame that the fields themselves make likeliest.

    A frame that is right is not made wrong by 53 terms of noise, and one that is worse than expected is not
    held back. The evidence of the data by the rms of the camera's terms, and by that of the others; the
    expectation is known within a factor of `_WITHIN`, so that it stays where one field tells nothing.
    """
    n, best = len(expected_um) - len(TERMS), expected_um
    for group in (slice(n, n + OF_CAMERA), slice(n + OF_CAMERA, None)):
        tried = []
        for factor in _FACTORS:
            sizes_um = best.copy()
            sizes_um[group] = factor * expected_um[group]
            tried.append(
                (_evidence(matrix, right, sizes_um) - 0.5 * (np.log(factor) / np.log(_WITHIN)) ** 2, sizes_um)
            )
        best = max(tried, key=lambda one: one[0])[1]
    return best


def _evidence(matrix: Floats, right: Floats, expected_um: Floats) -> float:
    """Log of how likely the data are where the patterns have these sizes; up to a constant."""
    root = expected_um[:, None] * matrix * expected_um + np.eye(len(right))
    seen = expected_um * right
    return float(0.5 * seen @ np.linalg.solve(root, seen) - 0.5 * np.linalg.slogdet(root)[1])


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
