"""Fiducials among all spots of an image, at any rotation, with dead ones and strays.

A fiducial's spot looks like any other: it is the pattern that tells. Pairs of fiducials are laid on
pairs of spots at the right distance; each such pair proposes a similarity, and the fiducials around
it vote, by a look into a map of where spots are. The proposals with most votes are grown outwards,
over all fiducials and, if given, over where the fibres are expected, until a transform with
distortion holds. What a pattern does not tell (a symmetric one: by how many sixths of a turn) is
not guessed: two different answers as good as each other are an error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fiberloom.errors import InputError
from fiberloom.metrology import zhao_burge
from fiberloom.metrology.transform import (
    Distortion,
    FieldTransform,
    PlaceErrors,
    Similarity,
    TransformFit,
    fit_similarity,
    fit_transform,
)
from fiberloom.timing import part
from fiberloom.typing import Flags, Floats, Ints

_PAIRS = 16
"""Pairs of fiducials that are tried: with a quarter dead, one in two is whole."""
_VOTERS = 14
_KEPT = 12
"""Proposals that are grown ..."""
_HEARD = 300
"""... out of so many that are looked at as a whole."""
_PER_PAIR = 60
_RINGS = (0.45, 0.7, 0.85, 1.01)
"""Parts of the field, from the middle outwards: distortion grows with the third power."""
_CHUNK = 200_000
_PROOF = 3.0
"""Standard errors from zero of a term beyond the default ones that is worth its noise."""


class AcquisitionError(InputError):
    """The fiducials were not found, or not without doubt."""


@dataclass(frozen=True)
class CameraGeometry:
    """What is known of a camera before it has seen anything."""

    width_px: int
    height_px: int
    scale_mm_px: float
    rotation_deg: float = 0.0
    """Direction in the focal plane of the pixel x axis."""
    flipped: bool = False
    """True: y in the image runs against y in the focal plane, at rotation 0."""
    centre_px: tuple[float, float] | None = None
    """Where the centre of the focal plane is; the middle of the image when left out."""
    rotation_tolerance_deg: float = 180.0
    scale_tolerance: float = 0.05
    shift_tolerance_mm: float = np.inf

    @property
    def middle_px(self) -> tuple[float, float]:
        """Where the centre of the focal plane is."""
        return self.centre_px or (0.5 * (self.width_px - 1), 0.5 * (self.height_px - 1))

    def similarity(self) -> Similarity:
        """The nominal transform."""
        a = self.scale_mm_px * np.exp(1j * np.deg2rad(self.rotation_deg))
        x, y = self.middle_px
        z = complex(x, -y if self.flipped else y)
        return Similarity(complex(a), complex(-a * z), self.flipped)


@dataclass(frozen=True)
class Acquisition:
    """Fiducials found, and the transform that they give."""

    fiducial: Ints
    """Indices of the fiducials that have a spot ..."""
    spot: Ints
    """... and of those spots."""
    fit: TransformFit

    @property
    def transform(self) -> FieldTransform:
        """Pixels to focal plane."""
        return self.fit.transform


@dataclass(frozen=True)
class AcquisitionSettings:
    """How fiducials are looked for."""

    coarse_mm: float = 3.0
    """Distortion within the reach of a vote, at most."""
    gate_mm: float = 0.25
    """A spot farther than this from where a fitted fiducial must be is not the fiducial's."""
    seen_at_least: float = 0.4
    """Share of the fiducials that must be found."""
    rms_below_um: float = 60.0
    """Residuals of a transform that is believed: spots of others happen to lie near, but not nearer."""
    seed: int = 0
    terms: Sequence[int] | None = None
    """Of the distortion; without them the default set and the full one are fitted, and the one with smaller
    leave-one-out residuals is kept."""
    radius_mm: float | None = None
    """Of the field: it scales the terms; the outermost fiducial when left out."""


