"""What goes wrong with units in years of operation: faults that begin some day, and what they do.

Each unit has at most one ailment. It begins at a move drawn from an exponential distribution and acts
through the same hidden parameters in both fidelities: `Units` (gear, friction, sensors), couplings
that slip, axes that do not move, fibres that go dark. Rates and sizes are assumed but for slipping,
whose spans are those of DESI's degraded motors (desihub/fpoffline: 458 units with slopes of
0.2 to 1.0 and up to 0.8 of their moves without motion; 317 linear motors with scales of 0.44 to 1.0
that differ between the directions by up to 0.28).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fiberloom.instruments.arms import elbows_mm
from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.faults.grammar import FaultRequest, parse_faults
from fiberloom.twin.faults.kinds import AGED, AilmentKind, FaultKind
from fiberloom.twin.twin import Twin
from fiberloom.twin.units import Units
from fiberloom.twin.wear import TOOTH_MARK
from fiberloom.typing import Flags, Floats, Ints, Records
from fiberloom.units import RAD_PER_DEG

NEVER = np.iinfo(np.int64).max


HEALTHY = ""
KINDS = tuple(AilmentKind)
_TOOTH_DEG = 10.0
"""One of 36 tooth pairings of the output turn."""
HALL_STALLS = 0.45
"""Share of its amplitude below which a channel no longer turns the motor: MEASURED on the full physics, where
one of 24 units stalls at 0.5 and all at 0.4."""
STALL_PER_INERTIA = 3.65e4
"""Friction beyond the firmware's model, over the rotor's inertia, at which moves end as collisions, in
Nm / (kg m^2): MEASURED on the full physics, 103 to 133 uNm for alpha."""


@dataclass(frozen=True)
class AilmentModel:
    """How often what goes wrong, and how badly. Assumed, all but slipping."""

    rate_per_year: float = 0.5
    moves_per_year: float = 24_000.0
    """300 nights of 20 fields, a blind move and three corrections each."""
    weights: dict[str, float] = field(default_factory=lambda: {str(k): 1.0 for k in KINDS})
    tooth_deg: tuple[float, float] = (0.15, 0.5)
    non_moves: tuple[float, float] = (0.05, 0.6)
    loose_um_per_1000: tuple[float, float] = (20.0, 200.0)
    loose_limit_um: float = 300.0
    fading_moves: tuple[float, float] = (1000.0, 8000.0)
    """Time constant of a fading hall channel."""
    scale: tuple[float, float] = (0.2, 0.98)
    scale_difference: float = 0.036
    """Mean size of the difference between the directions (Laplace), cut at 0.28."""
    scale_non_moves: float = 0.12
    """Mean share of moves without motion of a slipping axis, cut at 0.8."""
    seizing_moves: tuple[float, float] = (2000.0, 12000.0)
    """Moves in which friction doubles."""


AILMENT_DTYPE = np.dtype(
    [
        ("kind", "U16"),
        ("axis", np.int64),
        ("onset", np.int64),  # move from which it acts; NEVER
        ("tooth", np.float64, 3),  # centre, width, height, rad
        ("non_moves", np.float64),
        ("loose_mm", np.float64),  # per move since
        ("fading_moves", np.float64),
        ("channel", np.int64),
        ("follows", np.float64, 2),  # downwards, upwards
        ("seizing_moves", np.float64),
    ]
)


class Ailments:
    """The ailments of N units, `table` (N,) of AILMENT_DTYPE; healthy ones have an onset of NEVER."""

    def __init__(self, table: Records, model: AilmentModel) -> None:
        self.table, self.model = table, model

    def __len__(self) -> int:
        return len(self.table)

    def begun(self, move: int) -> Flags:
        """(N,) which have their ailment at this move."""
        return self.table["onset"] <= move

    def label(self, move: int) -> NDArray[np.str_]:
        """(N,) ailment of each; HEALTHY without one."""
        return np.where(self.begun(move), self.table["kind"], HEALTHY)

    def onsets(self) -> Ints:
        """Moves at which an ailment begins, in order."""
        return np.unique(self.table["onset"][self.table["onset"] != NEVER])

    def _rows(self, kind: AilmentKind, move: int) -> NDArray[np.intp]:
        return np.flatnonzero((self.table["kind"] == kind) & self.begun(move))

    def units_at(self, units: Units, move: int) -> Units:
        """The units with what their ailments changed in them: gears, friction, sensors."""
        gear, plant = units.gear.copy(), units.plant.copy()
        for row in self._rows(AilmentKind.BROKEN_TOOTH, move):
            gear["wear"][row, self.table["axis"][row], TOOTH_MARK] = self.table["tooth"][row]
        for row in self._rows(AilmentKind.WEAK_HALL, move):
            name = ("hall_amplitude_a", "hall_amplitude_b")[self.table["channel"][row]]
            plant[name][row, self.table["axis"][row]] *= self._hall_share(move)[row]
        for row in self._rows(AilmentKind.FRICTION, move):
            grown = 1.0 + (move - self.table["onset"][row]) / self.table["seizing_moves"][row]
            for name in ("coulomb_gear", "viscous_gear"):
                plant[name][row, self.table["axis"][row]] *= grown
        return replace(units, gear=gear, plant=plant)

    def follows_at(self, move: int) -> Floats:
        """(N, 2, 2) shares of the gear's way, downwards and upwards."""
        out, rows = np.ones((len(self), 2, 2)), self._rows(AilmentKind.SLIPPING, move)
        out[rows, self.table["axis"][rows]] = self.table["follows"][rows]
        return out

    def non_moves_at(self, move: int) -> Floats:
        """(N, 2) share of moves that do not happen and are reported as done."""
        out = np.zeros((len(self), 2))
        for kind in (AilmentKind.SLIPPING, AilmentKind.NON_MOVES):
            rows = self._rows(kind, move)
            out[rows, self.table["axis"][rows]] = self.table["non_moves"][rows]
        return out

    def stalled_at(self, units: Units, move: int) -> Flags:
        """(N, 2) axes that the firmware cannot turn and reports as collided."""
        out, rows = np.zeros((len(self), 2), dtype=bool), self._rows(AilmentKind.STUCK, move)
        out[rows, self.table["axis"][rows]] = True
        weak = np.flatnonzero(self._hall_share(move) < HALL_STALLS)
        out[weak, self.table["axis"][weak]] = True
        inertia = units.plant["inertia_motor"] + units.plant["inertia_gear"]
        stalled: Flags = out | (excess_torque_Nm(units) > STALL_PER_INERTIA * inertia)
        return stalled

    def loose_mm_at(self, move: int) -> Floats:
        """(N,) standard deviation in mm of the beta arm's length from move to move."""
        out, rows = np.zeros(len(self)), self._rows(AilmentKind.LOOSE_ARM, move)
        since = move - self.table["onset"][rows]
        out[rows] = np.minimum(self.table["loose_mm"][rows] * since, 1e-3 * self.model.loose_limit_um)
        return out

    def dark_at(self, move: int) -> Flags:
        """(N,) fibres that the camera does not see."""
        dark: Flags = (self.table["kind"] == AilmentKind.DARK) & self.begun(move)
        return dark

    def out_at(self, units: Units, move: int) -> Flags:
        """(N,) which no longer follow their commands, or are not seen: nothing to calibrate."""
        lost = self.stalled_at(units, move) | (self.non_moves_at(move) > 0.0)
        slips = (self.follows_at(move) != 1.0).any(axis=2)
        return np.asarray(np.any(lost | slips, axis=1) | self.dark_at(move))

    def _hall_share(self, move: int) -> Floats:
        out, rows = np.ones(len(self)), self._rows(AilmentKind.WEAK_HALL, move)
        out[rows] = np.exp(-(move - self.table["onset"][rows]) / self.table["fading_moves"][rows])
        return out

    def break_twin(self, twin: Twin, units: Units, move: int) -> None:
        """The same in a twin of the full physics: what can be set before a move is.

        Moves that do not happen and arms that jitter are new in every move: the caller draws them.
        """
        ill, ids = self.units_at(units, move), twin.plane.positioner_id
        axes: tuple[Literal["alpha", "beta"], ...] = ("alpha", "beta")
        twin.set_units(ill)
        follows, stalled = self.follows_at(move), self.stalled_at(ill, move)
        for row in np.flatnonzero(self.begun(move)):
            for k, axis in enumerate(axes):
                twin.slip(int(ids[row]), axis, up=follows[row, k, 1], down=follows[row, k, 0])
                if stalled[row, k]:
                    twin.inject(Fault(FaultKind.BLOCKED, int(ids[row]), axis))
            if self.dark_at(move)[row]:
                twin.inject(Fault(FaultKind.DARK, int(ids[row])))


