"""Terms of the error budget by formula, um rms in two dimensions.

A fibre at arms l_a and l_b, with targets spread evenly over its annulus, has the mean square levers
l_a^2 + l_b^2 about alpha and l_b^2 about beta. A term that turns an axis by some angle weighs with these.

    gear      what a polyline through K knots leaves of a wave of order m, phase p = m h at a step h:
              a^2/2 (1 + (2 + cos p)/3 - 2 (sin(p/2)/(p/2))^2)
    at knots  camera, seat and sensors while the map was measured: 2/3 of their squares, between two knots
    arrival   seat and sensors of the move itself
    arms      lengths and centres that the layout has wrong
    fibre, frame, gravity, temperature: what no map knows; the first two no image shows

After corrections the same angles are measured: `corrected`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fiberloom.design.budget.arms import SWEEP_BETA_DEG, left_mm2, sag_mm2
from fiberloom.design.gear import twin_knows
from fiberloom.errors import InputError
from fiberloom.instruments import METROLOGY, FocalPlane, Instrument
from fiberloom.instruments.arms import L_ALPHA
from fiberloom.instruments.pointing import STANDARD_GRAVITY_M_S2
from fiberloom.metrology.cameras import view_of
from fiberloom.metrology.zhao_burge import DEFAULT_TERMS, SIMILARITY_TERMS, basis
from fiberloom.twin import Units
from fiberloom.twin.errors.sizes import NO_ERRORS, TwinErrors
from fiberloom.twin.statistical import LANDING_RMS_RAD
from fiberloom.twin.units import ORDERS
from fiberloom.typing import Floats
from fiberloom.units import GEAR, MM_PER_UM, UM_PER_MM, deg_to_rad

BETWEEN_KNOTS = 2.0 / 3.0
"""Mean square of the noise of a straight line between two knots, over that of a knot."""
BETWEEN_NODES = 2.0 / 3.0 + 0.7788 / 3.0
"""The same of the seat of the teeth, whose nodes are correlated (`fiberloom.twin.statistical`)."""


@dataclass(frozen=True)
class Term:
    """One line of the budget."""

    name: str
    blind_um: float
    """Of the blind move."""
    corrected_um: float
    """What is left of it after the corrections."""


@dataclass(frozen=True)
class Budget:
    """All terms, and what they make together."""

    terms: tuple[Term, ...]
    blind_um: float
    corrected_um: tuple[float, ...]
    """After 1, 2, ... corrections."""

    @property
    def total_um(self) -> tuple[float, ...]:
        """Of the blind move, then after each correction."""
        return (self.blind_um, *self.corrected_um)

    def beyond(self, k: int, requirement_um: float) -> float:
        """Share of the fibres farther off than the requirement after k corrections, of normal errors."""
        return math.exp(-((requirement_um / max(self.total_um[k], 1e-9)) ** 2))


@dataclass(frozen=True)
class BudgetSettings:
    """What is asked."""

    corrections: int = 2
    knots: int = 200
    """Of a map, for each axis and direction."""
    zenith_deg: float = 0.0
    """Zenith distance of the telescope; counts with `errors` that pull at the arms."""
    turn_deg: float = 0.0
    """By which the rotator turns from the images to the middle of the exposure."""
    errors: TwinErrors = NO_ERRORS
    """What tables of arms, fibres, fiducials have wrong, air, temperature."""

    def __post_init__(self) -> None:
        if not 0 <= self.corrections <= 20:
            raise InputError(f"budget: {self.corrections} corrections: 0 to 20")
        if self.knots < 8:
            raise InputError(f"budget: {self.knots} knots: a map has 8 at least")
        if not 0.0 <= self.zenith_deg <= 90.0:
            raise InputError(f"budget: zenith distance {self.zenith_deg:g} deg: 0 to 90")
        if not 0.0 <= self.turn_deg <= 360.0:
            raise InputError(f"budget: the rotator turns by {self.turn_deg:g} deg: 0 to 360")


def budget(plane: FocalPlane, units: Units, settings: BudgetSettings) -> Budget:
    """The budget by formula, of `units` drawn for a `plane` with the errors of the `settings`.

    Raises
    ------
    InputError
        An instrument whose motors have no transmission map.
    """
    require_maps(plane.instrument)
    errors, arrival = settings.errors, "arrival"
    blind = blind_terms(plane, units, settings)
    lasting = lasting_terms(plane, units, settings)
    camera_um = math.hypot(plane.instrument.metrology.noise_rms_um, math.sqrt(2.0) * errors.air_um)
    first_um = math.hypot(*blind.values())
    slope = slope_rms(plane, units, settings)
    seen = corrected_um(first_um, camera_um, blind[arrival], slope, settings.corrections)
    terms = [Term(name, um, um if name == arrival else 0.0) for name, um in blind.items()]
    last_um = math.sqrt(max(seen[-1] ** 2 - blind[arrival] ** 2, 0.0)) if seen else 0.0
    terms += [Term("images and slope", 0.0, last_um)]
    terms += lasting
    stays_um = math.hypot(*(one.corrected_um for one in lasting))
    blind_um = math.hypot(first_um, *(one.blind_um for one in lasting))
    return Budget(tuple(terms), blind_um, tuple(math.hypot(one, stays_um) for one in seen))


def require_maps(instrument: Instrument) -> None:
    """InputError for motors that the twin does not know."""
    if not (instrument.drive.by_maps and all(map(twin_knows, instrument.axes))):
        kinds = " and ".join(f"{axis.kind} of gear {axis.gear:g}" for axis in instrument.axes)
        raise InputError(
            f"{instrument.name}: {kinds}: the budget is of bldc motors of gear {GEAR:g} with maps"
        )


def levers_mm2(plane: FocalPlane) -> Floats:
    """(2,) mean square levers about alpha and beta of the metrology fibre."""
    alpha, beta = np.mean(plane.l_alpha_mm**2), np.mean(plane.l_beta_mm**2)
    return np.array([alpha + beta, beta])


def step_rad(plane: FocalPlane, settings: BudgetSettings) -> Floats:
    """(2,) between two knots of alpha and beta."""
    low, high = plane.limits_deg.T
    approach_deg = plane.instrument.approach_deg
    stops = plane.hard_stops_deg
    low = np.maximum(low, stops[:, 0] + approach_deg + 1.0)
    high = np.minimum(high + approach_deg, stops[:, 1] - approach_deg - 1.0)
    return deg_to_rad((high - low) / (settings.knots - 1))


def _um(plane: FocalPlane, square_rad2: Floats) -> float:
    """um rms of the fibre, of mean squares (2,) of the angles of alpha and beta."""
    return UM_PER_MM * math.sqrt(float(levers_mm2(plane) @ square_rad2))


# terms of the blind move


def blind_terms(plane: FocalPlane, units: Units, settings: BudgetSettings) -> dict[str, float]:
    """um rms by name, those that a correction takes off.

    `plane`: the layout; `units`: drawn for it; `settings`: knots, and errors of the tables.
    """
    camera_um = plane.instrument.metrology.noise_rms_um
    seat = BETWEEN_NODES * (units.plant["seat_rms"] ** 2).mean(axis=0)
    sensors = sensors_rad2(units)
    arrival = seat + sensors
    return {
        "gear between knots": _um(plane, gear_rad2(plane, units, settings)),
        "camera at knots": _um(plane, BETWEEN_KNOTS * camera_rad2(plane, camera_um)),
        "seat at knots": _um(plane, BETWEEN_KNOTS * (seat + sensors)),
        "arrival": _um(plane, arrival),
        "arms of the table": arms_um(plane, units),
        "temperature": temperature_um(plane, settings.errors, units.seed),
    }


def gear_rad2(plane: FocalPlane, units: Units, settings: BudgetSettings) -> Floats:
    """(2,) mean square of what the map leaves of the gears' waves, over all phases."""
    phase = ORDERS * step_rad(plane, settings)[:, None]
    chord = np.sinc(phase / (2.0 * np.pi)) ** 2
    left = 1.0 + (2.0 + np.cos(phase)) / 3.0 - 2.0 * chord
    found: Floats = (0.5 * _wave_rad2(units) * left).sum(axis=1)
    return found


