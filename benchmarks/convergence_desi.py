"""DESI for `benchmarks.convergence`: blind moves and corrections by the published law and by learned maps.

The motors are those of the twin (gears, play, scatter, arms as calibrated), without contacts: one target
after another in the whole reach. Laws see images of a camera and the air; the first `--fields` fields only
teach them, the last one is reported. Air is drawn for each fibre alone (`--air white`), or smooth over
`--air-mm` (`smooth`), and then taken off as far as it is found (`removed`): by fiducials and units that stand
still, whose places are taken as known, and for learned maps by all fibres too.
"""

import numpy as np

from fiberloom.drive.desi import PLANETARY, SMOOTH, LearnedMaps, TrackingLaw, move_tables
from fiberloom.drive.desi.clock import degrees_of
from fiberloom.drive.desi.maps.air import Air, StillPoints
from fiberloom.instruments import generate, load_instrument
from fiberloom.metrology.turbulence import remove_turbulence
from fiberloom.twin.camera.air import air_shift_mm
from fiberloom.twin.desi import PUBLISHED_FAULTS, DesiSizes, DesiTwin, draw_desi_units

PUBLISHED = {1: ("54", "0.35"), 2: ("9 (6 without air)", "0.03")}
"""Silber et al. 2022, Fig. 4 and 8: measured rms in um, share beyond 200 um in %."""


class Published:
    """The law of the instrument: blind by what is tracked, then by what is seen."""

    def __init__(self, plane, believed_deg, args):
        self.law = TrackingLaw(plane, believed_deg)

    def way_deg(self, goal_deg, move):
        return self.law.blind_way(goal_deg) if move == 0 else self.law.correction_way(goal_deg)

    def sigma_um(self, goal_deg):
        return np.full(len(goal_deg), np.nan)


class Learned:
    """Maps of all images so far; blind moves and corrections alike."""

    def __init__(self, plane, believed_deg, args):
        self.law = LearnedMaps(plane, believed_deg, {"planetary": PLANETARY, "smooth": SMOOTH}[args.basis])

    def way_deg(self, goal_deg, move):
        return self.law.way_deg(goal_deg)

    def sigma_um(self, goal_deg):
        return self.law.sigma_um(goal_deg)


def goals_deg(plane, rng):
    """(N, 2) angles of places drawn evenly from the whole reach."""
    out, missing = np.zeros((len(plane), 2)), np.ones(len(plane), dtype=bool)
    far = plane.l_alpha_mm + plane.l_beta_mm
    while missing.any():
        r, turn = far * np.sqrt(rng.random(len(plane))), rng.uniform(0.0, 2.0 * np.pi, len(plane))
        found = plane.inverse(plane.centres_mm + r[:, None] * np.column_stack([np.cos(turn), np.sin(turn)]))
        new = missing & found.reachable
        out[new] = np.column_stack([found.alpha_deg, found.beta_deg])[new]
        missing &= ~found.reachable
    return out


def converge(args):
    """Arrays of the file, of the last field."""
    rng = np.random.default_rng([args.seed, 0xC0])
    plane = generate(load_instrument("desi"), args.seed, args.units)
    sizes = PUBLISHED_FAULTS if args.faults else DesiSizes()
    start = goals_deg(plane, rng)
    twin = DesiTwin(
        plane, draw_desi_units(plane, args.seed, sizes), seed=args.seed, start_deg=start, contacts=False
    )
    law = {"peer": Published, "ours": Learned}[args.law](plane, start, args)
    for _ in range(args.fields):
        field(law, twin, goals_deg(plane, rng), 2, args, rng)
    return field(law, twin, goals_deg(plane, rng), args.moves, args, rng)