def excess_torque_Nm(units: Units, motor_rpm: float = 2000.0) -> Floats:
    """(N, 2) running friction beyond what the firmware believes: what its servo must add.

    The firmware's drag learns it while it moves; a stall is where it cannot.
    """
    p, f = units.plant, units.firmware
    back_emf = 1.5 * p["flux_linkage"] ** 2 / p["coil_resistance"]
    drag = p["viscous_motor"] + p["viscous_gear"] + back_emf - f["drag"]
    coulomb = p["coulomb_motor"] + p["coulomb_gear"] - f["coulomb"]
    torque: Floats = coulomb + drag * motor_rpm * 2.0 * np.pi / 60.0
    return torque


def loosened(units: Units, xy_mm: Floats, theta_deg: Floats, longer_mm: Floats) -> Floats:
    """Metrology fibres (N, 2, M) in mm with longer beta arms: shifted along the arm.

    `xy_mm` and `theta_deg` (N, 2, M): places with the arms of the `units`, and angles; `longer_mm` (N,
    M): growth of the arm.
    """
    along = xy_mm - elbows_mm(units.arms, theta_deg[:, 0])
    return xy_mm + along * (longer_mm / np.hypot(along[:, 0], along[:, 1]))[:, None]


def chosen_ailments(units: Units, seed: int, faults: str, onset: int) -> Ailments:
    """Ailments of the text `faults` of `--faults` in `units`, all from the move `onset` on.

    Units by their number have them, from 1 on, in the order of the text but for those named; sizes are
    drawn from the `seed`. Raises InputError that names the part of the text which cannot be read.
    """
    ailments = draw_ailments(units, seed, AilmentModel(rate_per_year=0.0))
    for kind, numbers in _numbers(parse_faults(faults, AGED)).items():
        drawn = draw_ailments(units, seed, AilmentModel(weights={kind: 1.0})).table
        rows = np.isin(units.number, numbers)
        ailments.table[rows] = drawn[rows]
        ailments.table["onset"][rows] = onset
    return ailments