def _wave_rad2(units: Units) -> Floats:
    """(2, orders) mean square amplitudes of the deviation of the gears of alpha and beta."""
    found: Floats = (units.gear["delta_rad"] ** 2).sum(axis=-1).mean(axis=0)
    return found


def camera_rad2(plane: FocalPlane, camera_um: float) -> Floats:
    """(2,) mean square angle of one image of a sweep, across its lever."""
    a, b = plane.l_alpha_mm.mean(), plane.l_beta_mm.mean()
    lever2 = a**2 + b**2 + 2.0 * a * b * math.cos(math.radians(SWEEP_BETA_DEG))
    return 0.5 * (camera_um * MM_PER_UM) ** 2 / np.array([lever2, b**2])


def sensors_rad2(units: Units) -> Floats:
    """(2,) mean square at the output of the hall sensors' errors and of the landing.

    Offsets and amplitudes that the firmware has wrong turn the motor by their share of the amplitude.
    """
    true, known = units.plant, units.firmware
    amplitude = true["hall_amplitude_a"]
    offset = sum(((true[k] - known[k]) / amplitude) ** 2 for k in ("hall_offset_a", "hall_offset_b"))
    length = sum((true[k] / known[k] - 1.0) ** 2 for k in ("hall_amplitude_a", "hall_amplitude_b"))
    phase = (true["hall_phase"] - known["hall_phase"]) ** 2
    motor = 0.5 * offset + 0.125 * length + 0.375 * phase + LANDING_RMS_RAD**2
    found: Floats = np.mean(motor, axis=0) / GEAR**2
    return found


