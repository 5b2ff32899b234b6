"""The moves that calibrate cobras, and what circles through the images tell.

Home; theta to where all arms are parallel: then phi goes from its stop out and back without touching
neighbours. Theta goes out and back with phi folded so far that arms stay in their territories: all at once,
or in three groups that cannot meet (cobraCharmer). A cobra whose arm could touch a fiducial, or a neighbour
that does not get there, is not swept in phi.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fiberloom.bus.motion import MotionWatch
from fiberloom.calibration.transmission.circle import Circles, fit_circles
from fiberloom.drive.pfs.calibration.maps import MapFit, Moves, fit_maps
from fiberloom.drive.pfs.client import Orders
from fiberloom.drive.pfs.drive import HOME_STEPS, CobraDrive
from fiberloom.drive.pfs.numbering import COBRAS_PER_MODULE
from fiberloom.drive.piezo import MotorMaps
from fiberloom.drive.piezo.maps import PULSE_CURVE_US
from fiberloom.drive.port import Wanted
from fiberloom.errors import InputError
from fiberloom.metrology import Camera
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import rad_to_deg

THETA, PHI = 0, 1
GROUPS = 3
SHORT_OF_STOP_DEG = 5.0
OPENING_MOVES = 3
FEWEST_SEEN = 8
"""Images of a motor's sweep, for its circle."""
TRAVEL_MM = 0.1
"""[A] A fibre that stays within so much has a motor that does not turn."""
STANDS = "its fibre does not move"
"""Of theta also where phi does not open: the fibre stays on the centre."""
MOST_OFF_MM = 0.05
"""Rms of places about their circle, at most."""


@dataclass(frozen=True)
class CobraSweepSettings:
    """How far and how often; the steps are those of cobraCharmer."""

    phi_steps: int = 250
    phi_moves: int = 20
    theta_steps: int = 500
    theta_moves: int = 20
    direction_deg: float = 90.0
    """Of the first links, in the focal plane, while phi is swept."""
    parallel_moves: int = 6
    parallel_deg: float = 15.0
    """How far they may be from there."""
    passes: int = 2
    """Out and back so often: what differs between them is scatter."""
    groups: int = 1
    """In which theta turns: 3 where arms are out; 1 where phi keeps them in their territories."""
    reach_mm: float = 1.3
    """From the centre to the fibre while theta turns: within the territory, and below the dot."""


@dataclass(frozen=True, eq=False)
class CobraSweep:
    """One motor's part: K moves, K + 1 images."""

    steps: Ints
    """(K,) signed, the same for all n cobras."""
    xy_mm: Floats
    """(K + 1, n, 2); NaN where not seen."""


@dataclass(frozen=True, eq=False)
class CobraCalibration:
    """What was found of n cobras."""

    centre_mm: Floats
    """(n, 2); NaN where `reason` says why."""
    link_mm: Floats
    """(n, 2)."""
    zero_deg: Floats
    """(n, 2) directions of the links at the counter-clockwise stops."""
    range_deg: Floats
    """(n, 2) from stop to stop; NaN where a stop was not reached."""
    motors: MapFit
    reason: list[str]
    """(n,) why a cobra has no geometry, or a motor no new map; empty: all is well."""

    @property
    def ok(self) -> Flags:
        """(n,) cobras with geometry and maps of both motors."""
        return np.array([not r for r in self.reason])


