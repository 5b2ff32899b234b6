"""What is wrong with a design, all of it at once: geometry, ranges, camera, gear, spring."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fiberloom.design.coverage import covers, fillings
from fiberloom.design.gear import gear_window, output_deg, speed_for, twin_knows
from fiberloom.design.lattice import Lattice
from fiberloom.design.spring import spring_window
from fiberloom.errors import InputError
from fiberloom.instruments import AXES, FocalPlane, Instrument, generate
from fiberloom.planning.bodies import CollisionBodies
from fiberloom.planning.overlaps import Surroundings
from fiberloom.typing import Floats
from fiberloom.units import GEAR, UM_PER_MM, deg_to_rad

HOLES_SHARE = 1e-3
"""Share of the plane without a fibre from which holes are wrong; smaller ones are told."""
POINTS = 20_000
UNITS = 61
"""Whose springs are looked at, at most: medians are within 1 %."""
INNERMOST = 37
TRIED_DEG = 10.0
"""Steps in which another place to park is looked for."""


@dataclass(frozen=True)
class CheckFinding:
    """One thing that a design does not keep, or that is worth knowing."""

    about: str
    wrong: bool
    """False: worth knowing."""
    says: str
    """What, with numbers."""
    helps: str = ""
    """What would."""

    def __str__(self) -> str:
        helps = f"; {self.helps}" if self.helps else ""
        return f"{'wrong' if self.wrong else 'note'}: {self.about}: {self.says}{helps}"


def check(instrument: Instrument, seed: int = 0, within_s: float | None = None) -> list[CheckFinding]:
    """All findings on an `instrument`, what is wrong first; units drawn by `seed`.

    `within_s`: time in s in which either axis must make its whole range; None: not asked for.

    Raises
    ------
    InputError
        A time that is not above 0.
    """
    if within_s is not None and not within_s > 0.0:
        raise InputError(f"--within {within_s:g}: a time above 0 s")
    plane = generate(instrument, seed)
    found: list[CheckFinding] = []
    asked = _Asked(seed, within_s)
    for about, look in _LOOKS:
        found += _found(about, look, plane, asked)
    return sorted(found, key=lambda one: not one.wrong)


@dataclass(frozen=True)
class _Asked:
    """As of `check`."""

    seed: int
    within_s: float | None


_Look = Callable[[FocalPlane, _Asked], Iterable[CheckFinding]]


def _found(about: str, look: _Look, plane: FocalPlane, asked: _Asked) -> list[CheckFinding]:
    """Of one look; what a tool refuses is a finding too."""
    try:
        return list(look(plane, asked))
    except InputError as error:
        return [CheckFinding(about, True, str(error))]


# bodies


def _bodies(plane: FocalPlane, _: _Asked) -> Iterator[CheckFinding]:
    """Capsules of the pitch's width, and parked arms that touch."""
    instrument = plane.instrument
    width_mm, pitch_mm = 2.0 * plane.collision_buffer_mm, instrument.layout.pitch_mm
    if width_mm >= pitch_mm:
        yield CheckFinding(
            "beta arm",
            True,
            f"its capsule is {width_mm:g} mm wide, the pitch is {pitch_mm:g} mm: nothing can move",
            f"bodies.collision_buffer_mm below {0.5 * pitch_mm:g}",
        )
        return
    surroundings = Surroundings(plane, CollisionBodies.of(plane))
    overlaps = surroundings.overlapping(deg_to_rad(plane.park_deg))
    if overlaps:
        yield _parked(surroundings, overlaps)
    yield from _shared_ground(instrument)


def _parked(surroundings: Surroundings, overlaps: dict[tuple[int, int], float]) -> CheckFinding:
    row, other = max(overlaps, key=lambda pair: overlaps[pair])
    plane = surroundings.plane
    park = ", ".join(f"{a:g}" for a in plane.instrument.positioner.park_deg)
    return CheckFinding(
        "parking",
        True,
        f"{len(overlaps)} pairs touch at park_deg [{park}]: worst {surroundings.name(row)} and "
        f"{surroundings.name(other)}, by {overlaps[row, other]:.3f} mm",
        _other_park(plane),
    )