def field(law, twin, goal_deg, moves, args, rng):
    """One field: an image, a blind move, corrections, an image after each."""
    n, goal_mm = len(goal_deg), twin.plane.forward(*goal_deg.T)
    error, measured, cleared, gain = np.empty((4, n, moves))
    look(law, twin, args, rng)
    start = off_um(twin.fibre_xy(), goal_mm)
    sigma = law.sigma_um(goal_deg)
    for move in range(moves):
        before = twin.fibre_xy()
        tables = move_tables(law.way_deg(goal_deg, move), moving=np.ones(n, dtype=bool))
        twin.execute(tables)
        law.law.went(degrees_of(tables.way_tenths.sum(axis=1)))
        way, wanted = twin.fibre_xy() - before, goal_mm - before
        gain[:, move] = np.sum(way * wanted, axis=1) / np.maximum(np.sum(wanted**2, axis=1), 1e-12)
        error[:, move] = off_um(twin.fibre_xy(), goal_mm)
        raw, less_air = look(law, twin, args, rng)
        measured[:, move], cleared[:, move] = off_um(raw, goal_mm), off_um(less_air, goal_mm)
    return {
        "unit": twin.plane.positioner_id, "error_um": error, "measured_um": measured,
        "cleared_um": cleared, "gain": gain[:, 1:],
        "healthy": twin.units.healthy, "start_um": start, "blind_sigma_um": sigma,
    }  # fmt: skip


def look(law, twin, args, rng):
    """An image, which the law sees; where fibres seem to be, mm: as taken, and less the air that is found."""
    true, camera_mm = twin.fibre_xy(), 1e-3 * args.camera_um / np.sqrt(2.0)
    seen = true + camera_mm * rng.standard_normal(true.shape)
    points = np.vstack([true, twin.plane.fiducials[:, :2]])
    per_axis_um = args.air_um / np.sqrt(2.0)
    if args.air == "white":
        air = 1e-3 * per_axis_um * rng.standard_normal(points.shape)
    else:
        air = air_shift_mm(points, per_axis_um, args.air_mm, rng)
    n, raw = len(true), seen + air[: len(true)]
    if args.air == "white":
        law.law.see(raw, np.hypot(camera_mm, 1e-3 * per_axis_um), ~twin.dark)
        return raw, raw
    shift_mm, left_mm = np.zeros_like(raw), 1e-3 * per_axis_um
    if args.air == "removed":
        on_fiducials = air[n:] + camera_mm * rng.standard_normal(air[n:].shape)
        found = removed(law, twin, raw, on_fiducials, camera_mm)
        shift_mm, left_mm = found.shift_mm, found.sigma_mm
    law.law.see(raw - shift_mm, np.hypot(camera_mm, left_mm), ~twin.dark)
    return raw, raw - shift_mm


def removed(law, twin, raw_mm, fiducials_mm, camera_mm):
    """The air: by what stands still, and by all fibres where maps say how well they are known."""
    still = np.flatnonzero(twin.units.stuck & ~twin.dark)
    places = np.vstack([twin.plane.fiducials[:, :2], twin.fibre_xy()[still]])
    off = np.vstack([fiducials_mm, raw_mm[still] - twin.fibre_xy()[still]])
    if isinstance(law, Learned):
        return law.law.air_in(raw_mm, camera_mm, ~twin.dark, StillPoints(places, off, camera_mm))
    found = remove_turbulence(places, off, camera_mm, raw_mm)
    return Air(found.shift_mm, np.sqrt(found.variance_mm2))


def off_um(xy_mm, goal_mm):
    return 1e3 * np.hypot(*(xy_mm - goal_mm).T)


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


def table(found):
    """Lines: rms, 95 and 99 % of healthy units, true and measured."""
    lines = [f"start: median {np.median(found['start_um']):.0f} um; {found['healthy'].sum()} healthy units"]
    lines.append(
        f"{'move':>4} {'true rms um':>12} {'95 %':>7} {'99 %':>7} {'< 5 um':>7} {'measured rms':>13} "
        f"{'less air':>9} {'> 200 um':>9}   published: measured rms, > 200 um"
    )
    good = found["healthy"]
    for k in range(found["error_um"].shape[1]):
        true, seen = found["error_um"][good, k], found["measured_um"][good, k]
        less_air = found["cleared_um"][good, k]
        p95, p99 = np.percentile(true, [95, 99])
        lines.append(
            f"{k + 1:>4} {rms(true):>12.2f} {p95:>7.1f} {p99:>7.1f} {100 * np.mean(true < 5.0):>6.1f}% "
            f"{rms(seen):>13.2f} {rms(less_air):>9.2f} {100 * np.mean(seen > 200.0):>8.2f}%   "
            f"{', '.join(PUBLISHED.get(k + 1, ()))}"
        )
    sigma = found["blind_sigma_um"][good]
    if np.isfinite(sigma).all():
        lines.append(f"blind rms that the law expected: {rms(sigma):.2f} um")
    return lines