@part("transform")
def acquire(
    xy_px: ArrayLike,
    fiducials_mm: ArrayLike,
    geometry: CameraGeometry,
    *,
    expected_mm: ArrayLike | None = None,
    errors: PlaceErrors | None = None,
    settings: AcquisitionSettings | None = None,
) -> Acquisition:
    """Finds fiducials (m, 2) among spots (n, 2).

    `xy_px`: the spots; `fiducials_mm` (m, 2): the table; `geometry`: what is known of the camera;
    `expected_mm`: where fibres should be; they help to distinguish symmetric answers, and some may be wrong.
    `errors` of spots and table; `settings`: limits of the search, and the distortion to be fitted. Raises
    AcquisitionError where too few are found or two answers are as good.
    """
    s = settings or AcquisitionSettings()
    hunt = _Search(np.asarray(xy_px, float), np.asarray(fiducials_mm, float), geometry, s)
    hunt.help = _finite(expected_mm)
    hunt.errors = errors or PlaceErrors()
    hunt.radius_mm = s.radius_mm or hunt.field_radius_mm
    return hunt.best(hunt.proposals())


@part("transform")
def refine(
    xy_px: ArrayLike,
    fiducials_mm: ArrayLike,
    start: FieldTransform,
    *,
    errors: PlaceErrors | None = None,
    settings: AcquisitionSettings | None = None,
) -> Acquisition:
    """The fiducials again, from the transform of an earlier image.

    `xy_px` (n, 2): the spots; `fiducials_mm` (m, 2): the table; `start`: the earlier transform, which gives
    the radius of the field; `errors` and `settings` as in `acquire`. Raises AcquisitionError where the
    fiducials are not where `start` has them.
    """
    s = settings or AcquisitionSettings()
    geometry = CameraGeometry(1, 1, start.similarity.scale_mm_px, flipped=start.similarity.flipped)
    hunt = _Search(np.asarray(xy_px, float), np.asarray(fiducials_mm, float), geometry, s)
    hunt.errors, hunt.radius_mm = errors or PlaceErrors(), start.radius_mm
    grown = hunt.polish(start)
    if grown is None:
        raise AcquisitionError("the fiducials are not where the last transform has them; acquire them anew")
    return grown