def _other_park(plane: FocalPlane) -> str:
    """Another place to park of the innermost positioners, with the widest gap; or which buffer would do."""
    inner = np.argsort(np.linalg.norm(plane.centres_mm, axis=1), kind="stable")[:INNERMOST]
    some = plane.select(np.sort(inner))
    surroundings = Surroundings(some, CollisionBodies.of(some))
    (alpha_low, alpha_high), (beta_low, beta_high) = some.limits_deg
    tries = [
        (alpha, beta)
        for alpha in np.arange(alpha_low, min(alpha_low + 360.0, alpha_high), TRIED_DEG)
        for beta in {float(np.clip(b, beta_low, beta_high)) for b in (180.0, -180.0, 170.0, -170.0)}
    ]
    gaps = [_least_gap_mm(surroundings, np.tile(deg_to_rad(one), (some.n, 1))) for one in tries]
    best = int(np.argmax(gaps))
    if gaps[best] > 0.0:
        return f"park_deg = [{tries[best][0]:g}, {tries[best][1]:g}] leaves {gaps[best]:.2f} mm"
    most_mm = plane.collision_buffer_mm + 0.5 * gaps[best]
    return f"bodies.collision_buffer_mm of {most_mm:.2f} or less, a wider pitch or shorter arms"


def _least_gap_mm(surroundings: Surroundings, angles_rad: Floats) -> float:
    return float(surroundings.gaps_of_pairs_mm(angles_rad)[2].min(initial=np.inf))


def _shared_ground(instrument: Instrument) -> Iterator[CheckFinding]:
    """Folded arms that turn freely need a circle of their own."""
    l_alpha_mm, bodies = instrument.positioner.l_alpha_mm, instrument.bodies
    fold = math.radians(instrument.positioner.park_deg[1])
    along = np.array(bodies.beta_segment_mm)
    farthest_mm = float(np.hypot(l_alpha_mm + along * math.cos(fold), along * math.sin(fold)).max())
    needed_mm = farthest_mm + bodies.collision_buffer_mm
    half_mm = 0.5 * instrument.layout.pitch_mm
    if needed_mm > half_mm:
        yield CheckFinding(
            "parking",
            False,
            f"a folded arm needs {needed_mm:.2f} mm around its centre to turn, half the pitch is {half_mm:g} "
            "mm: neighbours are in each other's way when folded too",
            f"an elbow {needed_mm - half_mm:.2f} mm nearer would free them",
        )


# coverage


def _holes(plane: FocalPlane, _: _Asked) -> Iterator[CheckFinding]:
    """Points that no fibre reaches, of every fibre that all positioners carry."""
    instrument = plane.instrument
    for fibre in instrument.science_fibres:
        if instrument.positioner.points[fibre].fraction == 1.0:
            yield from _holes_of(Lattice.of(instrument, fibre), fibre, instrument.operation.requirement_um)


def _holes_of(lattice: Lattice, fibre: str, requirement_um: float) -> Iterator[CheckFinding]:
    points = lattice.random_points_mm(POINTS, 0)
    free, limited = ((lattice.count(points, free=free) == 0).mean() for free in (True, False))
    if limited > max(2.0 * free, free + HOLES_SHARE):
        yield CheckFinding(
            "ranges",
            True,
            f"{limited:.2%} of the plane has no {fibre} fibre, {free:.2%} if both axes turned freely",
            _wider(lattice),
        )
    if free > HOLES_SHARE or not covers(lattice):
        yield _hole(lattice, fibre, float(free), requirement_um)