def _numbers(requests: tuple[FaultRequest, ...]) -> dict[str, list[int]]:
    """Numbers of the units that have each kind."""
    named = {r.positioner_id for r in requests}
    free = (number for number in itertools.count(1) if number not in named)
    numbers: dict[str, list[int]] = {}
    for r in requests:
        hit = list(itertools.islice(free, r.count)) if r.positioner_id is None else [r.positioner_id]
        numbers.setdefault(r.kind, []).extend(hit)
    return numbers


def draw_ailments(units: Units, seed: int, model: AilmentModel | None = None) -> Ailments:
    """Ailments that depend on the seed and the number of each unit alone."""
    model = model or AilmentModel()
    table = np.zeros(len(units), AILMENT_DTYPE)
    table["onset"] = NEVER
    for row, number in enumerate(units.number):
        _draw(table[row], np.random.default_rng([seed, 0xA117, int(number)]), model)
    return Ailments(table, model)


def _draw(one: np.void, rng: np.random.Generator, model: AilmentModel) -> None:
    weights = np.array([model.weights.get(str(k), 0.0) for k in KINDS])
    if model.rate_per_year <= 0.0 or weights.sum() <= 0.0:
        return
    one["kind"] = KINDS[rng.choice(len(KINDS), p=weights / weights.sum())]
    one["onset"] = int(rng.exponential(model.moves_per_year / model.rate_per_year))
    one["axis"] = rng.integers(2)
    centre_deg = rng.uniform(0.0, (360.0, 180.0)[one["axis"]])
    height_deg = rng.uniform(*model.tooth_deg) * rng.choice([-1.0, 1.0])
    one["tooth"] = RAD_PER_DEG * np.array([centre_deg, _TOOTH_DEG, height_deg])
    one["loose_mm"] = 1e-6 * rng.uniform(*model.loose_um_per_1000)
    one["fading_moves"] = rng.uniform(*model.fading_moves)
    one["channel"] = rng.integers(2)
    difference = np.clip(rng.laplace(0.0, model.scale_difference), -0.28, 0.28)
    one["follows"] = np.clip(rng.uniform(*model.scale) + difference * np.array([-0.5, 0.5]), 0.0, 1.1)
    one["seizing_moves"] = rng.uniform(*model.seizing_moves)
    some, slipping = rng.uniform(*model.non_moves), min(rng.exponential(model.scale_non_moves), 0.8)
    one["non_moves"] = slipping if one["kind"] == AilmentKind.SLIPPING else some
