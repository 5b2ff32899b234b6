"""How fast cobras converge: the true distance to the target after each move, by the peer's law and by ours.

    python -m benchmarks.convergence --instrument pfs --law peer --moves 8 --seed 0 --out peer.npz

The motors are those of the twin, with published maps where they are (`--maps FOLDER`), else with drawn ones.
Put in: the distances at the start (median and 95 % of visit 72752), the sizes of the motors' errors, the
camera. What comes out: all that is printed below the start; for DESI see `convergence_desi.py`. The file:
`unit` (n), `error_um` (n, moves; true), `measured_um` (n, moves), `gain` (n, moves - 1; share of the wanted
way that was gone), `healthy` (n).
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from benchmarks import convergence_desi

from fiberloom.drive.piezo import LearningLaw, SpeedScalingLaw, read_summary_maps
from fiberloom.drive.piezo.maps import PULSE_CURVE_US
from fiberloom.errors import InputError
from fiberloom.twin.actuators import PiezoErrors, PiezoMotors, drawn_maps

MAPS_FILE = "pfs_2394_motor_maps_slow.npz"
MAPS = Path(__file__).parents[2] / "shared" / "data" / "pfs" / "derived"
LINK_MM, LINK_SD = 2.375, 0.01
START_UM, START_95_UM = 822.0, 2694.0
THETA_RANGE_DEG, PHI_RANGE_DEG, PHI_IN_DEG = 380.0, 186.0, -182.6
"""phi of the arm is the angle from the counter-clockwise stop + PHI_IN; folded at -180 deg."""
PUBLISHED = {
    2: ("38.2", "344", "6.8", "16.5", "25"),
    3: ("9.7", "148", "24", "51", "7.6"),
    4: ("6.0", "54.7", "39", "79", "3.6"),
    6: ("5.1", "11.4", "48", "91", "1.4"),
    8: ("5.0", "10.6", "48", "93", "0.8"),
}
"""Visit 72752 (2022-04-20), all cobras, measured, by the number of moves: median and 95 % um; % below 5,
below 10, above 100 um."""


@dataclass(frozen=True)
class Cobras:
    """The arms of n cobras."""

    link_mm: np.ndarray
    """(n, 2)."""

    def xy_mm(self, angle_deg):
        """(n, 2) fibres, of motors' angles (2 n,)."""
        theta, phi = np.deg2rad(angle_deg[0::2]), np.deg2rad(angle_deg[1::2] + PHI_IN_DEG)
        end = self.link_mm[:, 0] * np.exp(1j * theta) + self.link_mm[:, 1] * np.exp(1j * (theta + phi))
        return np.column_stack([end.real, end.imag])

    def angles_deg(self, xy_mm, near_deg):
        """(2 n,) angles from the stops of fibres (n, 2); of two theta the one nearer to `near_deg` (2 n,).

        Places out of reach: the arm stretched or folded towards them.
        """
        fibre, (a, b) = xy_mm[:, 0] + 1j * xy_mm[:, 1], self.link_mm.T
        far = np.abs(fibre)
        phi = -np.arccos(np.clip((far**2 - a**2 - b**2) / (2 * a * b), -1.0, 1.0))
        theta = np.angle(fibre) - np.angle(a + b * np.exp(1j * phi))
        theta = np.rad2deg(theta) + 360.0 * np.rint((near_deg[0::2] - np.rad2deg(theta)) / 360.0)
        out = np.empty(2 * len(fibre))
        out[0::2], out[1::2] = theta, np.rad2deg(phi) - PHI_IN_DEG
        return out

    def sigma_deg(self, angle_deg, camera_um):
        """(2 n,) deg by which angles of an image err, for an error of the camera per axis."""
        far = np.maximum(np.hypot(*self.xy_mm(angle_deg).T), 0.3)
        phi = np.deg2rad(angle_deg[1::2] + PHI_IN_DEG)
        # d(far)/d(phi): how much a radial error turns phi
        lever = np.abs(self.link_mm[:, 0] * self.link_mm[:, 1] * np.sin(phi)) / far
        out = np.empty_like(angle_deg)
        out[0::2], out[1::2] = 1e-3 * camera_um / far, 1e-3 * camera_um / np.maximum(lever, 0.1)
        return np.rad2deg(out)