def _wider(lattice: Lattice) -> str:
    """Which of the ranges would help."""
    alpha, beta = lattice.alpha_range_deg, lattice.beta_range_deg
    words = []
    if alpha[1] - alpha[0] < 360.0:
        words.append(f"alpha.target_range_deg of 360 deg in place of {alpha[1] - alpha[0]:g}")
    if not (min(map(abs, beta)) < 1.0 and max(map(abs, beta)) > 179.0):
        words.append(f"beta.target_range_deg from 0 to 180 in place of {beta[0]:g} to {beta[1]:g}")
    return " and ".join(words)


def _hole(lattice: Lattice, fibre: str, share: float, requirement_um: float) -> CheckFinding:
    size_um = UM_PER_MM * float(lattice.gap_mm(lattice.symmetric_points_mm()).max())
    wrong = share > HOLES_SHARE
    small = "" if wrong else ", too small to count"
    fills = " or ".join(f"{f.length} of {f.to_mm:.4f}" for f in fillings(lattice))
    return CheckFinding(
        "coverage",
        wrong,
        f"holes: a place is {size_um:.1f} um out of reach of every {fibre} fibre, {share:.2%} of the plane"
        f"{small}{'' if size_um > requirement_um else ', below the requirement'}",
        fills or "no length changed by a quarter fills them: longer arms and a smaller pitch",
    )


# camera


def _camera(plane: FocalPlane, _: _Asked) -> Iterator[CheckFinding]:
    """Fibres that the image does not hold, and noise beyond the requirement."""
    instrument = plane.instrument
    if not instrument.metrology.present:
        yield CheckFinding("camera", False, "there is none: nothing is corrected")
        return
    yield from _noise(instrument)
    if instrument.camera is not None:
        yield from _view(plane)


def _noise(instrument: Instrument) -> Iterator[CheckFinding]:
    noise_um, operation = instrument.metrology.noise_rms_um, instrument.operation
    moves = max(operation.corrections_max, 1) if operation.correction == "filtered" else 1
    least_um = noise_um / math.sqrt(operation.images_max * moves)  # the filter weighs all images
    if least_um > 0.5 * operation.requirement_um:
        images = math.ceil((noise_um / (0.46 * operation.requirement_um)) ** 2 / moves)
        beyond = math.exp(-((operation.requirement_um / least_um) ** 2))
        yield CheckFinding(
            "camera",
            beyond > 0.01,
            f"its noise alone leaves {least_um:.2f} um rms: {beyond:.1%} of the fibres beyond "
            f"{operation.requirement_um:g} um",
            f"operation.images_max of {images}",
        )


def _view(plane: FocalPlane) -> Iterator[CheckFinding]:
    camera = plane.instrument.camera
    assert camera is not None
    reach_mm = plane.l_alpha_mm + plane.l_beta_mm
    turn = math.radians(camera.rotation_deg)
    axes = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    needed_mm = (np.abs(plane.centres_mm @ axes.T) + reach_mm[:, None]).max(axis=0)
    for side, half_needed_mm, pixels in zip(
        ("width_px", "height_px"), needed_mm, (camera.width_px, camera.height_px), strict=True
    ):
        if half_needed_mm > 0.5 * pixels * camera.scale_mm_px:
            yield CheckFinding(
                "camera",
                True,
                f"{side} {pixels} at {camera.scale_mm_px:g} mm shows {0.5 * pixels * camera.scale_mm_px:.1f} "
                f"mm from the middle, fibres go to {half_needed_mm:.1f} mm",
                f"{math.ceil(2.0 * half_needed_mm / camera.scale_mm_px)} px, or camera.scale_mm_px of "
                f"{2.0 * half_needed_mm / pixels:.4f}",
            )
    far_mm = float((np.linalg.norm(plane.centres_mm, axis=1) + reach_mm).max())
    if far_mm > camera.field_radius_mm:
        yield CheckFinding(
            "camera",
            True,
            f"camera.field_radius_mm {camera.field_radius_mm:g}: fibres go to {far_mm:.1f} mm, where terms "
            "of the distortion run away",
            f"camera.field_radius_mm of {math.ceil(far_mm)}",
        )


# motors


