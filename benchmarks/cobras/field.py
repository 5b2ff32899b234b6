"""Whole fields of cobras on the twin: convergence, and contacts in its truth.

    python -m benchmarks.cobras.field --rule both --cobras 2394 --fields 2 --seed 0
    python -m benchmarks.cobras.field --rule both --layout DIR --maps FILE

Fields begin at home, each further one where the one before has ended. `--rule ours`: stages whose swept
regions cannot meet. `--rule via`: the published rule, via points in the first two iterations (phi at most
60 deg open, theta behind by half of what phi lacks), pulses scaled, nothing checked; which elbow and which
turn it has is taken from the truth. `--rule both`: one after the other, to the same goals. `--cold`: with
maps as they were before their lasting errors, else ours are calibrated first. Goals do not touch, are not
behind dots, and no way out crosses another one's, as the drive asks of an assignment (`--crossing`: they
may). The camera has the noise of the instrument, and knows whose spot is whose. Errors are true ones of the
cobras that are not stuck.
"""

import argparse
import asyncio
import sys
import time
from pathlib import Path

import numpy as np

from fiberloom._core.geometry import segment_distance
from fiberloom.assignment.candidates import Block
from fiberloom.drive.pfs.client import Orders
from fiberloom.drive.piezo import SpeedScalingLaw, read_summary_maps
from fiberloom.drive.piezo.cobras import stops_deg
from fiberloom.drive.piezo.ways_out import WaysOut
from fiberloom.drive.port import Wanted
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.twin.cobras.source import CobraSource

TRIALS, APART_MM, MOVES = 30, 0.05, 8
OPEN_DEG, CLOSE_UM = 60.0, {"ours": 2.5, "via": 5.0}
VIA_MOVES = 2
HEAD = "move  median um    rms um   95 % um   99 % um   < 5 um < 10 um > 100 um  refused  contacts  hidden"


def drawn_goals(drive, dots_mm, rng, crossing):
    """(n, 2) deg from the stops, and (n,) which have one: evenly over the reach, none touching another.

    As an assignment gives them: none behind its dot, and where not `crossing` none in another one's way out.
    """
    arms, n, pairs = drive.arms, len(drive.arms), drive.stages.check.pairs
    reach = np.sqrt(rng.uniform(0.05, 0.97, (TRIALS, n))) * arms.link_mm.sum(axis=1)
    turn = rng.uniform(0.0, 2.0 * np.pi, (TRIALS, n))
    places = arms.centre_mm + np.stack([reach * np.cos(turn), reach * np.sin(turn)], axis=2)
    angles = np.array([arms.angles_deg(place, np.full((n, 2), 180.0)) for place in places])
    low, rows, rule = stops_deg(drive.plane)[0], np.arange(n), WaysOut.of(drive.plane)
    open_ = np.all((angles > 2.0) & (angles < arms.range_deg - 2.0), axis=2)
    open_ &= np.hypot(*np.moveaxis(places - dots_mm[:, :2], 2, 0)) > dots_mm[:, 2] + APART_MM
    if not crossing:
        for k in range(TRIALS):
            open_[k] &= rule.blocks(rows, angles[k] + low) == Block.NONE
    rank, ours = rng.permutation(n), pairs[pairs[:, 1] < n]
    while True:
        has, trial = open_.any(axis=0), open_.argmax(axis=0)
        goal = np.where(has[:, None], angles[trial, rows], 10.0)
        met = ours[has[ours].all(axis=1)]
        met = met[bar(rule, arms, goal, low, met, crossing)]
        if len(met) == 0:
            return goal, has
        i, j = met.T
        lost = np.unique(np.where(rank[i] < rank[j], i, j))
        open_[trial[lost], lost] = False


def bar(rule, arms, goal, low, pairs, crossing):
    """(p,) pairs of goals of which both cannot be: they touch, or their ways out cross."""
    if not crossing:
        return rule.crossing(np.arange(len(goal)), goal + low, *pairs.T)
    segments = arms.segments_mm(goal)
    i, j = pairs.T
    apart = segment_distance(segments[i], segments[j])
    return apart < arms.radius_mm[i] + arms.radius_mm[j] + APART_MM


async def iterate_ours(drive, goal, active):
    """One iteration of stages."""
    here = (await drive.believed(drive.plane.positioner_id)).angles_deg
    aim = np.where(active[:, None], goal + stops_deg(drive.plane)[0], here)
    programme = await drive.prepare(Wanted(drive.plane, here, aim, np.zeros_like(here)))
    if not (found := drive.verify(drive.plane, programme)).ok:
        raise InputError(f"the swept check refused what it had chosen: {found}")
    await drive.run(programme, None, lambda text: None)
    return len(programme.plan.refused)