def arms_um(plane: FocalPlane, units: Units) -> float:
    """What centres and lengths of the true arms leave, their zeros tied to the layout by the sweep."""
    off = units.arms - plane.arms
    errors = np.column_stack([off[:, :2], off[:, L_ALPHA], units.beta_longer_mm])
    low, high = plane.limits_deg[1]
    form = left_mm2(float(plane.l_alpha_mm.mean()), float(plane.l_beta_mm.mean()), (low, high))
    return UM_PER_MM * math.sqrt(float(np.einsum("ni,ij,nj->n", errors, form, errors).mean()))


def temperature_um(plane: FocalPlane, errors: TwinErrors, seed: int) -> float:
    """Growth of both arms against the plate in the night that the `seed` draws, and its scatter."""
    night = errors.temperature
    if not night.on:
        return 0.0
    warmer_K = night.warmer_K(seed)
    square = night.arms_per_K(seed) ** 2 + (night.arm_scatter * night.arm_per_K) ** 2
    fibre_mm = plane.points[plane.instrument.science_fibres[0]]
    lever_mm2 = np.mean(plane.l_alpha_mm**2) + np.nanmean((fibre_mm**2).sum(axis=1))
    return UM_PER_MM * abs(warmer_K) * math.sqrt(square * float(lever_mm2))


# what lasts


def lasting_terms(plane: FocalPlane, units: Units, settings: BudgetSettings) -> list[Term]:
    """Those that the camera does not see.

    `plane`: the layout; `units`: drawn for it; `settings`: errors of tables, attitude of the telescope. The
    frame is the camera's: it counts from the first image on. Gravity counts as far as it changes from the
    image to the exposure.
    """
    fibre_um = _fibre_um(units, plane.instrument.science_fibres[0])
    sag_um = gravity_um(plane, units, settings.zenith_deg)
    turned_um = 2.0 * math.sin(math.radians(0.5 * settings.turn_deg)) * sag_um
    return [
        Term("fibre", fibre_um, fibre_um),
        Term("frame", 0.0, frame_um(plane, settings.errors)),
        Term("gravity", sag_um, turned_um),
    ]