def targets_mm(cobras, motors, rng):
    """(n, 2) in reach, as far from where the fibres are as those of the published visit."""
    here = cobras.xy_mm(motors.angle_deg)
    n, out = len(here), here.copy()
    missing = np.ones(n, dtype=bool)
    log_sd = np.log(START_95_UM / START_UM) / 1.645
    far_um = START_UM * np.exp(log_sd * rng.standard_normal(n))
    for trial in range(400):
        turn = rng.uniform(0.0, 2.0 * np.pi, n)
        at = here + 1e-3 * far_um[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
        angles = cobras.angles_deg(at, motors.angle_deg)
        inside = (angles > 2.0) & (angles < motors.stops_deg - 2.0)
        hit = np.hypot(*(cobras.xy_mm(angles) - at).T) < 1e-6
        good = missing & inside[0::2] & inside[1::2] & hit
        out[good], missing[good] = at[good], False
        if trial % 100 == 99:  # as far as that there is nothing in reach
            far_um = np.where(missing, START_UM * np.exp(log_sd * rng.standard_normal(n)), far_um)
    if missing.any():
        raise InputError(f"{missing.sum()} cobras have no target in reach")
    return out


def converge(args):
    """Arrays of the file."""
    rng = np.random.default_rng(args.seed)
    folder = args.maps if args.maps is not None else MAPS if MAPS.is_dir() else None
    maps = (
        read_summary_maps(folder / MAPS_FILE, np.arange(1, 2395))
        if folder
        else drawn_maps(args.cobras, args.seed)
    )
    n = maps.motors // 2
    cobras = Cobras(LINK_MM * (1.0 + LINK_SD * rng.standard_normal((n, 2))))
    stops = np.tile([THETA_RANGE_DEG, PHI_RANGE_DEG], n)
    start = np.empty(2 * n)
    start[0::2], start[1::2] = rng.uniform(20.0, 360.0, n), rng.uniform(25.0, 165.0, n)
    motors = PiezoMotors(maps, stops, start, PiezoErrors(), args.seed + 1)
    goal_mm = targets_mm(cobras, motors, rng)
    law = SpeedScalingLaw(maps) if args.law == "peer" else LearningLaw(maps, np.tile(PULSE_CURVE_US, n))
    goal_deg = cobras.angles_deg(goal_mm, motors.angle_deg)
    error, measured, gain = np.empty((3, n, args.moves))
    stopped, left = np.zeros(n, dtype=bool), _off(cobras, motors, goal_mm)
    seen = _seen(cobras, motors, args, rng)
    for k in range(args.moves):
        seen_deg = cobras.angles_deg(seen, motors.angle_deg)
        sigma_deg = cobras.sigma_deg(seen_deg, args.camera_um)
        sent = law.command(seen_deg, goal_deg, sigma_deg, np.repeat(~stopped, 2))
        before = cobras.xy_mm(motors.angle_deg)
        motors.run(sent.steps, sent.pulse_us)
        way, wanted = cobras.xy_mm(motors.angle_deg) - before, goal_mm - before
        gain[:, k] = np.sum(way * wanted, axis=1) / np.maximum(np.sum(wanted**2, axis=1), 1e-12)
        seen = _seen(cobras, motors, args, rng)
        error[:, k], measured[:, k] = _off(cobras, motors, goal_mm), 1e3 * np.hypot(*(seen - goal_mm).T)
        stopped |= measured[:, k] < args.tolerance_um
    return {
        "unit": np.arange(1, n + 1), "error_um": error, "measured_um": measured, "gain": gain[:, 1:],
        "healthy": ~motors.stuck[0::2], "start_um": left,
    }  # fmt: skip


def _seen(cobras, motors, args, rng):
    at = cobras.xy_mm(motors.angle_deg)
    return at + 1e-3 * args.camera_um * rng.standard_normal(at.shape)


def _off(cobras, motors, goal_mm):
    return 1e3 * np.hypot(*(cobras.xy_mm(motors.angle_deg) - goal_mm).T)


def table(found):
    """Lines: as the published table, measured, of all; and the true share within 5 um of healthy cobras."""
    start = found["start_um"]
    lines = [f"start (put in): median {np.median(start):.0f} um, 95 % {np.percentile(start, 95):.0f} um"]
    head = f"{'move':>4} {'median um':>10} {'95 % um':>8} {'< 5 um':>7} {'< 10 um':>8} {'> 100 um':>9}"
    lines.append(f"{head}   {'healthy, true < 5 um':>20}   published (median, 95 %, <5, <10, >100)")
    for k, row in enumerate(found["measured_um"].T):
        true = found["error_um"][found["healthy"], k]
        shares = [100.0 * np.mean(flag) for flag in (row < 5.0, row < 10.0, row > 100.0)]
        published = ", ".join(PUBLISHED.get(k + 1, ()))
        shown = f"{k + 1:>4} {np.median(row):>10.1f} {np.percentile(row, 95):>8.1f} {shares[0]:>6.1f}% "
        shown += f"{shares[1]:>7.1f}% {shares[2]:>8.1f}%   {100.0 * np.mean(true < 5.0):>19.1f}%"
        lines.append(f"{shown}   {published}")
    return lines


def main():
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--instrument", choices=["pfs", "desi"], default="pfs")
    parser.add_argument("--law", choices=["peer", "ours"], default="ours")
    parser.add_argument("--moves", type=int, default=8, help="iterations to one target")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cobras", type=int, default=2394, help="how many, where maps are drawn")
    parser.add_argument("--maps", type=Path, help="folder of published maps")
    parser.add_argument(
        "--tolerance-um", type=float, help="a cobra stops once seen within; peer 10, ours 2.5"
    )
    parser.add_argument(
        "--camera-um", type=float, help="error of a place seen; pfs: 1, per axis; desi: 3, both axes together"
    )
    parser.add_argument("--air-um", type=float, default=6.0, help="desi: of the air, both axes together")
    parser.add_argument(
        "--air", choices=["white", "smooth", "removed"], default="white",
        help="desi: of each fibre alone, smooth, or smooth and taken off as far as it is found",
    )  # fmt: skip
    parser.add_argument("--air-mm", type=float, default=50.0, help="desi: length over which air is the same")
    parser.add_argument("--fields", type=int, default=30, help="desi: fields before the one that counts")
    parser.add_argument("--units", type=int, default=4647, help="desi: how many")
    parser.add_argument("--basis", choices=["planetary", "smooth"], default="planetary", help="desi, ours")
    parser.add_argument("--faults", action="store_true", help="desi: broken units as published")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    if args.tolerance_um is None:
        args.tolerance_um = {"peer": 10.0, "ours": 2.5}[args.law]
    of = convergence_desi if args.instrument == "desi" else sys.modules[__name__]
    if args.camera_um is None:
        args.camera_um = {"pfs": 1.0, "desi": 3.0}[args.instrument]
    try:
        found = of.converge(args)
    except (InputError, OSError, KeyError) as error:
        print(f"convergence: {error}", file=sys.stderr)
        return 2
    print("\n".join(of.table(found)))
    if args.out:
        np.savez(args.out, **found)
    return 0


if __name__ == "__main__":
    sys.exit(main())