async def iterate_via(drive, law, seen_deg, goal, active, move):
    """One iteration of the published rule."""
    aim = goal.copy()
    if move < VIA_MOVES:
        folded = -drive.arms.zero_deg[:, 1] - 180.0
        aim[:, 1] = np.minimum(goal[:, 1], folded + OPEN_DEG)
        aim[:, 0] = np.maximum(goal[:, 0] - 0.5 * (goal[:, 1] - aim[:, 1]), 0.0)
    sent = law.command(seen_deg.ravel(), aim.ravel(), np.zeros(aim.size), np.repeat(active, 2))
    steps, pulse_us = sent.steps.reshape(-1, 2), np.maximum(sent.pulse_us.reshape(-1, 2), 1.0)
    await drive.client.run(Orders(drive.plane.positioner_id, steps, pulse_us))
    return 0


async def field(source, drive, camera, args, rng, law):
    """The moves of one field; lines of the table."""
    array, n = source.array, len(source.plane)
    goal, has = drawn_goals(drive, array.dots_mm, rng, args.crossing)
    place_mm, healthy = drive.arms.xy_mm(goal), has & ~array.stuck
    stopped, before, begun_s = np.zeros(n, dtype=bool), len(array.touched), time.process_time()
    for move in range(MOVES):
        active = has & ~stopped
        if args.rule == "ours":
            refused = await iterate_ours(drive, goal, active)
        else:
            refused = await iterate_via(drive, law, drive.tracker.place_deg, goal, active, move)
            drive.believe(drive.tracker.place_deg, 1.0)
        image = camera.measure(None)
        drive.seen(image, np.ones(n, dtype=bool))
        if (
            args.rule == "via"
        ):  # the peer knows turns and elbows by its own bookkeeping: granted from the truth
            drive.believe(array.angle_deg, 0.1)
        off_um = 1e3 * np.hypot(*(image.xy_mm - place_mm).T)
        stopped |= off_um < CLOSE_UM[args.rule]
        true_um = 1e3 * np.hypot(*(array.fibre_xy() - place_mm).T)[healthy]
        shares = [100.0 * np.mean(flag) for flag in (true_um < 5.0, true_um < 10.0, true_um > 100.0)]
        print(
            f"{move + 1:>4} {np.median(true_um):>10.1f} {np.sqrt(np.mean(true_um**2)):>9.1f} "
            f"{np.percentile(true_um, 95):>9.1f} {np.percentile(true_um, 99):>9.1f} "
            f"{shares[0]:>6.1f}% {shares[1]:>6.1f}% {shares[2]:>8.1f}% {refused:>8} "
            f"{len(array.touched) - before:>9} {int(array.hidden.sum()):>7}"
        )
    print(f"{int(healthy.sum())} healthy cobras with a target; {time.process_time() - begun_s:.0f} CPU s")


async def fields(args):
    """All fields."""
    whole = FocalPlane.read(args.layout, "pfs") if args.layout else FocalPlane.of("pfs", seed=args.seed)
    plane = whole.select(np.arange(args.cobras))
    maps = read_summary_maps(args.maps, plane.positioner_id) if args.maps else None
    calibrated = args.rule == "ours" and not args.cold
    source = CobraSource(plane, args.seed, "noise", maps=maps, calibrated=calibrated)
    begun_s = time.process_time()
    hardware = await source.open()
    drive, rng = hardware.drive, np.random.default_rng(args.seed)
    if calibrated:
        found = source.calibrations[0]
        print(
            f"calibrated: {int(found.ok.sum())} of {len(plane)} cobras, "
            f"{time.process_time() - begun_s:.0f} CPU s, {source.calibration_contacts} contacts"
        )
    await drive.connect()
    law = SpeedScalingLaw(source.known_maps)
    for number in range(args.fields):
        print(f"field {number + 1}, rule: {args.rule}")
        print(HEAD)
        await field(source, drive, hardware.camera, args, rng, law)


def main():
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rule", choices=["ours", "via", "both"], default="ours")
    parser.add_argument("--layout", type=Path, help="tables of the instrument; default: a drawn plane")
    parser.add_argument("--maps", type=Path, help="summary of motor maps; default: drawn ones")
    parser.add_argument("--cobras", type=int, default=2394)
    parser.add_argument("--fields", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cold", action="store_true", help="maps are not calibrated before")
    parser.add_argument("--crossing", action="store_true", help="ways out to the goals may cross")
    args = parser.parse_args()
    try:
        for rule in ["via", "ours"] if args.rule == "both" else [args.rule]:
            asyncio.run(fields(argparse.Namespace(**(vars(args) | {"rule": rule}))))
    except InputError as error:
        print(f"cobras.field: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