def _fibre_um(units: Units, fibre: str) -> float:
    """The science fibre against the metrology fibre."""
    off_mm = units.fibre_offset_mm.get(fibre)
    if fibre == METROLOGY or off_mm is None:
        return 0.0
    return UM_PER_MM * math.sqrt(float((off_mm**2).sum(axis=1).mean()))


def frame_um(plane: FocalPlane, errors: TwinErrors) -> float:
    """The frame fitted on fiducials whose table is wrong: sigma sqrt(trace B (A^T A)^-1 B^T).

    A: the fitted fields at the fiducials, B: at the positioners, mean over these; both coordinates.
    """
    at = plane.fiducials[:, :2]
    if not len(at):
        return 0.0
    terms = DEFAULT_TERMS if 2 * len(at) >= len(DEFAULT_TERMS) + 8 else SIMILARITY_TERMS
    radius_mm = view_of(plane)[1]
    known, asked = (basis(xy / radius_mm, terms) for xy in (at, plane.centres_mm))
    inverse = np.linalg.pinv(np.einsum("knc,lnc->kl", known, known))
    square = np.einsum("knc,kl,lnc->n", asked, inverse, asked)
    return errors.fiducial_um * math.sqrt(float(square.mean()))


def gravity_um(plane: FocalPlane, units: Units, zenith_deg: float) -> float:
    """Arms that sag, the axes' directions spread evenly, in the telescope at this zenith distance."""
    moments = np.hypot(units.load["moment_x"], units.load["moment_y"])
    torque_Nm = moments * STANDARD_GRAVITY_M_S2 * math.sin(math.radians(zenith_deg))
    compliance = (1.0 / units.plant["stiffness"]).mean(axis=0)
    form = sag_mm2(float(plane.l_alpha_mm.mean()), float(plane.l_beta_mm.mean()), compliance)
    return UM_PER_MM * math.sqrt(float(np.einsum("ni,ij,nj->n", torque_Nm, form, torque_Nm).mean()))


# corrections


def slope_rms(plane: FocalPlane, units: Units, settings: BudgetSettings) -> float:
    """By which the offset of a fibre changes over the way of a correction, um per um, mean of both axes.

    The derivative of what the map leaves, a^2/2 m^2 (1 - (sin(p/2)/(p/2))^2), and of its noise between knots.
    """
    h = step_rad(plane, settings)
    phase = ORDERS * h[:, None]
    chord = np.sinc(phase / (2.0 * np.pi)) ** 2
    waves = (0.5 * _wave_rad2(units) * ORDERS**2 * (1.0 - chord)).sum(axis=1)
    camera_um = plane.instrument.metrology.noise_rms_um
    noise = camera_rad2(plane, camera_um) + BETWEEN_NODES * (units.plant["seat_rms"] ** 2).mean(axis=0)
    return math.sqrt(float(np.mean(waves + 2.0 * noise / h**2)))


def corrected_um(
    blind_um: float, camera_um: float, arrival_um: float, slope: float, corrections: int
) -> list[float]:
    """um rms after 1, 2, ... `corrections` by all images so far (Kronig 2020, Eq. 31 over the moves).

    An image tells the offset to `camera_um` and `arrival_um`; a way of w adds `slope` times w to what is not
    known of it; every arrival scatters anew. `blind_um`: the first way.
    """
    image_um2 = camera_um**2 + arrival_um**2
    known_um2, way_um, found = blind_um**2, blind_um, []
    for _ in range(corrections):
        both_um2 = known_um2 + image_um2
        known_um2 = known_um2 * image_um2 / both_um2 if both_um2 > 0.0 else 0.0
        known_um2 += (slope * way_um) ** 2
        way_um = math.sqrt(known_um2 + arrival_um**2)
        found.append(way_um)
    return found