class _Search:
    """One search."""

    def __init__(
        self, px: Floats, fiducials: Floats, geometry: CameraGeometry, s: AcquisitionSettings
    ) -> None:
        if len(fiducials) < 4:
            raise AcquisitionError(f"{len(fiducials)} fiducials: at least 4 are needed")
        if len(px) < 4:
            raise AcquisitionError(f"{len(px)} spots in the image: no fiducials to be found")
        self.px, self.fiducials, self.geometry, self.s = px, fiducials, geometry, s
        self.tree = cKDTree(px)
        self.marks_mm, self.marks_px = self._marks()
        if len(self.marks_px) < 4:
            raise AcquisitionError(
                f"{len(px)} spots in the image, but no groups of them that could be the fiducials' pinholes"
            )
        self.help = np.zeros((0, 2))
        self.errors = PlaceErrors()
        self.terms = _sets(s.terms)
        self.field_radius_mm = float(np.hypot(*(fiducials - fiducials.mean(0)).T).max()) or 1.0
        self.radius_mm = self.field_radius_mm
        self.needed = max(4, int(np.ceil(s.seen_at_least * len(fiducials))))
        self.needed_marks = max(4, int(np.ceil(s.seen_at_least * len(self.marks_mm))))

    # proposals

    def proposals(self) -> list[Similarity]:
        """The similarities that most fiducials around a pair vote for."""
        z = self._complex(self.marks_px)
        nominal = self._near_nominal()
        if nominal is not None and self.geometry.rotation_tolerance_deg <= _SMALL_TURN_DEG:
            return [nominal]
        grid = _Map(z, self.s.coarse_mm / self.geometry.scale_mm_px)
        votes: list[tuple[int, complex, complex]] = []
        for one, two in self._pairs():
            votes += self._vote(one, two, z, grid)
        votes = self._heard(votes, _Map(self._complex(self.px), self.s.coarse_mm / self.geometry.scale_mm_px))
        flipped = self.geometry.flipped
        out = [Similarity(a, b, flipped) for _, a, b in self._distinct(votes, _KEPT)]
        return out if nominal is None else [nominal, *out]

    def _marks(self) -> tuple[Floats, Floats]:
        """What the hunt is for, and where it may be: fiducials and spots; where a fiducial is several
        pinholes, the middles of such bodies and of spots that have neighbours as near."""
        gap = cKDTree(self.fiducials).query(self.fiducials, k=3)[0][:, 2]
        close_mm = float(np.quantile(gap, 0.9))
        if close_mm > _PINHOLES_MM:
            return self.fiducials, self.px
        bodies, _ = _middles(self.fiducials, 1.3 * close_mm)
        spots, size = _middles(self.px, 1.3 * close_mm / self.geometry.scale_mm_px)
        return bodies, spots[size > 2]

    def _complex(self, px: Floats) -> NDArray[np.complex128]:
        z = px[:, 0] + 1j * px[:, 1]
        return z.conj() if self.geometry.flipped else z

    def _near_nominal(self) -> Similarity | None:
        """The nominal transform, moved to where fiducials and fibres fit best; small turns only."""
        px, guides = self._guides()
        moved = _align(px, guides, self.geometry.similarity(), self.s.coarse_mm)
        return moved if self._hits(moved) >= self.needed_marks else None

    def _guides(self) -> tuple[Floats, Floats]:
        """Spots and places that lead to a transform: fiducials, and fibres where they are far enough
        apart not to be taken for each other."""
        if len(self.marks_mm) < len(self.fiducials) or len(self.help) < 2:
            return self.marks_px, self.marks_mm
        gap = cKDTree(self.help).query(self.help, k=2)[0][:, 1]
        apart = float(np.median(gap)) > 3 * self.s.coarse_mm
        return self.px, np.vstack([self.fiducials, self.help]) if apart else self.fiducials

    def _hits(self, base: Similarity) -> int:
        distance, _ = cKDTree(self.marks_px).query(base.to_px(self.marks_mm))
        return int((distance * base.scale_mm_px < self.s.coarse_mm).sum())

    def _pairs(self) -> list[tuple[int, int]]:
        """Pairs a tenth to a third of the field apart, in an order drawn by the seed."""
        rng = np.random.default_rng([self.s.seed, 0xF1D])
        i, j = np.triu_indices(len(self.marks_mm), 1)
        gap = np.hypot(*(self.marks_mm[i] - self.marks_mm[j]).T) / self.field_radius_mm
        good = np.flatnonzero((gap > 0.2) & (gap < 0.6))
        chosen = rng.permutation(good if len(good) else len(i))[:_PAIRS]
        return [(int(i[k]), int(j[k])) for k in chosen]

    def _vote(
        self, one: int, two: int, z: NDArray[np.complex128], grid: _Map
    ) -> list[tuple[int, complex, complex]]:
        m = self.marks_mm[:, 0] + 1j * self.marks_mm[:, 1]
        gap_mm = abs(m[two] - m[one])
        middle = 0.5 * (m[one] + m[two])
        voters = m[np.argsort(np.abs(m - middle))[: _VOTERS + 2]]
        p, q = self._spot_pairs(z, gap_mm)
        best: list[tuple[int, complex, complex]] = []
        for start in range(0, len(p), _CHUNK):
            i, j = p[start : start + _CHUNK], q[start : start + _CHUNK]
            a = (m[two] - m[one]) / (z[j] - z[i])
            b = m[one] - a * z[i]
            keep = self._allowed(a, b)
            a, b = a[keep], b[keep]
            count = grid.count((voters[None, :] - b[:, None]) / a[:, None])
            top = np.argsort(-count, kind="stable")[:_PER_PAIR]
            best += [(int(count[k]), complex(a[k]), complex(b[k])) for k in top]
        return best

    def _spot_pairs(self, z: NDArray[np.complex128], gap_mm: float) -> tuple[Ints, Ints]:
        """Ordered pairs of spots at this distance, to the tolerance of the scale."""
        g, tolerance = self.geometry, self.geometry.scale_tolerance
        slack = self.s.coarse_mm / g.scale_mm_px / 2
        far = gap_mm / g.scale_mm_px / (1 - tolerance) + slack
        near = gap_mm / g.scale_mm_px / (1 + tolerance) - slack
        tree = cKDTree(np.column_stack([z.real, z.imag]))
        pairs = tree.query_pairs(far, output_type="ndarray")
        gap = np.abs(z[pairs[:, 1]] - z[pairs[:, 0]])
        p, q = pairs[gap > near].T.astype(np.int64)
        return np.concatenate([p, q]), np.concatenate([q, p])

    def _allowed(self, a: NDArray[np.complex128], b: NDArray[np.complex128]) -> Flags:
        g, nominal = self.geometry, self.geometry.similarity()
        off_deg = np.rad2deg(np.abs(np.angle(a / nominal.a)))
        ok = (off_deg <= g.rotation_tolerance_deg) & (
            np.abs(np.abs(a) / g.scale_mm_px - 1) <= g.scale_tolerance + 0.02
        )
        centre = -nominal.b / nominal.a
        return ok & (np.abs(a * centre + b) <= g.shift_tolerance_mm)

    def _heard(
        self, votes: list[tuple[int, complex, complex]], grid: _Map
    ) -> list[tuple[int, complex, complex]]:
        """The best proposals once more, by all that is known: a regular array fits itself shifted."""
        votes = self._distinct(sorted(votes, key=lambda v: -v[0]), _HEARD)
        if not votes:
            return []
        known = np.vstack([self.fiducials, self.help])
        m = known[:, 0] + 1j * known[:, 1]
        a, b = np.array([v[1] for v in votes]), np.array([v[2] for v in votes])
        count = grid.count((m[None, :] - b[:, None]) / a[:, None])
        order = np.argsort(-count, kind="stable")
        return [(int(count[k]), votes[k][1], votes[k][2]) for k in order]

    def _distinct(
        self, votes: list[tuple[int, complex, complex]], most: int
    ) -> list[tuple[int, complex, complex]]:
        """The best of each bundle of proposals that mean the same: they move the field alike."""
        nominal = self.geometry.similarity()
        corner = self.field_radius_mm / abs(nominal.a)
        places = -nominal.b / nominal.a + corner * np.array([1, 1j, -1, -1j])
        moved = np.zeros((0, 4), dtype=complex)
        out: list[tuple[int, complex, complex]] = []
        for vote in votes:
            here = vote[1] * places + vote[2]
            if (np.abs(moved - here).max(axis=1) > 4 * self.s.coarse_mm).all():
                out.append(vote)
                moved = np.vstack([moved, here])
            if len(out) >= most:
                break
        return out

    # growing

    def best(self, proposals: list[Similarity]) -> Acquisition:
        """The proposal that explains most spots, if it does so better than any different one."""
        grown = [(self._score(g), g) for g in self._grown(proposals)]
        if not grown:
            raise AcquisitionError(
                f"no {self.needed} of {len(self.fiducials)} fiducials found among "
                f"{len(self.px)} spots; check scale, flip and illumination"
            )
        grown.sort(key=lambda pair: -pair[0])
        score, winner = grown[0]
        for other_score, other in grown[1:]:
            if not self._alike(winner.transform, other.transform, _SAME_MM) and other_score > 0.8 * score:
                turn = other.transform.similarity.rotation_deg - winner.transform.similarity.rotation_deg
                raise AcquisitionError(
                    f"the fiducials fit as well turned by {turn:.0f} deg; give the rotation to "
                    "within less than that, or the expected positions of the fibres"
                )
        return winner

    def _score(self, found: Acquisition) -> float:
        """Fiducials found, and expected fibres that are where expected."""
        hits = 0
        if len(self.help):
            distance, _ = self.tree.query(found.transform.to_px(self.help))
            hits = int((distance * self.geometry.scale_mm_px < 0.5).sum())
        return len(found.fiducial) + hits

    def _grown(self, proposals: list[Similarity]) -> list[Acquisition]:
        """What the proposals grow into, each once."""
        out: list[Acquisition] = []
        for proposal in proposals:
            rough = self.grow(proposal)
            if rough is None or any(self._alike(rough, known.transform, _ALIKE_MM) for known in out):
                continue
            polished = self.polish(rough)
            if polished is not None:
                out.append(polished)
        return out

    def _alike(self, one: FieldTransform, other: FieldTransform, within_mm: float) -> bool:
        """Do both say the same of where fiducials are?"""
        px = self.marks_px
        return bool(np.median(np.hypot(*(one.to_mm(px) - other.to_mm(px)).T)) < within_mm)

    def grow(self, base: Similarity) -> FieldTransform | None:
        """From a proposal outwards: similarity on what is near, then ring by ring with distortion."""
        px, guides = self._guides()
        middle = self.fiducials.mean(axis=0)
        radius = np.hypot(*(self.marks_mm - middle).T)
        inner = np.hypot(*(guides - middle).T) <= _RINGS[0] * self.field_radius_mm
        for gate in (2.0, 1.0, 0.7):
            base = _align(px, guides[inner], base, gate * self.s.coarse_mm)
        transform = FieldTransform(base, self.radius_mm, (0,), np.zeros(1), *np.zeros((2, 1, 1)))
        tree = cKDTree(self.marks_px)
        for ring in _RINGS:
            near = np.flatnonzero(radius <= ring * self.field_radius_mm)
            index, spot = self._near(
                transform.to_px(self.marks_mm[near]), base.scale_mm_px, self.s.coarse_mm, tree
            )
            if len(index) < 4:
                continue
            transform = self._few_terms(self.marks_px[spot], self.marks_mm[near[index]])
        if len(index) < self.needed_marks:
            return None
        return transform

    def _few_terms(self, px: Floats, mm: Floats) -> FieldTransform:
        """Robust against the wrong pairs of a wide gate, and bent as lenses bend."""
        terms = tuple(t for t in (0, 1, 2, 9, 27) if t in self.terms[0]) or self.terms[0]
        if len(px) < 8:
            terms = zhao_burge.SIMILARITY_TERMS
        distortion = Distortion(self.radius_mm, terms)
        return fit_transform(px, mm, distortion, flipped=self.geometry.flipped).transform

    def polish(self, transform: FieldTransform) -> Acquisition | None:
        """Narrower and narrower gates, with all the terms."""
        found: Acquisition | None = None
        scale = transform.similarity.scale_mm_px
        fitted: tuple[Ints, Ints] | None = None
        for gate_mm in (4 * self.s.gate_mm, 2 * self.s.gate_mm, self.s.gate_mm, self.s.gate_mm):
            index, spot = self._near(transform.to_px(self.fiducials), scale, gate_mm)
            if len(index) < max(self.needed, 4):
                return None
            if fitted is not None and all(map(np.array_equal, fitted, (index, spot))):
                continue  # the same pairs have the same fit
            fit, fitted = self._best_fit(index, spot, transform.similarity.flipped), (index, spot)
            transform = fit.transform
            found = Acquisition(index[fit.used], spot[fit.used], _only_used(fit))
        believed = found is not None and found.fit.rms_um < self.s.rms_below_um
        return found if believed else None

    def _best_fit(self, index: Ints, spot: Ints, flipped: bool) -> TransformFit:
        """With the terms that predict left-out fiducials best: the default ones, and of the others
        those that these fiducials prove."""
        fits = [self._fit(index, spot, flipped, terms) for terms in self.terms]
        if len(fits) > 1:
            proven = zhao_burge.DEFAULT_TERMS + fits[-1].transform.significant(_PROOF)
            proven = tuple(sorted(set(proven)))
            if proven != zhao_burge.DEFAULT_TERMS:
                fits.append(self._fit(index, spot, flipped, proven))
        # over the same fiducials: a fit must not win by leaving out those that it cannot explain
        both = np.logical_and.reduce([fit.used for fit in fits])
        return min(fits, key=lambda fit: float(np.sum(fit.leave_one_out_mm[both] ** 2)))

    def _fit(self, index: Ints, spot: Ints, flipped: bool, terms: tuple[int, ...]) -> TransformFit:
        return fit_transform(
            self.px[spot],
            self.fiducials[index],
            Distortion(self.radius_mm, terms),
            flipped=flipped,
            errors=self.errors.of(spot, index),
        )

    def _near(
        self, at_px: Floats, scale: float, gate_mm: float, tree: cKDTree | None = None
    ) -> tuple[Ints, Ints]:
        """Fiducials and spots that are each other's nearest, within the gate."""
        distance, spot = (tree or self.tree).query(at_px, distance_upper_bound=gate_mm / scale)
        index = np.flatnonzero(np.isfinite(distance))
        order = index[np.argsort(distance[index], kind="stable")]
        _, first = np.unique(spot[order], return_index=True)
        index = np.sort(order[first])
        return index, spot[index].astype(np.int64)