async def calibrate_cobras(
    drive: CobraDrive,
    camera: Camera,
    settings: CobraSweepSettings | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> CobraCalibration:
    """Sweeps all cobras and fits geometry, stops and motor maps.

    `drive` of n cobras, with the maps that are known; `camera` looks; `settings`; `progress` is told of each
    part. InputError where the camera sees none of the fibres.
    """
    s, ids = settings or CobraSweepSettings(), drive.plane.positioner_id
    work = _Work(drive, camera)
    progress("home")
    await drive.home()
    progress("arms parallel")
    free = await work.make_parallel(s)
    progress("phi out and back")
    await work.home(PHI)
    phi = await work.sweep(PHI, s.phi_steps, s.phi_moves, s.passes, free)
    progress("theta out and back")
    await drive.home()
    inside = await work.open_phi(s.reach_mm)
    group = _group_of(ids) % s.groups
    theta = [
        await work.sweep(THETA, s.theta_steps, s.theta_moves, s.passes, (group == k) & inside)
        for k in range(s.groups)
    ]
    found = evaluate(phi, _together(theta, ids, s.groups), drive.law.maps, s)
    return _not_swept(found, free)


def _not_swept(found: CobraCalibration, free: Flags) -> CobraCalibration:
    text = "phi: not swept, its arm could touch a fiducial or a neighbour that is not parallel"
    return replace(found, reason=[r if f else text for r, f in zip(found.reason, free, strict=True)])


def _group_of(cobra_id: Ints) -> Ints:
    """(n,) 0 to 2: cobras of one cannot meet (cobraCharmer)."""
    n = cobra_id - 1
    return (n + n // COBRAS_PER_MODULE + n // (14 * COBRAS_PER_MODULE)) % GROUPS


def _together(sweeps: list[CobraSweep], cobra_id: Ints, groups: int) -> CobraSweep:
    """The sweeps of groups as one: each cobra from the sweep in which it moved."""
    which = _group_of(cobra_id) % groups
    xy_mm = np.stack([sweep.xy_mm for sweep in sweeps])[which, :, np.arange(len(which))]
    return CobraSweep(sweeps[0].steps, xy_mm.transpose(1, 0, 2))


@dataclass
class _Work:
    """Moves all and looks."""

    drive: CobraDrive
    camera: Camera

    @property
    def cobra_id(self) -> Ints:
        return self.drive.plane.positioner_id

    @property
    def maps(self) -> MotorMaps:
        return self.drive.law.maps

    async def home(self, axis: int) -> None:
        await self._run(axis, -HOME_STEPS[axis], np.ones(len(self.cobra_id), dtype=bool))

    async def make_parallel(self, s: CobraSweepSettings) -> Flags:
        """First links in one direction; (n,) cobras whose phi can go out there without touching anything."""
        arms = self.drive.arms
        theta = (s.direction_deg - arms.zero_deg[:, THETA] - SHORT_OF_STOP_DEG) % 360.0 + SHORT_OF_STOP_DEG
        phi = arms.phi_within_deg(np.full(len(arms), s.reach_mm))
        await self._go(np.column_stack([theta, phi]), s.parallel_moves)
        off = np.abs(self.drive.expected_deg - np.column_stack([theta, phi]))
        parallel = np.all(off < s.parallel_deg, axis=1)  # phi too: where it is folded nothing shows theta
        return self.drive.stages.out_freely(theta, s.parallel_deg) & self._among(parallel)

    def _among(self, parallel: Flags) -> Flags:
        """(n,) cobras that are parallel, and all their neighbours with them."""
        pairs = self.drive.stages.check.pairs
        i, j = pairs[pairs[:, 1] < len(parallel)].T
        among = parallel.copy()
        among[i[~parallel[j]]] = False
        among[j[~parallel[i]]] = False
        return among

    async def open_phi(self, reach_mm: float) -> Flags:
        """Fibres out to `reach_mm`, theta at its stop; (n,) cobras that are within their territory then."""
        arms = self.drive.arms
        phi = arms.phi_within_deg(np.full(len(arms), reach_mm))
        await self._go(np.column_stack([np.zeros(len(arms)), phi]), OPENING_MOVES)
        return self.drive.stages.inside(self.drive.tracker.place_deg, self.drive.tracker.sigma_deg)

    async def _go(self, goal: Floats, moves: int) -> None:
        """Towards angles (n, 2) from the stops, in some iterations of the drive."""
        drive, everywhere = self.drive, np.ones(len(self.cobra_id), dtype=bool)
        for _ in range(moves):
            here = (await drive.believed(self.cobra_id)).angles_deg
            wanted = Wanted(drive.plane, here, drive.arms.arm_deg(drive.plane, goal), np.zeros_like(here))
            await drive.run(await drive.prepare(wanted), MotionWatch(), lambda text: None)
            drive.seen(self.camera.measure(drive.arms.xy_mm(drive.expected_deg)), everywhere)

    async def sweep(
        self, axis: int, steps: int, moves: int, passes: int, who: Flags | None = None
    ) -> CobraSweep:
        told = np.tile(np.repeat([steps, -steps], moves), passes)
        chosen = np.ones(len(self.cobra_id), dtype=bool) if who is None else who
        seen = [self._look()]
        for one in told.tolist():
            await self._run(axis, one, chosen)
            seen.append(self._look())
        xy_mm = np.array(seen)
        if not np.isfinite(xy_mm).any():
            raise InputError("the camera sees none of the fibres; check the back-illumination")
        # what did not move tells nothing, least of all of how far it goes
        xy_mm[:, ~chosen] = np.nan
        return CobraSweep(told, xy_mm)

    def _look(self) -> Floats:
        image = self.camera.measure(None)
        return np.where(image.seen[:, None], image.xy_mm, np.nan)

    async def _run(self, axis: int, steps: int, who: Flags) -> None:
        told = np.zeros((len(self.cobra_id), 2), dtype=np.int64)
        told[who, axis] = steps
        await self.drive.client.run(Orders(self.cobra_id, told, self._pulse_us(steps)))

    def _pulse_us(self, steps: int) -> Floats:
        pulse_us: Floats = self.maps.pulse_us[:, int(steps < 0)].reshape(-1, 2)
        return pulse_us


def evaluate(
    phi: CobraSweep, theta: CobraSweep, before: MotorMaps, settings: CobraSweepSettings
) -> CobraCalibration:
    """Geometry and maps of n cobras from their sweeps `phi` and `theta`; `before`: maps known; `settings`."""
    circles = [fit_circles(sweep.xy_mm.transpose(1, 0, 2), _all_of(sweep)) for sweep in (theta, phi)]
    reason = _why_not(circles)
    bad = np.array([bool(r) for r in reason])
    centre, elbow = circles[THETA].centre_mm, circles[PHI].centre_mm
    first = elbow - centre
    link = np.column_stack([np.hypot(*first.T), circles[PHI].radius_mm])
    link[bad] = np.nan
    turned = _turned(phi, elbow)
    along = rad_to_deg(np.arctan2(first[:, 1], first[:, 0]))
    phi_zero = (rad_to_deg(np.arctan2(*(phi.xy_mm[0] - elbow).T[::-1])) - along) % 360.0 - 360.0
    first_deg = _theta_zero(theta.xy_mm[0] - centre, link)
    ranges = np.column_stack([_range(_turned(theta, centre)), _range(turned)])
    places = np.stack([_turned(theta, centre), turned], axis=2)
    places[:, ~np.column_stack([_travelled(theta), _travelled(phi)])] = np.nan
    motors = _with_standing(_both(before, theta, phi, places, ranges, settings), (theta, phi))
    for row, (a, b) in enumerate(zip(motors.reason[0::2], motors.reason[1::2], strict=True)):
        named = [f"{name}: {r}" for name, r in (("theta", a), ("phi", b)) if r]
        reason[row] = reason[row] or "; ".join(named)
    out = [np.where(bad[:, None], np.nan, a) for a in (centre, link, np.column_stack([first_deg, phi_zero]))]
    return CobraCalibration(out[0], out[1], out[2], np.where(bad[:, None], np.nan, ranges), motors, reason)


def _theta_zero(fibre_mm: Floats, link: Floats) -> Floats:
    """(n,) deg, the direction of the first link at theta's stop, by fibres (n, 2) less their centres."""
    a, b = link.T
    bend = ((fibre_mm**2).sum(axis=1) - a**2 - b**2) / (2.0 * a * b)
    bent = a + b * np.exp(-1j * np.arccos(np.clip(bend, -1.0, 1.0)))
    return rad_to_deg(np.arctan2(fibre_mm[:, 1], fibre_mm[:, 0]) - np.angle(bent))


def _all_of(sweep: CobraSweep) -> Flags:
    return np.asarray(np.isfinite(sweep.xy_mm).all(axis=2).T, dtype=np.bool_)


def _travelled(sweep: CobraSweep) -> Flags:
    """(n,) fibres that a motor has moved at all: figures of one that stands are noise."""
    seen = np.isfinite(sweep.xy_mm)
    least, most = np.where(seen, sweep.xy_mm, np.inf), np.where(seen, sweep.xy_mm, -np.inf)
    travelled: Flags = (most.max(axis=0) - least.min(axis=0)).max(axis=1) > TRAVEL_MM
    return travelled


def _with_standing(motors: MapFit, sweeps: tuple[CobraSweep, CobraSweep]) -> MapFit:
    """With those motors named that were swept and moved no fibre; `sweeps` of theta and phi."""
    stands = np.column_stack([_often_seen(sweep) & ~_travelled(sweep) for sweep in sweeps]).ravel()
    return replace(motors, reason=[STANDS if s else r for r, s in zip(motors.reason, stands, strict=True)])


def _often_seen(sweep: CobraSweep) -> Flags:
    """(n,) fibres seen in so many images of a sweep that a motor that turns would have shown it."""
    often: Flags = np.isfinite(sweep.xy_mm).all(axis=2).sum(axis=0) >= FEWEST_SEEN
    return often


def _why_not(circles: list[Circles]) -> list[str]:
    """(n,) why there is no geometry."""
    out = []
    for row in range(len(circles[THETA].radius_mm)):
        why = ""
        for name, c in zip(("theta", "phi"), circles, strict=True):
            if c.used[row].sum() < FEWEST_SEEN:
                why = why or f"{name}: seen in {int(c.used[row].sum())} images, {FEWEST_SEEN} are needed"
            elif not c.rms_mm[row] < MOST_OFF_MM:
                why = why or f"{name}: places are {1e3 * c.rms_mm[row]:.0f} um rms off a circle"
            elif not 0.1 < c.radius_mm[row] < 10.0:
                why = why or f"{name}: a circle of {c.radius_mm[row]:.3g} mm; the motor does not turn"
        out.append(why)
    return out


def _turned(sweep: CobraSweep, middle_mm: Floats) -> Floats:
    """(K + 1, n) deg turned since the first image, along the sweep; NaN where not seen.

    What an image or more did not show may have been most of a turn: it was one in the direction of the steps,
    but for BACKWARD_DEG that a motor may go astray.
    """
    at = sweep.xy_mm - middle_mm
    angle = rad_to_deg(np.arctan2(at[..., 1], at[..., 0]))
    turned = np.full(angle.shape, np.nan)
    last, total = np.nan_to_num(angle[0]), np.zeros(angle.shape[1])
    turned[0] = np.where(np.isfinite(angle[0]), 0.0, np.nan)
    for k, (now, sign) in enumerate(zip(angle[1:], np.sign(sweep.steps), strict=True), 1):
        seen = np.isfinite(now)
        step = sign * ((sign * (np.nan_to_num(now) - last) + BACKWARD_DEG) % 360.0 - BACKWARD_DEG)
        total = total + np.where(seen, step, 0.0)
        last = np.where(seen, now, last)
        turned[k] = np.where(seen, total, np.nan)
    return turned


BACKWARD_DEG = 90.0


def _range(turned: Floats) -> Floats:
    """(n,) deg to the clockwise stop, where moves ended at it: two places in a row alike."""
    top = np.nanmax(np.where(np.isfinite(turned), turned, -np.inf), axis=0)
    at_top = np.nansum(turned > top - STOP_DEG, axis=0)
    reached = at_top >= STOP_IMAGES
    return np.where(reached, top, np.nan)


STOP_DEG, STOP_IMAGES = 0.3, 3
"""So many images within so much of the farthest place: there is a stop."""


def _both(
    before: MotorMaps,
    theta: CobraSweep,
    phi: CobraSweep,
    places: Floats,
    ranges: Floats,
    s: CobraSweepSettings,
) -> MapFit:
    """Maps of all 2 n motors; each kind from its own sweep."""
    fits = []
    for axis, sweep in ((THETA, theta), (PHI, phi)):
        rows = np.arange(axis, before.motors, 2)
        steps = np.repeat(sweep.steps[:, None], len(rows), axis=1)
        own = MotorMaps(before.step_deg[rows], before.bin_deg, before.pulse_us[rows])
        pulse = own.pulse_us[np.arange(len(rows))[None, :], (steps < 0).astype(int)]
        top = np.where(np.isfinite(ranges[:, axis]), ranges[:, axis], np.inf)
        curve_us = np.full(len(rows), PULSE_CURVE_US[axis])
        fits.append(fit_maps(own, curve_us, Moves(steps, pulse, places[..., axis], s.passes), top))
    step_deg = np.stack([f.maps.step_deg for f in fits], axis=1).reshape(before.step_deg.shape)
    scatter = np.stack([f.scatter for f in fits], axis=1).ravel()
    reason = [r for pair in zip(fits[0].reason, fits[1].reason, strict=True) for r in pair]
    return MapFit(replace(before, step_deg=step_deg), scatter, reason)