def _gears(plane: FocalPlane, asked: _Asked) -> Iterator[CheckFinding]:
    """Ratios, steps and play against the requirement; speed against the time."""
    for axis in (0, 1):
        yield from _found(f"gear of {AXES[axis]}", _gear_of(axis), plane, asked)


def _gear_of(axis: int) -> _Look:
    def look(plane: FocalPlane, asked: _Asked) -> Iterator[CheckFinding]:
        instrument = plane.instrument
        own = instrument.axes[axis]
        window = gear_window(instrument, axis)
        if own.kind == "bldc" and window.ratio < window.least:
            yield CheckFinding(
                f"gear of {AXES[axis]}",
                True,
                f"ratio {window.ratio:g}: a motor that is off by 5 deg moves the fibre by "
                f"{5.0 / window.motor_deg_um:.1f} um, {window.requirement_um:g} are allowed",
                f"{AXES[axis]}.gear of {window.least} or more",
            )
        if 0.5 * window.step_um > window.requirement_um:
            most_deg = 2.0 * output_deg(window.requirement_um, window.lever_mm)
            yield CheckFinding(
                f"gear of {AXES[axis]}",
                True,
                f"a step is {window.step_um:.1f} um at {window.lever_mm:.2f} mm: half of it is beyond the "
                f"requirement of {window.requirement_um:g} um",
                f"steps of {most_deg:.4f} deg or less at the output",
            )
        if window.play_um > window.requirement_um and own.approach_deg == 0.0:
            yield CheckFinding(
                f"gear of {AXES[axis]}",
                True,
                f"its play is {window.play_um:.1f} um and nothing closes it",
                f"{AXES[axis]}.approach_deg of {1.2 * own.backlash_deg:.3f} or more, with a spring",
            )
        if asked.within_s is not None and window.range_s > asked.within_s:
            yield _late(instrument, axis, asked.within_s, window.range_s)

    return look


def _late(instrument: Instrument, axis: int, within_s: float, range_s: float) -> CheckFinding:
    own = instrument.axes[axis]
    way_deg = own.target_range_deg[1] - own.target_range_deg[0]
    gear_window(instrument, axis, within_s=within_s)  # refuses what the acceleration does not allow
    speed_deg_s = speed_for(way_deg, within_s, own.acceleration_deg_s2)
    assert speed_deg_s is not None
    ratio = own.gear * own.speed_deg_s / speed_deg_s
    return CheckFinding(
        f"gear of {AXES[axis]}",
        True,
        f"{way_deg:g} deg take {range_s:.2f} s, {within_s:g} s are allowed",
        f"{AXES[axis]}.speed_deg_s of {speed_deg_s:.2f}: a gear of {ratio:.0f} in place of {own.gear:g}, or "
        f"a motor of {own.gear * speed_deg_s / 6.0:.0f} rpm",
    )


def _springs(plane: FocalPlane, asked: _Asked) -> Iterator[CheckFinding]:
    """Windows of the springs against backlash, where the twin knows the motors."""
    instrument = plane.instrument
    unknown = [AXES[k] for k, own in enumerate(instrument.axes) if not twin_knows(own)]
    if unknown:
        yield CheckFinding(
            "spring",
            False,
            f"not looked at: of {' and '.join(unknown)} no friction and no spring is known (bldc motors of "
            f"gear {GEAR:g} only)",
        )
        return
    for axis in (0, 1):
        window = spring_window(instrument, axis, seed=asked.seed, n=UNITS)
        if (advice := window.advice()) == "fits":
            continue
        least = replace(window, factor=1.0).advice()
        says = advice if least == "fits" else least
        yield CheckFinding(
            f"spring of {AXES[axis]}",
            least != "fits",
            f"{says} (load {window.load_mNm:g} mNm, factor {window.factor if least == 'fits' else 1:g})",
        )


_LOOKS: Sequence[tuple[str, _Look]] = (
    ("bodies", _bodies),
    ("coverage", _holes),
    ("camera", _camera),
    ("gear", _gears),
    ("spring", _springs),
)
