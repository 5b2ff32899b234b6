"""Our law for stick-slip motors: errors are learned, each image is used, last steps are short."""

from dataclasses import dataclass

import numpy as np

from fiberloom.drive.piezo.iterations import MOST_PULSE_US, MOST_STEPS, MotorSteps
from fiberloom.drive.piezo.maps import REVERSE, MotorMaps, direction_of, pulse_factor
from fiberloom.drive.piezo.scatter import ScatterBelief
from fiberloom.typing import Flags, Floats, Ints

AT_STOP_DEG = 0.5
WILD = 0.35
"""[A] A motor whose moves miss by a larger share of their way aims shorter."""


@dataclass(frozen=True)
class LearningSettings:
    """What is believed of a motor before it was seen to move. All [A], but for what the maps' files tell."""

    gain: float = 0.95
    """How far a motor goes, of what its map says."""
    gain_sigma: float = 0.20
    drift_sigma: float = 0.10
    """By so much the gain differs from place to place, and between pulses."""
    measured_gain_sigma: float = 0.05
    """The same, where a calibration has measured the map."""
    measured_moves: float = 10.0
    """So many moves a calibration counts as that has measured the scatter."""
    step_sigma: float = 0.6
    """Fresh scatter of a move, in steps for each root of their number."""
    fine_steps: float = 8.0
    """A move is made of so many steps at least, by shorter pulses where these are too large."""
    most_steps: float = float(MOST_STEPS)
    """Of a motor in one move."""
    longest_step_deg: float = 0.12
    """[Q] Longer pulses are used where a way has more steps, up to such steps: those of the fast maps."""
    least_pulse_us: float = 12.0
    """Shorter pulses are not used: that a motor moves with them is not published."""


@dataclass(frozen=True)
class Order:
    """What is sent to M motors, and what is expected of it."""

    programme: MotorSteps
    told_deg: Floats
    """(M,) signed ways by the maps and pulses, of motors whose gain is 1."""
    step_deg: Floats
    """(M,) of a step."""


