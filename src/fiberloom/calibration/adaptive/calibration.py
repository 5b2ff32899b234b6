"""Adaptive calibration: what the camera sees in operation keeps the maps right. Kronig 2020, Sec. 4.3.

`AdaptiveCalibration` holds the maps of N positioners (the negative contact, in which every arm comes to
rest) and their arms. After a move it is told the wire positions at which the motors came to rest and
where the metrology fibres are; it tells the maps to use from then on. It reads and writes no files.

Two methods. "paper" is Eq. 27 to 33 as printed (`nearest_knot`). "improved", the default, is a Kalman
filter on the map (`map_filter`): a measurement informs the map as far as wear is alike, and its two
neighbouring knots by its own variance; knots four times denser than those of the calibration learn
what that could not see; variances grow with every move, so that old knowledge gives way.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.calibration.adaptive import knots as lines
from fiberloom.calibration.adaptive import map_filter
from fiberloom.calibration.adaptive import nearest_knot as printed
from fiberloom.calibration.adaptive.map_filter import FilterState, MeasurementBlock, Spline, Weighing
from fiberloom.calibration.adaptive.nearest_knot import CommandSigmas
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.errors import InputError
from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.instruments.arms import CENTRE, L_ALPHA
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import MM_PER_UM

Learnt = tuple[Flags, Floats, Floats]
Method = Literal["improved", "paper"]
_TOGETHER = 12
"""Measurements of a positioner that are weighed at once; more are taken in turns."""


@dataclass(frozen=True)
class AdaptiveSettings:
    """What is believed beforehand. Angles are sigmas at the output, lengths 2-D rms or sigma in um."""

    method: Method = "improved"
    camera_um: float | None = None
    """2-D rms of a measurement where `update` is told none; default: the instrument's camera."""

    # "paper"
    command: CommandSigmas = field(default_factory=CommandSigmas)
    printed_covariance: bool = False
    """Eq. 29 as printed, instead of the Jacobian of Eq. 1."""

    # "improved"
    refine: int = 4
    """Fine knots for one of the calibration."""
    node_deg: float = 5.0
    """Nodes of the smooth part. Marks of wear are 6 deg and wider (Fig. 22)."""
    arrival_deg: tuple[float, float] = (0.0012, 0.0007)
    """Scatter of arrivals, alpha and beta: Fig. 17 without its camera."""
    knot_deg: float = 0.002
    """Error of a calibrated knot: 0.47 um of camera at a lever of 15 mm."""
    ripple_deg: tuple[float, float] = (0.032, 0.020)
    """Error half-way between two, alpha and beta: 200 points leave 23 and 14 mdeg rms of a blind move
    (docs/calibration.md), and a half wave that is zero at the knots has 0.71 of its height as rms."""
    wear_deg: float = 0.05
    """Wear after `wear_moves`: up to 0.15 deg in a hundred cycles (Fig. 22), three sigmas."""
    wear_moves: float = 15260.0 * 100
    """A lifetime test: 100 cycles of 15260 moves."""
    finest_deg: float = 0.003
    """Ripple that straight lines between fine knots leave out."""
    ripple_wear_deg: float = 0.02
    """Wear of single teeth after as many."""
    arms_um: float = 1.0
    """Error of centre and lengths (Fig. 20), where no covariance is given."""
    arms_wear_um: float = 1.0
    """Their change after `wear_moves` (Fig. 21)."""
    gate: float = 25.0
    """Squared innovation over its variance that is no noise: 1 in 270 000 of two Gaussian numbers."""
    astray_mm: float = 0.5
    """Farther off than this a spot tells nothing of a map."""
    patience: int = 3
    """Updates in a row that all surprise: then the gear has slipped, and the whole map may be off."""


@dataclass(frozen=True)
class Update:
    """What `update` made of each measurement, (n, M); NaN where nothing was seen."""

    used: Flags
    surprise: Floats
    """Squared innovation in units of its covariance: 2 on average, if all is as believed."""
    miss_um: Floats
    """Distance from where the map (before the update) had the fibre."""
    shift_deg: Floats
    """(n, 2) by how much the maps moved at the last measurement's place."""


@dataclass(frozen=True)
class AdaptiveState:
    """All that a calibration knows of some positioners; to go back to it, or to keep it."""

    positioner_id: Ints
    filter: FilterState
    printed_output_deg: Floats
    """(n, 2, K) of the method "paper"."""
    moves: Ints
    """(n,) measurements learnt from since the calibration."""