_SMALL_TURN_DEG = 2.0
_SAME_MM, _ALIKE_MM = 1.0, 0.5
"""Transforms nearer than this over half of the field are one answer: after polishing, and before."""
_PINHOLES_MM = 2.5
"""Fiducials nearer to each other than this are pinholes of one body."""


class _Map:
    """Where spots are, as bits of a coarse image: thousands of votes are counted at once."""

    def __init__(self, z: NDArray[np.complex128], cell_px: float) -> None:
        # a vote counts when it falls into the cell of a spot or a neighbouring one
        self.cell = max(cell_px, 1.0)
        self.low = np.array([z.real.min(), z.imag.min()]) - 3 * self.cell
        size = np.array([z.real.max(), z.imag.max()]) - self.low + 3 * self.cell
        self.shape = np.ceil(size / self.cell).astype(int) + 1
        self.lit = np.zeros(self.shape, dtype=bool)
        i, j = self._index(z)
        for di in (-1, 0, 1):
            for dj in (-1, 0, 1):
                self.lit[i + di, j + dj] = True

    def _index(self, z: NDArray[np.complex128]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        i = np.floor((z.real - self.low[0]) / self.cell).astype(np.intp)
        j = np.floor((z.imag - self.low[1]) / self.cell).astype(np.intp)
        return i.clip(0, self.shape[0] - 1), j.clip(0, self.shape[1] - 1)

    def count(self, z: NDArray[np.complex128]) -> Ints:
        """How many of each row of points fall on a spot; the rim of the map is empty."""
        n: Ints = self.lit[self._index(z)].sum(axis=1)
        return n


def _align(px: Floats, known_mm: Floats, base: Similarity, gate_mm: float) -> Similarity:
    """The similarity that moves known places onto the spots near them, a few times over."""
    tree = cKDTree(px)
    for _ in range(4):
        distance, spot = tree.query(base.to_px(known_mm), distance_upper_bound=gate_mm / base.scale_mm_px)
        near = np.isfinite(distance)
        if near.sum() < 4:
            return base
        off_mm = np.hypot(*(base.to_mm(px[spot[near]]) - known_mm[near]).T)
        weight = 1.0 / np.maximum(off_mm, 0.3 * gate_mm)
        base = fit_similarity(px[spot[near]], known_mm[near], flipped=base.flipped, weight=weight)
    return base


def _middles(points: Floats, reach: float) -> tuple[Floats, Ints]:
    """Means of the points that hang together by steps within `reach`, and how many each has."""
    pairs = cKDTree(points).query_pairs(reach, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
    n, group = connected_components(graph, directed=False)
    size = np.bincount(group, minlength=n)
    sums = [np.bincount(group, points[:, axis], minlength=n) for axis in (0, 1)]
    return np.stack(sums, axis=1) / size[:, None], size.astype(np.int64)


def _sets(terms: Sequence[int] | None) -> tuple[tuple[int, ...], ...]:
    if terms is not None:
        return (tuple(terms),)
    return (zhao_burge.DEFAULT_TERMS, tuple(range(zhao_burge.N_TERMS)))


def _only_used(fit: TransformFit) -> TransformFit:
    u = fit.used
    return TransformFit(fit.transform, fit.residual_mm[u], fit.leave_one_out_mm[u], u[u], fit.chi2)


def _finite(expected_mm: ArrayLike | None) -> Floats:
    if expected_mm is None:
        return np.zeros((0, 2))
    expected = np.asarray(expected_mm, dtype=np.float64)
    return expected[np.isfinite(expected).all(axis=1)]
