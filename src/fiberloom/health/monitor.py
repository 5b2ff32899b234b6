"""Health of every positioner, from what normal operation sees anyway.

After each move there is what a positioner reports (the angles it believes to have, through its map) and
what the camera saw. From the two, in angles of the arms: how much of the way asked for was gone, whether
believed and seen angles agree, where on the turn they do not, how much they scatter. Every kind of
fault has a chart (`fiberloom.health.charts`) that adds up its evidence; the state of a positioner is what
the charts say together, and comes with the evidence in words and with what to do.

The misses of healthy positioners are those of `CorrectionNoise`: camera, repeatability, and the map's
error on a blind move. Angles are looked at where the Jacobian is regular; near beta = 0 and 180 deg
a fibre does not tell them.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from fiberloom.health.charts import Chart, Rows, of_event, of_shift, of_spread
from fiberloom.health.habits import ArmFit, Habit, WayShare
from fiberloom.health.settings import HealthSettings
from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.instruments.model import AXES
from fiberloom.metrology.noise import CorrectionNoise
from fiberloom.typing import Flags, Floats
from fiberloom.units import MM_PER_UM, UM_PER_MM, deg_to_rad, rad_to_deg


class State(StrEnum):
    """What an operator may expect of a positioner."""

    HEALTHY = "healthy"
    SUSPECT = "suspect"  # more than chance, less than certain: use it, watch it
    DEGRADED = "degraded"  # works, with a limit that its advice names
    DISABLED = "disabled"  # no use before it has been inspected


class Ailment(StrEnum):
    """What it suffers from; in the order in which one explains away those behind it."""

    DARK = "dark"
    STUCK = "stuck"
    LOOSE_ARM = "loose_arm"
    SCALE = "scale"
    NON_MOVES = "non_moves"
    SLIPPED = "slipped"
    TOOTH = "tooth"
    FRICTION = "friction"
    SCATTER = "scatter"


ADVICE = {
    Ailment.DARK: "its fibre is not seen: check fibre and back-illumination; it keeps its place until then",
    Ailment.STUCK: "it does not move: datum it once; if it stays, take it out of operation where it is",
    Ailment.SCALE: "it goes a wrong share of the way: calibrate its transmission; give it more corrections",
    Ailment.NON_MOVES: "now and then it reports arrival without having moved: give it more corrections; "
    "check its supply and driver",
    Ailment.LOOSE_ARM: "its arm is not as long as it was: calibrate its arms; if that does not last, "
    "tighten the arm",
    Ailment.SLIPPED: "it is not where its motor says: datum it; if it slips again, take it out",
    Ailment.TOOTH: "its transmission has changed at one place: calibrate it, and keep targets off that place",
    Ailment.FRICTION: "it needs more torque than it did: run it in; plan its exchange",
    Ailment.SCATTER: "it does not come back to the same place: calibrate its hall sensors",
}
_WORKS = {
    Ailment.DARK: State.DISABLED,
    Ailment.STUCK: State.DISABLED,
}
"""The state when the evidence is complete; DEGRADED for all others."""


@dataclass(frozen=True)
class ObservedMove:
    """One move as operation saw it. Rows are positioners."""

    before_deg: Floats
    """(N, 2) where the positioners believed to be before the move, through their maps."""
    believed_deg: Floats
    """(N, 2) and after it, as they report; the command where there is no report."""
    seen_mm: Floats
    """(N, 2) metrology fibre, NaN where it was not seen."""
    asked: Flags
    """(N,) told to move."""
    arrived: Flags
    """(N,) reports to have arrived. A motion that was stopped says nothing of health."""
    collided: Flags | None = None
    """(N,) reports a collision; None: none does."""
    effort: Floats | None = None
    """(N, 2) mean torque of the servo beyond its model, over that at which a way ends as a collision."""
    begins: bool = False
    """No move: what a run saw before its first one. What was seen earlier may no longer hold."""


@dataclass(frozen=True)
class Finding:
    """What is known of one positioner that is not healthy."""

    positioner_id: int
    state: State
    ailment: Ailment
    axis: str
    """alpha, beta, or empty where it is not one axis."""
    evidence: str
    since_move: int

    @property
    def advice(self) -> str:
        """What the operator should do."""
        return ADVICE[self.ailment]


class HealthMonitor:
    """Follows all positioners of a plane, move by move."""

    def __init__(
        self, plane: FocalPlane, settings: HealthSettings | None = None, noise: CorrectionNoise | None = None
    ) -> None:
        self.plane, self.settings = plane, settings or HealthSettings()
        self.noise = noise or CorrectionNoise.of(plane)
        self.moves = 0
        n, alarm, clips = len(plane), self.settings.alarm, self.settings.clips
        self.n_bins = round(360.0 / self.settings.tooth_deg)
        self.dark = Chart((n,), alarm)
        self.still = Chart((n, 2), alarm)
        self.scale = Chart((n, 2, 2, 2), alarm, clips.scale)  # axis, direction of the way, too short or long
        self.slip = Chart((n, 2), alarm)
        self.tooth = Chart((n, 2, self.n_bins), alarm, clips.tooth)
        self.everywhere = Chart((n, 2), alarm, clips.tooth)  # misses at any place: then it is not a tooth
        self.friction = Chart((n, 2), alarm, clips.friction)
        self.scatter = Chart((n, 2), alarm, clips.scatter)  # along the beta arm, and across
        self.blocked = Chart((n,), alarm)
        self.geometry = ArmFit(n, self.settings.memory)
        self.stills_in_a_row = np.zeros((n, 2), dtype=np.int64)
        self.since = np.full((n, len(Ailment)), -1, dtype=np.int64)
        self._slip_deg = np.zeros((n, 2))
        self._told_deg = np.zeros((n, 2))  # the slip as last found, for words
        self._wobble_mm2 = np.zeros((n, 2))
        self._visited: deque[Floats] = deque(maxlen=self.settings.revisits)
        self._pending = np.zeros((n, 2), dtype=bool)
        self._way = WayShare(n)
        self._seen_deg = np.full((n, 2), np.nan)
        self._seen_mm = np.full((n, 2), np.nan)
        self._seen_sd_deg = np.full((n, 2), np.nan)
        self._effort = Habit(n, self.settings.settle)
        self._lever_mm = self._levers()

    # one move

    def update(self, passage: ObservedMove) -> None:
        """Learn from one move."""
        self.moves += not passage.begins  # where a run begins nothing has moved yet
        seen: Flags = np.all(np.isfinite(passage.seen_mm), axis=1)
        self.dark.add(of_event(~seen, *self.settings.dark))
        if passage.begins:
            self._begin(passage, seen)
        miss_deg, image_sd_deg = self._miss_deg(passage, seen)
        self._ways(passage, miss_deg, image_sd_deg)
        self._collisions(passage)
        self._torques(passage)
        looked = np.isfinite(miss_deg).all(axis=1)
        self._seen_mm = np.where(seen[:, None], passage.seen_mm, np.nan)
        changed = (looked | passage.asked)[:, None]
        self._seen_deg = np.where(changed, passage.believed_deg + miss_deg, self._seen_deg)
        self._seen_sd_deg = np.where(changed, image_sd_deg, self._seen_sd_deg)
        self._book()

    def _begin(self, passage: ObservedMove, seen: Flags) -> None:
        """Forgets where each was seen last: since then it may have been moved, datumed or parked.

        A slip is kept where the image agrees with it better than with none. A fibre that is seen where
        it should be tells so much of the angles as a blind move needs, also near a folded arm.
        """
        self._pending[:] = False
        self._visited.append(np.full_like(self._seen_deg, np.nan))
        slipped_mm, plain_mm = (self._from_mm(passage, slip) for slip in (self._slip_deg, 0.0))
        self._slip_deg[seen & (plain_mm <= slipped_mm)] = 0.0
        here = seen & (np.fmin(slipped_mm, plain_mm) < self.settings.jump_mm)
        self._seen_deg = np.where(here[:, None], passage.believed_deg + self._slip_deg, np.nan)
        self._seen_sd_deg = np.where(here[:, None], self._deg(self.noise.blind_um), np.nan)

    def _miss_deg(self, passage: ObservedMove, seen: Flags) -> tuple[Floats, Floats]:
        """(N, 2) seen minus believed angles; NaN where nothing is seen or the fibre does not tell.

        And what the image alone makes them scatter by.
        """
        believed = passage.believed_deg
        tells = seen & self._regular(believed[:, 1])
        rows = np.flatnonzero(tells)
        miss, sd = np.full_like(believed, np.nan), np.full_like(believed, np.nan)
        expected = self._expected_mm(believed[rows], rows)
        jacobian = self._jacobian(believed[rows], rows)
        longer_mm = self.geometry.longer_mm()[rows, None] * self._along(believed[rows], expected, rows)
        off_mm = passage.seen_mm[rows] - expected - longer_mm
        inverse = np.linalg.inv(jacobian)
        near = np.einsum("nij,nj->ni", inverse, off_mm)
        image_um = np.hypot(self.noise.camera_um, self.noise.repeatability_um)
        sd[rows] = image_um * MM_PER_UM / np.sqrt(2.0) * np.sqrt((inverse**2).sum(axis=2))
        linear = np.abs(near).max(axis=1, keepdims=True) < self.settings.linear_deg
        miss[rows] = np.where(linear, near, np.nan)
        far = rows[np.isnan(miss[rows, 0])]
        miss[far] = self._far_miss_deg(passage, far)
        return miss, sd

    def _regular(self, beta_deg: Floats) -> Flags:
        """Where a fibre tells both angles: beta (n,) is not near 0 or 180 deg."""
        return np.abs(np.sin(deg_to_rad(beta_deg))) > self.settings.least_sine

    def _expected_mm(self, at_deg: Floats, rows: Rows) -> Floats:
        return self.plane.forward(at_deg[:, 0], at_deg[:, 1], METROLOGY, index=rows)

    def _jacobian(self, at_deg: Floats, rows: Rows) -> Floats:
        return self.plane.jacobian(at_deg[:, 0], at_deg[:, 1], METROLOGY, index=rows)

    def _far_miss_deg(self, passage: ObservedMove, rows: Rows) -> Floats:
        """Where the linear way does not hold: both angles anew."""
        near = passage.believed_deg[rows]
        found = self.plane.inverse(passage.seen_mm[rows], METROLOGY, index=rows, near_deg=near)
        miss = np.column_stack([found.alpha_deg, found.beta_deg]) - near
        miss[:, 0] -= 360.0 * np.rint(miss[:, 0] / 360.0)
        sees = found.reachable & self._regular(found.beta_deg)
        return np.where(sees[:, None], miss, np.nan)

    def _ways(self, passage: ObservedMove, miss_deg: Floats, image_sd_deg: Floats) -> None:
        """What the way from the last image to this one tells."""
        way = passage.believed_deg - passage.before_deg
        gain = miss_deg - (self._seen_deg - passage.before_deg)
        gain[:, 0] -= 360.0 * np.rint(gain[:, 0] / 360.0)
        told = (passage.asked & passage.arrived)[:, None] & np.isfinite(way) & np.isfinite(gain)
        far: Flags = np.any(np.abs(np.nan_to_num(way)) > self.settings.far_deg, axis=1)
        whole: Flags = np.all(told, axis=1)
        sd = self._gain_sd_deg(way, far, np.hypot(image_sd_deg, self._seen_sd_deg))
        still = self._stills(way, gain, sd, told, self._rests(passage))
        self._scales(way, gain, sd, told & ~still)
        self._jumps(passage, miss_deg, gain, sd, told & ~still, far)
        self._slip_deg += np.where(still, -way, 0.0)  # accounted for: it is not where its motor is
        self._geometry(passage, miss_deg, whole & far)
        self._scatters(passage, gain, sd, whole & ~far & ~still.any(axis=1))

    def _gain_sd_deg(self, way: Floats, far: Flags, images_sd_deg: Floats) -> Floats:
        """(N, 2) by which the misses of two images differ, healthy ones."""
        blind = 2.0 * self._deg(self.settings.map_tail * self.noise.blind_um) ** 2
        along = (self.settings.map_tail * self.noise.slope * way) ** 2
        return np.sqrt(images_sd_deg**2 + np.where(far[:, None], blind, np.minimum(along, blind)))

    def _deg(self, rms_um: float) -> Floats:
        """(N, 2) deg by which one axis moves the fibre as far as one coordinate of a 2-D rms."""
        return rad_to_deg(rms_um * MM_PER_UM / np.sqrt(2.0) / self._lever_mm)

    def _rests(self, passage: ObservedMove) -> Flags:
        """(N,) reports arrival, and its fibre is seen where it was: needs no angles."""
        before, after = passage.before_deg, passage.believed_deg
        way_mm = self.plane.forward(after[:, 0], after[:, 1]) - self.plane.forward(before[:, 0], before[:, 1])
        moved_mm = passage.seen_mm - self._seen_mm
        asked_mm, gone_mm = np.hypot(*way_mm.T), np.hypot(*moved_mm.T)
        s = self.settings
        rests: Flags = (asked_mm > s.tell_way_mm) & (gone_mm < s.still_share * asked_mm)
        return rests & passage.asked & passage.arrived

    def _stills(self, way: Floats, gain: Floats, sd: Floats, told: Flags, rests: Flags) -> Flags:
        """Axes that report a way that they did not go."""
        # nearly a whole turn of alpha and none look the same
        s = self.settings
        long = (np.abs(way) > s.tell_way_deg) & (np.abs(way) < s.tell_turn_deg)
        asked = told & long & (np.abs(way) > s.tell_way_sd * sd)
        moved = way + gain
        moved[:, 0] -= 360.0 * np.rint(moved[:, 0] / 360.0)
        still = asked & (np.abs(moved) < np.maximum(s.still_share * np.abs(way), s.still_sd * sd))
        still, asked = still | (rests[:, None] & long), asked | (rests[:, None] & long)
        self.still.add(of_event(still, *s.still), asked)
        again = np.where(still, self.stills_in_a_row + 1, 0)
        self.stills_in_a_row = np.where(asked, again, self.stills_in_a_row)
        return still

    def _collisions(self, passage: ObservedMove) -> None:
        """A way that ends as a collision may be a neighbour's fault once; hardly four times."""
        if passage.collided is not None:
            self.blocked.add(of_event(passage.collided, *self.settings.blocked), passage.asked)

    def _scales(self, way: Floats, gain: Floats, sd: Floats, told: Flags) -> None:
        """A share of the way that is missing or too much, for each direction of its own."""
        s = self.settings
        long = told & (np.abs(way) > s.far_deg) & (np.abs(gain) < s.scale_miss_deg)
        shift = s.scale_step * np.abs(way) / sd
        value = np.where(way < 0.0, -gain, gain) / sd
        for direction, going in enumerate((way < 0.0, way >= 0.0)):
            for side, sign in enumerate((-1.0, 1.0)):
                ratio = of_shift(sign * value, shift)
                chart = np.full(self.scale.shape, np.nan)
                chart[:, :, direction, side] = np.where(long & going, ratio, np.nan)
                self.scale.add(chart)
        self._way.add(way, gain, long)

    def _jumps(
        self, passage: ObservedMove, miss_deg: Floats, gain: Floats, sd: Floats, told: Flags, far: Flags
    ) -> None:
        """A sudden miss that stays at the next place is a slip; one that goes belongs to the place."""
        s, moved_on = self.settings, told & far[:, None]
        stays = self._pending & moved_on & (np.abs(gain) < s.stays_sd * sd)
        self.slip.add(np.where(stays, s.slip_alarms * s.alarm, 0.0))
        self._slip_deg = np.where(stays, miss_deg, self._slip_deg)
        self._told_deg = np.where(stays, miss_deg, self._told_deg)
        self._pending = np.where(moved_on, False, self._pending)
        away = (self._apart_mm(passage) > s.jump_mm)[:, None]
        self._pending |= told & away & (np.abs(gain) > s.jump_sd * sd)
        known_deg = self._slip_deg + self.geometry.offsets_deg()
        self._places(passage, (miss_deg - known_deg) / sd, moved_on)

    def _apart_mm(self, passage: ObservedMove) -> Floats:
        """(N,) from where a fibre is seen to where it should be, by all slips so far; 0 if not seen."""
        return np.nan_to_num(self._from_mm(passage, self._slip_deg))

    def _from_mm(self, passage: ObservedMove, slip_deg: Floats | float) -> Floats:
        """(N,) the same for a slip (N, 2); NaN if not seen."""
        at = passage.believed_deg + slip_deg
        off_mm = passage.seen_mm - self.plane.forward(at[:, 0], at[:, 1], METROLOGY)
        distance: Floats = np.hypot(off_mm[:, 0], off_mm[:, 1])
        return distance

    def _places(self, passage: ObservedMove, value: Floats, told: Flags) -> None:
        """The place on the turn at which a miss was seen."""
        place = (passage.believed_deg // self.settings.tooth_deg).astype(np.int64) % self.n_bins
        ratio = of_shift(np.abs(value), self.settings.tooth_sd)
        chart = np.full(self.tooth.shape, np.nan)
        np.put_along_axis(chart, place[:, :, None], np.where(told, ratio, np.nan)[:, :, None], axis=2)
        self.tooth.add(chart)
        self.everywhere.add(ratio, told)

    def _geometry(self, passage: ObservedMove, miss_deg: Floats, told: Flags) -> None:
        """Offsets of both angles and the length of the beta arm, from the last moves together."""
        at = passage.believed_deg + self._slip_deg
        near = np.abs(miss_deg - self._slip_deg).max(axis=1) < self.settings.fit_deg
        rows = np.flatnonzero(told & near)
        expected = self._expected_mm(at[rows], rows)
        angles = self._jacobian(at[rows], rows)
        along = self._along(at[rows], expected, rows)
        off_mm = passage.seen_mm[rows] - expected
        variance = self._image_variance(angles, rows)
        self.geometry.add(rows, np.concatenate([angles, along[:, :, None]], axis=2), off_mm, variance)

    def _along(self, at_deg: Floats, fibre_mm: Floats, rows: Rows) -> Floats:
        """(n, 2) unit vectors from the beta axis to the fibre: where it goes if the beta arm grows."""
        elbow = self.plane.elbows_mm(at_deg[:, 0], rows)
        unit: Floats = (fibre_mm - elbow) / np.hypot(*(fibre_mm - elbow).T)[:, None]
        return unit

    def _image_variance(self, angles: Floats, rows: Rows) -> Floats:
        """(n, 2, 2) mm^2: maps of both axes, and camera."""
        sd = self._deg(self.settings.map_tail * self.noise.blind_um)[rows]
        scaled = angles * sd[:, None, :]
        camera_mm2 = 0.5 * (self.noise.camera_um * MM_PER_UM) ** 2 + self.settings.camera_floor_mm2
        return scaled @ scaled.transpose(0, 2, 1) + camera_mm2 * np.eye(2)

    def _scatters(self, passage: ObservedMove, gain: Floats, sd: Floats, small: Flags) -> None:
        """What small moves miss by, along the beta arm and across, against what is expected."""
        rows = np.flatnonzero(small & self._elsewhere(passage))
        at = passage.believed_deg[rows]
        angles = self._jacobian(at, rows)
        along = self._along(at, self._expected_mm(at, rows), rows)
        frame = np.stack([along, along[:, ::-1] * [-1.0, 1.0]], axis=1)
        to_arm = frame @ angles
        off = np.einsum("nij,nj->ni", to_arm, gain[rows])
        variance = np.einsum("nij,nj->ni", to_arm**2, sd[rows] ** 2)
        square = np.full((len(self.plane), 2), np.nan)
        square[rows] = off**2 / variance
        self.scatter.add(of_spread(square, 1, self.settings.scatter_ratio))
        self._wobble_mm2[rows] += self.settings.wobble_memory * (off**2 - self._wobble_mm2[rows])

    def _elsewhere(self, passage: ObservedMove) -> Flags:
        """(N,) not at a place of an earlier run: there the map errs again as it did, which is no scatter."""
        at = passage.believed_deg
        fresh = np.ones(len(at), dtype=bool)
        for earlier in list(self._visited)[:-1]:
            fresh &= ~np.all(np.abs(at - earlier) < self.settings.revisit_deg, axis=1)
        if self._visited:
            self._visited[-1] = at.copy()
        return fresh

    def _torques(self, passage: ObservedMove) -> None:
        """Torque over a positioner's own habit, and over what all need today (the temperature)."""
        if passage.effort is None:
            return
        s = self.settings
        effort = np.where((passage.asked & passage.arrived)[:, None], passage.effort, np.nan)
        if not np.isfinite(effort).any():
            return
        value, known = self._effort.over(effort - np.nanmedian(effort, axis=0))
        self.friction.add(of_shift(value / s.effort_sd, s.effort_step / s.effort_sd), known)

    def _levers(self) -> Floats:
        """(N, 2) mm from the axes to the fibre, arms stretched halfway."""
        l_beta = self.plane.l_beta_mm
        return np.stack([np.hypot(self.plane.l_alpha_mm, l_beta), l_beta], axis=1)

    # what it comes to

    def shares(self) -> Floats:
        """(N, kinds of `Ailment`) evidence relative to the alarm: 1 is an alarm."""
        s = self.settings
        again = self.stills_in_a_row.max(axis=1)
        stuck = self.still.share() * (again / s.stuck_sure)
        moved_away = self.geometry.far(self._deg(self.noise.blind_um).max(axis=1))
        along, across = self.scatter.score.T / s.alarm
        lengthwise = self._wobble_mm2[:, 0] > s.lengthwise * self._wobble_mm2[:, 1]
        columns = {
            Ailment.DARK: self.dark.share(),
            Ailment.STUCK: np.maximum(np.where(again >= s.stuck_again, stuck, 0.0), self.blocked.share()),
            Ailment.SCALE: self.scale.share(),
            Ailment.NON_MOVES: self.still.share(),
            Ailment.LOOSE_ARM: np.maximum(
                self.geometry.longer(s.arm_um * MM_PER_UM, s.alarm),
                np.where(lengthwise, along, 0.0),
            ),
            Ailment.SLIPPED: np.maximum(self.slip.share(), moved_away / s.alarm),
            Ailment.TOOTH: ((self.tooth.score.max(axis=2) - self.everywhere.score) / s.alarm).max(axis=1),
            Ailment.FRICTION: self.friction.share(),
            Ailment.SCATTER: np.maximum(along, across),
        }
        return np.column_stack([columns[kind] for kind in Ailment])

    def _book(self) -> None:
        ill = self.shares() >= self.settings.suspect_share
        self.since = np.where(ill, np.where(self.since < 0, self.moves, self.since), -1)

    def states(self) -> list[State]:
        """One for each positioner."""
        found = {finding.positioner_id: finding.state for finding in self.findings()}
        return [found.get(int(p), State.HEALTHY) for p in self.plane.positioner_id]

    def findings(self) -> list[Finding]:
        """Every positioner that is not healthy, by what explains most."""
        shares = self.shares()
        rows = np.flatnonzero((shares >= self.settings.suspect_share).any(axis=1))
        return [self._finding(int(row), shares[row]) for row in rows]

    def _finding(self, row: int, shares: Floats) -> Finding:
        certain = shares >= 1.0
        column = int(np.argmax(certain)) if certain.any() else int(np.argmax(shares))
        ailment = list(Ailment)[column]
        state = _WORKS.get(ailment, State.DEGRADED) if certain[column] else State.SUSPECT
        axis, evidence = self._evidence(row, ailment)
        number = int(self.plane.positioner_id[row])
        return Finding(number, state, ailment, axis, evidence, int(self.since[row, column]))

    def _evidence(self, row: int, ailment: Ailment) -> tuple[str, str]:
        """Axis and words."""
        match ailment:
            case Ailment.DARK:
                return "", "not seen by the camera"
            case Ailment.STUCK | Ailment.NON_MOVES:
                return self._still_words(row)
            case Ailment.SCALE:
                return self._scale_words(row)
            case Ailment.LOOSE_ARM:
                longer_um = UM_PER_MM * self.geometry.solved(row)[2]
                return "beta", f"length of the beta arm {longer_um:+.0f} um and not steady"
            case Ailment.SLIPPED:
                slip = np.where(self._slip_deg[row] == 0.0, self._told_deg[row], self._slip_deg[row])
                off = slip + self.geometry.solved(row)[:2]
                return AXES[int(np.argmax(np.abs(off)))], (
                    f"seen {off[0]:+.2f} / {off[1]:+.2f} deg (alpha / beta) from where it believes"
                )
            case Ailment.TOOTH:
                return self._tooth_words(row)
            case Ailment.FRICTION:
                axis = int(np.argmax(self.friction.score[row]))
                rise = 100.0 * self._effort.rise(row, axis)
                return AXES[axis], f"needs {rise:.0f} % more of the torque at which it would stop"
        return "", "scatters more after small moves than camera and gear explain"

    def _still_words(self, row: int) -> tuple[str, str]:
        if self.blocked.score[row] > self.still.score[row].max():
            return "", "its moves end as collisions, again and again"
        axis = int(np.argmax(self.still.score[row]))
        again = int(self.stills_in_a_row[row, axis])
        last = f", {again} in a row" if again > 1 else ""
        return AXES[axis], f"reports arrival, but the camera sees no motion{last}"

    def _scale_words(self, row: int) -> tuple[str, str]:
        axis, way, _ = (int(k) for k in np.unravel_index(np.argmax(self.scale.score[row]), (2, 2, 2)))
        share, word = self._way.of(row, axis, way), ("negative", "positive")[way]
        return AXES[axis], f"goes {share:.3f} of the way in {word} direction"

    def _tooth_words(self, row: int) -> tuple[str, str]:
        axis, place = (int(k) for k in np.unravel_index(np.argmax(self.tooth.score[row]), (2, self.n_bins)))
        low = place * self.settings.tooth_deg
        return AXES[axis], f"misses between {low:.0f} and {low + self.settings.tooth_deg:.0f} deg"

    def forget(self, positioner_id: int) -> None:
        """After a repair: this positioner begins anew."""
        row = np.atleast_1d(self.plane.index_of(positioner_id)).astype(np.intp)
        for chart in (
            self.dark,
            self.still,
            self.scale,
            self.slip,
            self.tooth,
            self.everywhere,
            self.friction,
            self.scatter,
            self.blocked,
        ):
            chart.forget(row)
        self.geometry.forget(row)
        self._effort.forget(row)
        self._way.forget(row)
        self.stills_in_a_row[row] = 0
        self._slip_deg[row], self._told_deg[row] = 0.0, 0.0
        self._pending[row], self.since[row] = False, -1
        self._wobble_mm2[row] = 0.0
        self._seen_deg[row] = np.nan