class AdaptiveCalibration:
    """Maps and arms of N positioners that learn from every measured move."""

    def __init__(
        self,
        plane: FocalPlane,
        maps: TransmissionMaps,
        settings: AdaptiveSettings | None = None,
        arms_covariance_mm2: ArrayLike | None = None,
    ) -> None:
        """Begins with calibrated maps, in any order of rows, and the layout's arms.

        `arms_covariance_mm2` is (N, 4, 4) of centre x, y, l_alpha, l_beta, as `focal_plane` fits.
        """
        self.settings = settings or AdaptiveSettings()
        self.given = plane
        """The focal plane as it was before anything was learnt."""
        self._maps = maps.select(maps.rows_of(plane.positioner_id))
        factor = self.settings.refine if self.improved else 1
        self.wire_deg = lines.refine(self._maps.wire_deg[:, :, 0], factor)
        """(N, 2, K) motor side of the knots."""
        self._base_deg = lines.refine(self._maps.output_deg[:, :, 0], factor)
        self.output_deg = self._base_deg.copy()
        """(N, 2, K) output side: the maps as learnt."""
        self.moves = np.zeros(plane.n, dtype=np.int64)
        self._spline = Spline(self.wire_deg, self.settings.node_deg)
        self._state = self._prior(arms_covariance_mm2, factor)
        everyone = np.arange(plane.n)
        self._at_knots = self._spline.at(self.wire_deg, everyone)
        self.plane = plane
        """The focal plane with the arms as learnt."""

    @property
    def improved(self) -> bool:
        """Whether the filter learns, rather than Eq. 33."""
        return self.settings.method == "improved"

    def __len__(self) -> int:
        return self.plane.n

    # the maps

    def to_output(self, wire_deg: ArrayLike, index: ArrayLike | None = None) -> Floats:
        """Output angles (n, 2) or (n, 2, M) at wire positions, in deg."""
        return self._evaluate(self.wire_deg, self.output_deg, wire_deg, index)

    def to_wire(self, theta_deg: ArrayLike, index: ArrayLike | None = None) -> Floats:
        """Eq. 34: wire positions in deg, (n, 2) or (n, 2, M), that bring the arms to output angles."""
        return self._evaluate(self.output_deg, self.wire_deg, theta_deg, index)

    def _evaluate(self, source: Floats, goal: Floats, values: ArrayLike, index: ArrayLike | None) -> Floats:
        rows = self._rows(index)
        given = np.asarray(values, dtype=np.float64)
        found = lines.evaluate(source[rows], goal[rows], np.reshape(given, (len(rows), 2, -1)))
        return found.reshape(given.shape)

    @property
    def maps(self) -> TransmissionMaps:
        """The maps as learnt, for both contacts: backlash is the calibration's."""
        factor = self.settings.refine if self.improved else 1
        wire = lines.refine(self._maps.wire_deg, factor)
        output = lines.refine(self._maps.output_deg, factor)
        # T+ wears as T- does at the same angle of the arm
        there = lines.evaluate(self._base_deg, self.wire_deg, output[:, :, 1])
        change = lines.evaluate(self.wire_deg, self.output_deg - self._base_deg, there)
        output[:, :, 0] = self.output_deg
        output[:, :, 1] = lines.rising(output[:, :, 1] + change, wire[:, :, 1])
        note = f"{self._maps.provenance.note} adapted ({self.settings.method})".strip()
        made = replace(self._maps.provenance, note=note)
        return TransmissionMaps(self._maps.positioner_id, wire, output, made)

    # learning

    def update(
        self,
        wire_deg: ArrayLike,
        xy_mm: ArrayLike,
        sigma_um: ArrayLike | None = None,
        index: ArrayLike | None = None,
        moves: ArrayLike | None = None,
    ) -> Update:
        """Learns from rest positions and images of n positioners (rows `index`, else all).

        `wire_deg` and `xy_mm` are (n, 2) or, of several moves in their order, (n, M, 2); NaN where a
        fibre was not seen. `sigma_um`, 2-D rms of a measurement: one, (n,) or (n, M). `moves`: number
        (count) made since the last update, (n,); default: as many as were measured.
        """
        rows = self._rows(index)
        wire, xy = (_with_moves(v, name, len(rows)) for v, name in ((wire_deg, "wire_deg"), (xy_mm, "xy_mm")))
        if wire.shape != xy.shape:
            raise InputError(
                f"adaptive calibration: wire_deg {wire.shape} and xy_mm {xy.shape} differ in shape"
            )
        sigma = self._sigma_mm(sigma_um, wire.shape[:2])
        before = self.output_deg[rows]
        if self.improved:
            self._spread(rows, wire.shape[1] if moves is None else moves)
        step = _TOGETHER if self.improved else 1
        parts = [slice(m, m + step) for m in range(0, wire.shape[1], step)]
        learn = self._weigh if self.improved else self._shift
        done = [learn(rows, wire[:, part], xy[:, part], sigma[:, part]) for part in parts]
        used, surprise, miss = (np.concatenate(column, axis=1) for column in zip(*done, strict=True))
        self.moves[rows] += used.sum(axis=1)
        last = np.nan_to_num(wire[:, -1])[..., None]
        shift = lines.evaluate(self.wire_deg[rows], self.output_deg[rows] - before, last)[..., 0]
        return Update(used, surprise, miss, shift)

    def _spread(self, rows: Ints, moves: ArrayLike) -> None:
        s, per_move = self.settings, 1.0 / self.settings.wear_moves
        state = self._state.rows(rows)
        state.spread(
            np.broadcast_to(np.asarray(moves, dtype=np.float64), (len(rows),)),
            np.full(self._spline.size - map_filter.N_ARMS, s.wear_deg**2 * per_move),
            s.ripple_wear_deg**2 * per_move,
            (s.arms_wear_um * MM_PER_UM) ** 2 * per_move,
        )
        self._state.put(rows, state)

    def _weigh(self, rows: Ints, wire: Floats, xy: Floats, sigma_mm: Floats) -> Learnt:
        """The filter's share of `update`: (n, M, 2) moves weighed together."""
        block, miss = self._block(rows, wire, xy, sigma_mm)
        state = self._state.rows(rows)
        weighing = Weighing.of(state, block)
        surprise = map_filter.surprise(weighing, block)
        gated = block.counts & (surprise > self.settings.gate)
        used = block.counts & ~gated
        if gated.any():
            self._doubt(state, block, gated)
            weighing = Weighing.of(state, block)
        state.doubt[used.any(axis=1)] = 0
        map_filter.weigh(state, replace(block, counts=used), weighing)
        self._state.put(rows, state)
        self._use(rows)
        return used, surprise, miss

    def _block(
        self, rows: Ints, wire: Floats, xy: Floats, sigma_mm: Floats
    ) -> tuple[MeasurementBlock, Floats]:
        n, m, _ = wire.shape
        at = np.nan_to_num(wire).swapaxes(1, 2)
        k, t = lines.locate(self.wire_deg[rows], at)
        theta = lines.between(self.output_deg[rows], k, t).swapaxes(1, 2).reshape(-1, 2)
        each = np.repeat(rows, m)
        expected = self.plane.forward(theta[:, 0], theta[:, 1], index=each)
        jacobian = self.plane.jacobian(theta[:, 0], theta[:, 1], index=each)
        along = printed.directions(self.plane, theta, each)
        arms = np.concatenate([np.broadcast_to(np.eye(2), (n * m, 2, 2)), np.stack(along, axis=2)], axis=2)
        innovation = xy - expected.reshape(n, m, 2)
        miss_mm = np.hypot(innovation[..., 0], innovation[..., 1])
        seen = np.isfinite(miss_mm) & np.isfinite(wire).all(axis=2) & np.isfinite(sigma_mm)
        variance = np.square(self.settings.arrival_deg) + self.settings.finest_deg**2
        scatter = (jacobian * variance) @ jacobian.swapaxes(1, 2)
        noise = scatter.reshape(n, m, 2, 2) + np.nan_to_num(sigma_mm)[..., None, None] ** 2 * np.eye(2)
        block = MeasurementBlock(
            innovation=np.nan_to_num(innovation),
            jacobian=jacobian.reshape(n, m, 2, 2),
            arms=arms.reshape(n, m, 2, 4),
            noise=noise,
            nodes=(found := self._spline.at(at, rows))[0],
            weights=found[1],
            k=k,
            t=t,
            counts=seen & (np.nan_to_num(miss_mm) < self.settings.astray_mm),
        )
        return block, np.where(seen, 1e3 * miss_mm, np.nan)

    def _doubt(self, state: FilterState, block: MeasurementBlock, gated: Flags) -> None:
        """A spot that surprises is not believed, but its place is: next time it will be.

        So one wrong spot does no harm, and a broken tooth is followed from the second image on. When
        everything surprises for some time, the whole map may be off.
        """
        miss2 = (block.innovation**2).sum(axis=-1)
        lever2 = np.maximum((block.jacobian**2).sum(axis=2), 1e-12)  # (n, M, 2)
        doubt = np.where(gated[..., None], miss2[..., None] / lever2, 0.0).swapaxes(1, 2)
        for side in range(2):
            grown = np.maximum(lines.pick(state.ripple_variance, block.k + side), doubt)
            np.put_along_axis(state.ripple_variance, block.k + side, grown, axis=-1)
        state.doubt += gated.any(axis=1) & ~(block.counts & ~gated).any(axis=1)
        self._slip(state, doubt.max(axis=2), state.doubt >= self.settings.patience)

    def _slip(self, state: FilterState, variance: Floats, rows: Flags) -> None:
        """All nodes of both axes may be off together by this variance (n, 2)."""
        ends = [*self._spline.first.tolist(), self._spline.size]
        for axis in range(2):
            nodes = slice(ends[axis], ends[axis + 1])
            state.covariance[rows, nodes, nodes] += variance[rows, axis, None, None]
        state.doubt[rows] = 0

    def _use(self, rows: Ints) -> None:
        """Maps and plane from the state."""
        nodes, weights = self._at_knots[0][rows], self._at_knots[1][rows]
        mean = self._state.mean[rows][:, None]
        wear = np.zeros(nodes.shape[:-1])
        for i in range(nodes.shape[-1]):
            wear += weights[..., i] * np.take_along_axis(mean, nodes[..., i], axis=-1)
        learnt = self._base_deg[rows] + wear + self._state.ripple_deg[rows]
        self.output_deg[rows] = lines.rising(learnt, self.wire_deg[rows])
        self.plane = self._with_arms(self._state.mean[:, : map_filter.N_ARMS])

    def _with_arms(self, change_mm: Floats) -> FocalPlane:
        arms = self.given.arms.copy()
        arms[:, CENTRE] += change_mm[:, :2]
        arms[:, L_ALPHA] += change_mm[:, 2]
        return replace(self.given, arms=arms, points=_longer(self.given, change_mm[:, 3]))

    def _shift(self, rows: Ints, wire: Floats, xy: Floats, sigma_mm: Floats) -> Learnt:
        """Eq. 29 to 33 for one move (n, 1, 2)."""
        wire, measured, s = wire[:, 0], xy[:, 0], self.settings
        theta = self.to_output(np.nan_to_num(wire), rows)
        r_cmd = self.plane.forward(theta[:, 0], theta[:, 1], index=rows)
        miss_mm = np.hypot(*(measured - r_cmd).T)
        seen = np.isfinite(miss_mm) & np.isfinite(wire).all(axis=1) & np.isfinite(sigma_mm[:, 0])
        sigma_meas = np.nan_to_num(sigma_mm)[..., None] ** 2 * np.eye(2)
        sigma_cmd = printed.command_covariance(self.plane, theta, s.command, rows, s.printed_covariance)
        r_est, _ = printed.most_probable(
            r_cmd, sigma_cmd, np.where(seen[:, None], measured, r_cmd), sigma_meas
        )
        shift = printed.estimated_angles(self.plane, r_est, theta, rows) - theta
        used = seen & (np.nan_to_num(miss_mm) < s.astray_mm) & np.isfinite(shift).all(axis=1)
        shift = np.where(used[:, None], shift, 0.0)
        moved = printed.shift_nearest(self.output_deg[rows], self.wire_deg[rows], np.nan_to_num(wire), shift)
        self.output_deg[rows] = lines.rising(moved, self.wire_deg[rows])
        solved = np.linalg.solve(sigma_meas + sigma_cmd, np.nan_to_num(measured - r_cmd)[..., None])
        surprise = np.einsum("nc,nc->n", np.nan_to_num(measured - r_cmd), solved[..., 0])
        surprise = np.where(seen, surprise, np.nan)
        return used[:, None], surprise[:, None], 1e3 * miss_mm[:, None]

    # how well it knows

    def sigma_deg(self, wire_deg: ArrayLike, index: ArrayLike | None = None) -> Floats:
        """Standard errors (n, 2) of the improved maps at wire positions (n, 2)."""
        rows = self._rows(index)
        at = np.reshape(np.asarray(wire_deg, dtype=np.float64), (len(rows), 2, 1))
        k, t = lines.locate(self.wire_deg[rows], at)
        nodes, weights = (part[:, :, 0] for part in self._spline.at(at, rows))
        each = np.arange(len(rows))[:, None, None, None]
        block = self._state.covariance[rows][each, nodes[..., :, None], nodes[..., None, :]]
        smooth = np.einsum("nai,naij,naj->na", weights, block, weights)
        share = (1.0 - t) ** 2, t**2
        ripple = [s * lines.pick(self._state.ripple_variance[rows], k + i) for i, s in enumerate(share)]
        sd: Floats = np.sqrt(smooth + ripple[0][..., 0] + ripple[1][..., 0])
        return sd

    @property
    def arms_covariance_mm2(self) -> Floats:
        """(N, 4, 4) of centre x, y, l_alpha, l_beta."""
        return self._state.covariance[:, : map_filter.N_ARMS, : map_filter.N_ARMS].copy()

    # going back

    def state(self, index: ArrayLike | None = None) -> AdaptiveState:
        """What is known now; nothing that happens later changes it."""
        rows = self._rows(index)
        ids = self.plane.positioner_id[rows]
        output = np.empty((len(rows), 2, 0)) if self.improved else self.output_deg[rows].copy()
        return AdaptiveState(ids, self._state.rows(rows), output, self.moves[rows].copy())

    def restore(self, state: AdaptiveState) -> None:
        """Goes back to a state of these positioners; the others stay as they are."""
        rows = np.atleast_1d(self.plane.index_of(state.positioner_id))
        self.moves[rows] = state.moves
        if self.improved:
            self._state.put(rows, state.filter)
            self._use(rows)
        else:
            self.output_deg[rows] = state.printed_output_deg

    def copy(self) -> AdaptiveCalibration:
        """Another one that knows the same and learns apart."""
        made = copy.copy(self)
        made._state = self._state.rows(np.arange(len(self)))
        made.output_deg, made.moves = self.output_deg.copy(), self.moves.copy()
        return made

    # details

    def _prior(self, arms_covariance_mm2: ArrayLike | None, factor: int) -> FilterState:
        s, n, d = self.settings, len(self._maps), self._spline.size
        covariance = np.zeros((n, d, d))
        arms = np.eye(map_filter.N_ARMS) * (s.arms_um * MM_PER_UM) ** 2
        covariance[:, : map_filter.N_ARMS, : map_filter.N_ARMS] = (
            arms if arms_covariance_mm2 is None else arms_covariance_mm2
        )
        nodes = np.arange(map_filter.N_ARMS, d)
        covariance[:, nodes, nodes] = s.knot_deg**2
        # nothing at a calibrated knot but its own error; most half-way to the next
        part = np.arange(self.wire_deg.shape[-1]) % factor / factor
        half_way = np.array(s.ripple_deg)[:, None] if self.improved else 0.0
        ripple = s.knot_deg**2 + (half_way * np.sin(np.pi * part)) ** 2
        shape = self.wire_deg.shape
        return FilterState(
            mean=np.zeros((n, d)),
            covariance=covariance,
            ripple_deg=np.zeros(shape),
            ripple_variance=np.broadcast_to(ripple, shape).copy(),
            doubt=np.zeros(n, dtype=np.int64),
        )

    def _sigma_mm(self, sigma_um: ArrayLike | None, shape: tuple[int, int]) -> Floats:
        """(n, M) per coordinate."""
        if sigma_um is None:
            sigma_um = self.settings.camera_um or self.plane.instrument.metrology.noise_rms_um
        given = np.asarray(sigma_um, dtype=np.float64)
        given = given[:, None] if given.ndim == 1 else given
        sd: Floats = np.broadcast_to(given, shape) * MM_PER_UM / np.sqrt(2.0)
        return sd

    def _rows(self, index: ArrayLike | None) -> Ints:
        if index is None:
            return np.arange(self.plane.n)
        rows = np.atleast_1d(np.asarray(index))
        return np.flatnonzero(rows) if rows.dtype == bool else rows.astype(np.int64)


def _longer(plane: FocalPlane, by_mm: Floats) -> dict[str, Floats]:
    """Points with the metrology fibre farther out by (N,); the others keep their place from it."""
    length = np.maximum(plane.l_beta_mm, 1e-12)
    out = plane.points[METROLOGY] * (by_mm / length)[:, None]
    return {name: xy + out for name, xy in plane.points.items()}


def _with_moves(values: ArrayLike, name: str, n: int) -> Floats:
    array = np.asarray(values, dtype=np.float64)
    array = array[:, None] if array.ndim == 2 else array
    if array.ndim != 3 or array.shape[0] != n or array.shape[2] != 2:
        raise InputError(
            f"adaptive calibration: {name} has the shape {array.shape}, needs ({n}, 2) or ({n}, M, 2)"
        )
    return array