class LearningLaw:
    """A filter of each motor's place and, by direction, of its gain; steps as short as the way needs."""

    def __init__(self, maps: MotorMaps, curve_us: Floats, settings: LearningSettings | None = None) -> None:
        """`maps` of M motors; `curve_us` (M,): p1 of their pulses in us."""
        self.maps, self.curve_us, self.settings = maps, curve_us, settings or LearningSettings()
        self.gain = np.full((maps.motors, 2), self.settings.gain)
        self.gain_variance = np.full((maps.motors, 2), self.settings.gain_sigma**2)
        self.scatter = ScatterBelief(np.unique(curve_us, return_inverse=True)[1])
        self.place_deg: Floats | None = None
        self.place_variance = np.zeros(maps.motors)
        self.range_deg: Floats = np.full(maps.motors, np.inf)
        """(M,) from stop to stop: motors that run into one do not go on."""
        self._sent: tuple[Floats, Floats, Ints] | None = None

    def trust_maps(self, scatter: Floats, known: Flags) -> None:
        """Maps of motors `known` (M,) were measured; `scatter` (M,): of their moves, a share of the way."""
        s = self.settings
        used = known & np.isfinite(scatter)
        self.gain[used], self.gain_variance[used] = 1.0, s.measured_gain_sigma**2
        self.scatter.measured(scatter, used, s.measured_moves)

    def command(self, seen_deg: Floats, goal_deg: Floats, sigma_deg: Floats, active: Flags) -> MotorSteps:
        """What to send.

        `seen_deg` and `goal_deg` (M,): angles seen and wanted; `sigma_deg` (M,): of those seen; `active`
        (M,): motors that shall move; the others get no steps.
        """
        self.see(seen_deg, sigma_deg)
        order = self.order(goal_deg, active)
        self.take(order)
        return order.programme

    def order(self, goal_deg: Floats, active: Flags) -> Order:
        """What to send from where motors are believed to be.

        `goal_deg` (M,): angles wanted; `active` (M,): motors that shall move.
        """
        assert self.place_deg is not None
        rows = np.arange(self.maps.motors)
        way = np.where(active, goal_deg - self.place_deg, 0.0)
        direction = direction_of(way)
        usual = self.maps.pulse_us[rows, direction]
        pulse = self._pulse_us(np.abs(way), usual, direction)
        gain = self.gain[rows, direction] * pulse_factor(pulse, usual, self.curve_us)
        wanted = self.maps.steps(self.place_deg, way) / gain
        most = self.settings.most_steps
        steps = np.rint(np.clip(wanted, -most, most)).astype(np.int64)
        told = self.maps.way_deg(self.place_deg, steps * gain / self.gain[rows, direction])
        step_deg = np.abs(told) / np.maximum(np.abs(steps), 1)
        return Order(MotorSteps(steps, pulse), told, step_deg)

    def take(self, order: Order, done: Flags | None = None) -> None:
        """An `order` was executed; by those `done` (M,), all when left out."""
        steps, told = order.programme.steps, order.told_deg
        if done is not None:
            steps, told = np.where(done, steps, 0), np.where(done, told, 0.0)
        self._sent = told, order.step_deg, steps

    def doubt_way(self, order: Order, rows: Flags) -> None:
        """How far motors `rows` (M,) came of an `order` is not known: half of it, or all, or nothing."""
        half = 0.5 * self.gain_of(order.told_deg) * order.told_deg
        assert self.place_deg is not None
        self.place_deg = np.where(rows, self.place_deg + half, self.place_deg)
        self.place_variance = np.where(rows, self.place_variance + half**2, self.place_variance)

    def believe(self, place_deg: Floats, variance: Floats) -> None:
        """Motors are at `place_deg` (M,), by a `variance` (M,) in deg^2: as after a search of the stops."""
        self.place_deg, self.place_variance, self._sent = place_deg.copy(), variance.copy(), None

    @property
    def has_moved(self) -> bool:
        """Whether something was sent since the last image."""
        return self._sent is not None

    def expected_deg(self) -> Floats:
        """(M,) where motors should be now in deg, after what was sent last."""
        assert self.place_deg is not None
        if self._sent is None:
            return self.place_deg
        there: Floats = np.clip(self._unstopped_deg(), 0.0, self.range_deg)
        return there

    def _unstopped_deg(self) -> Floats:
        """(M,) the same, were there no stops."""
        assert self.place_deg is not None
        assert self._sent is not None
        return self.place_deg + self.gain_of(self._sent[0]) * self._sent[0]

    def gain_of(self, way_deg: Floats) -> Floats:
        """(M,) dimensionless gains in the direction of ways (M,)."""
        return self.gain[np.arange(self.maps.motors), direction_of(way_deg)]

    def see(self, seen_deg: Floats, sigma_deg: Floats) -> None:
        """An image: gains are learned, places filtered.

        `seen_deg` (M,): angles, NaN where a fibre was not seen: it is believed where its steps should have
        brought it; `sigma_deg` (M,) of them.
        """
        if self.place_deg is None or self._sent is None:
            known = np.isfinite(seen_deg)
            self.believe(
                np.where(known, seen_deg, self.place_deg if self.place_deg is not None else 0.0),
                np.where(known, sigma_deg**2, self.place_variance),
            )
            return
        expected = self.expected_deg()
        told, step_deg, steps = self._sent
        # a motor that runs into its stop tells nothing of how far it goes
        stopped = np.abs(self._unstopped_deg() - expected) > AT_STOP_DEG
        self._sent = None
        rows, direction = np.arange(self.maps.motors), direction_of(told)
        variance = self.gain_variance[rows, direction]
        fresh = self._fresh_variance(told, step_deg, steps)
        spread = variance + np.where(steps != 0, self.settings.drift_sigma**2, 0.0)
        doubt = self.place_variance + spread * told**2 + fresh
        off = seen_deg - expected
        self._learn(np.where(stopped, np.nan, off), told, spread, doubt + sigma_deg**2)
        share = np.where(np.isfinite(off), doubt / (doubt + sigma_deg**2), 0.0)
        self.place_deg = expected + share * np.nan_to_num(off)
        self.place_variance = (1.0 - share) * doubt

    def limited_deg(self, way_deg: Floats) -> Floats:
        """(M,) signed ways in deg as far as the steps of one move go, of the `way_deg` (M,) wanted."""
        assert self.place_deg is not None
        rows, direction = np.arange(self.maps.motors), direction_of(way_deg)
        most = self.settings.most_steps * self.gain[rows, direction] * self._longer(direction)
        farthest = self.maps.way_deg(self.place_deg, np.copysign(most, way_deg))
        return np.clip(way_deg, np.minimum(farthest, 0.0), np.maximum(farthest, 0.0))

    def aimed_deg(self, way_deg: Floats) -> Floats:
        """(M,) the part of ways (M,) in deg to aim at; shorter ones for motors known to be wild alone.

        A move that goes a part g of the way and misses by a share s of it leaves (1 - g)^2 + g^2 s^2: least
        at g = 1 / (1 + s^2), where s^2 / (1 + s^2) is left instead of s^2. Motors that scatter by less than
        `WILD` go the whole way: of a fifth a shorter aim saves 2 %.
        """
        scatter2 = self.scatter.variance
        aimed: Floats = way_deg / (1.0 + np.where(scatter2 > WILD**2, scatter2, 0.0))
        return aimed

    def tube_deg(self, way_deg: Floats, sigmas: float) -> Floats:
        """(M,) deg that ways (M,) miss their ends by, but for as rarely as normal ones by `sigmas`."""
        assert self.place_deg is not None
        rows, direction = np.arange(self.maps.motors), direction_of(way_deg)
        gain, variance = self.gain[rows, direction], self.gain_variance[rows, direction]
        share = (variance + self.settings.drift_sigma**2) / gain**2
        step = self.settings.step_sigma**2 * gain * self.maps.step_at(self.place_deg, direction)
        other = self.place_variance + share * way_deg**2 + step * np.abs(way_deg)
        return self.scatter.tube(way_deg, other, sigmas)

    def innovation_sigma_deg(self) -> Floats:
        """(M,) standard deviations in deg of where motors are after what was sent last."""
        if self._sent is None:
            return np.sqrt(self.place_variance)
        told, step_deg, steps = self._sent
        spread = self.gain_variance[np.arange(self.maps.motors), direction_of(told)]
        spread = spread + self.settings.drift_sigma**2
        out: Floats = np.sqrt(
            self.place_variance + spread * told**2 + self._fresh_variance(told, step_deg, steps)
        )
        return out

    def _learn(self, off: Floats, told: Floats, spread: Floats, doubt: Floats) -> None:
        """Scatter and gains by how far off moves ended (M,), of which `doubt` (M,) deg^2 was expected."""
        rows, direction = np.arange(self.maps.motors), direction_of(told)
        moved = (told != 0.0) & np.isfinite(off)
        off = np.where(moved, off, 0.0)
        far = moved & (spread * told**2 > 0.25 * doubt)  # short moves tell of steps and of the camera
        other = np.maximum(doubt - self.scatter.variance * told**2, 0.0)
        self.scatter.learn(np.where(far, off, np.nan), told, other)
        sure = np.where(moved, self.scatter.precision(told, other), 0.0)
        self.gain[rows, direction] = np.clip(
            self.gain[rows, direction] + spread * told * sure * off, 0.1, 4.0
        )
        self.gain_variance[rows, direction] = spread * (1.0 - spread * told**2 * sure)

    def _fresh_variance(self, told: Floats, step_deg: Floats, steps: Ints) -> Floats:
        """(M,) deg^2."""
        out: Floats = self.scatter.variance * told**2 + (self.settings.step_sigma * step_deg) ** 2 * np.abs(
            steps
        )
        return out

    def _pulse_us(self, way_deg: Floats, usual_us: Floats, direction: Ints) -> Floats:
        """(M,) whole us: the usual pulse; a shorter one for short ways, a longer one for ways too long."""
        assert self.place_deg is not None
        rows = np.arange(self.maps.motors)
        step = self.gain[rows, direction] * self.maps.step_at(self.place_deg, direction)
        factor = np.minimum(way_deg / (self.settings.fine_steps * step), 1.0)
        wanted = np.abs(self.maps.steps(self.place_deg, np.where(direction == REVERSE, -way_deg, way_deg)))
        needed = wanted / (self.gain[rows, direction] * self.settings.most_steps)
        factor = np.maximum(factor, np.minimum(needed, self._longer(direction)))
        pulse = self._by_factor_us(factor, usual_us)
        least = np.minimum(self.settings.least_pulse_us, usual_us)
        return np.clip(np.rint(np.maximum(pulse, least)), 1.0, MOST_PULSE_US)

    def _by_factor_us(self, factor: Floats, usual_us: Floats) -> Floats:
        """(M,) the pulse t with hypot(t, p1) - p1 = `factor` (M,) times that of the usual one."""
        height = factor * (np.hypot(usual_us, self.curve_us) - self.curve_us)
        pulse: Floats = np.sqrt(height * (height + 2.0 * self.curve_us))
        return pulse

    def pulse_for(self, step_deg: Floats, direction: int) -> Floats:
        """(M,) whole us: the usual pulse, or a longer one where steps are to be `step_deg` (M,) at least."""
        usual, mean = self.maps.pulse_us[:, direction], self.maps.step_deg[:, direction].mean(axis=1)
        each = np.full(self.maps.motors, direction)
        factor = np.clip(step_deg / (self.gain[:, direction] * mean), 1.0, self._longer(each))
        pulse: Floats = np.minimum(np.rint(self._by_factor_us(factor, usual)), MOST_PULSE_US)
        return pulse

    def _longer(self, direction: Ints) -> Floats:
        """(M,) how much longer than by its usual pulse a step of each motor may be."""
        rows = np.arange(self.maps.motors)
        usual, mean = self.maps.pulse_us[rows, direction], self.maps.step_deg[rows, direction].mean(axis=1)
        most = pulse_factor(np.full(self.maps.motors, MOST_PULSE_US), usual, self.curve_us)
        wanted = self.settings.longest_step_deg / (self.gain[rows, direction] * mean)
        longer: Floats = np.clip(wanted, 1.0, np.maximum(most, 1.0))
        return longer
