"""The firmware's collision watch on the twin: what it misses, what it imagines, what could be seen at all.

    python benchmarks/collision.py legal --units 500 --moves 20     no false detection in 10 000 legal moves
    python benchmarks/collision.py meet --rounds 2                  neighbours driven into each other
    python benchmarks/collision.py bound                            the smallest load that shows after t ms

`legal` ends with 1 if any move was taken for a collision. Units, temperatures and moves are drawn from
--seed. `--out FILE.json` writes what was printed.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fiberloom.instruments import FocalPlane, generate, load_instrument
from fiberloom.studies.legal_moves import FULL_SPEED_DEG_S, cruise, legal_moves
from fiberloom.studies.meetings import KINDS, Meeting, meetings
from fiberloom.twin.draw import STIFFNESS_NM_PER_RAD
from fiberloom.twin.units import GEAR

IN_TIME_S = 0.016
HOST_S = 0.005
UNITS_OF_BOUND = 48
SIGMAS = 5.5
"""Of a matched filter, for one false detection in a million moves of some 10^4 independent looks."""


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("study", choices=STUDIES)
    parser.add_argument("--units", type=int, default=500)
    parser.add_argument("--moves", type=int, default=20, help="of each unit")
    parser.add_argument("--rounds", type=int, default=2, help="of 52 pairs and kind of meeting")
    parser.add_argument("--no-touch", action="store_true", help="meet: without the touch watch")
    parser.add_argument("--law", type=int, default=0, help="meet, legal: the control law, 0 or 1")
    parser.add_argument(
        "--all", action="store_true", help="legal: with all watches, not with Eq. 22 alone too"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    found, good = STUDIES[asked.study](asked)
    if asked.out:
        asked.out.write_text(json.dumps(found, indent=2) + "\n")
    return 0 if good else 1


def plane_of(n: int) -> FocalPlane:
    """An SDSS-V plane of n."""
    return generate(load_instrument("sdssv"), seed=2, n_positioners=n)


def study_legal(asked: argparse.Namespace) -> tuple[dict[str, Any], bool]:
    """Legal moves, with the contact and touch watches on, and with Eq. 22 alone."""
    studied = {"all watches": True}
    if not asked.all:
        studied["Eq. 22 alone"] = False
    found = {}
    for name, watches in studied.items():
        trial = legal_moves(
            plane_of(asked.units), moves=asked.moves, seed=asked.seed, touch=watches, law=asked.law
        )
        found[name] = vars(trial)
        kinds = ", ".join(f"{n} {kind}" for kind, n in trial.kinds.items())
        false = f"{len(trial.collisions)} false detections in {trial.moves} moves"
        print(f"law {asked.law}, {name}: {false} ({kinds}), seed {asked.seed}", flush=True)
        for number, kind in trial.collisions:
            print(f"  positioner {number}: {kind}")
    return found, not any(trial["collisions"] for trial in found.values())


def study_meet(asked: argparse.Namespace) -> tuple[dict[str, Any], bool]:
    """Meetings of every kind, head on: when the first stood, when both did, and what they bore."""
    print(
        "| who moves | meetings | first stands, ms | within 16 ms | of those that can be told "
        "| both by own watch | both, host 5 ms |"
    )
    print("|---|--:|--:|--:|--:|--:|--:|")
    found = {}
    plane = plane_of(500)
    slowest_Nm_s = [told_Nm_s(axis) for axis in (0, 1)]
    for kind in KINDS:
        alone, hosted = [
            [
                meeting
                for k in range(asked.rounds)
                for meeting in meetings(
                    plane, kind, seed=asked.seed + k, host_s=host, touch=not asked.no_touch, law=asked.law
                )
            ]
            for host in (None, HOST_S)
        ]
        found[kind] = row_of(alone, hosted, slowest_Nm_s)
        print(line(kind, found[kind]), flush=True)
    return found, True


def told_Nm_s(axis: int) -> float:
    """Growth of the load that the best linear detector tells within 16 ms, its ripple known."""
    noise = covariance(cruise(plane_of(UNITS_OF_BOUND), axis=axis, seed=1, ripple=False))
    return 1e3 * SIGMAS / matched(noise, 1e3 * IN_TIME_S)


def row_of(alone: list[Meeting], hosted: list[Meeting], slowest_Nm_s: list[float]) -> dict[str, Any]:
    """Figures of the meetings that resist a motor of everybody who moves.

    Those in which the load of a motor grows faster than `slowest_Nm_s` of its axis can be told in time.
    """
    pairs = [(a, h) for a, h in zip(alone, hosted, strict=True) if all(s.head_on for s in a.stops)]
    first_s = [min(s.own_s for s in a.stops) for a, _ in pairs]
    both_s = [max(s.own_s for s in a.stops) for a, _ in pairs]
    hosted_s = [max(s.stopped_s for s in h.stops) for _, h in pairs]
    torque_Nm = np.array([s.torque_Nm for _, h in pairs for s in h.stops])
    tellable = [bool(np.any([np.array(s.load_rate_Nm_s) > slowest_Nm_s for s in a.stops])) for a, _ in pairs]
    in_time = np.array(first_s) <= IN_TIME_S
    return {
        "tellable": sum(tellable),
        "tellable_in_time": int(np.sum(in_time & tellable)),
        "meetings": len(pairs),
        "first_ms": quantiles_ms(first_s),
        "own_ms": quantiles_ms(both_s),
        "hosted_ms": quantiles_ms(hosted_s),
        "first_in_time": float(np.mean(in_time)),
        "own_in_time": float(np.mean(np.array(both_s) <= IN_TIME_S)),
        "torque_mNm": [quantiles_ms(torque) for torque in torque_Nm.T],
    }


def quantiles_ms(values: Any) -> list[float]:
    """Median, 95 %, largest, times a thousand; an event that never came is infinite."""
    ordered = np.sort(np.asarray(values)) * 1e3
    return [float(ordered[min(int(q * len(ordered)), len(ordered) - 1)]) for q in (0.5, 0.95, 1.0)]


def line(kind: str, row: dict[str, Any]) -> str:
    """One row of the table."""
    times = [" / ".join(f"{t:.0f}" for t in row[key]) for key in ("first_ms", "own_ms", "hosted_ms")]
    alpha, beta = row["torque_mNm"]
    share = f"{100 * row['first_in_time']:.0f} %"
    told = f"{row['tellable_in_time']} of {row['tellable']}"
    return (
        f"| {kind} | {row['meetings']} | {times[0]} | {share} | {told} | {times[1]} | {times[2]} |"
        f"  torque on alpha {alpha[0]:.1f} / {alpha[2]:.1f}, beta {beta[0]:.1f} / {beta[2]:.1f} mNm"
    )


def study_bound(asked: argparse.Namespace) -> tuple[dict[str, Any], bool]:
    """The best linear detector of a load that grows steadily, against what units really scatter at speed."""
    print_rates()
    after_ms = [6, 8, 10, 12, 14, 16, 20, 24]
    print(f"smallest growth of the load at the motor, uNm/ms, that shows at {SIGMAS} sigma after so many ms")
    print("| axis | " + " | ".join(map(str, after_ms)) + " |")
    print("|---|" + "--:|" * len(after_ms))
    found = {}
    for axis, name in enumerate(("alpha", "beta")):
        for ripple in (True, False):
            plane = plane_of(min(asked.units, UNITS_OF_BOUND))
            noise = covariance(cruise(plane, axis=axis, seed=asked.seed, ripple=ripple))
            rates = [1e6 * SIGMAS / matched(noise, ms) for ms in after_ms]
            row = name if ripple else f"{name}, ripple known"
            found[row] = dict(zip(after_ms, rates, strict=True))
            print(f"| {row} | " + " | ".join(f"{rate:.3f}" for rate in rates) + " |", flush=True)
    return found, True


def print_rates() -> None:
    """What alpha meets at 2000 rpm: its motor's load against a wall, and against a neighbour's tip at rest.

    Both arms give way by lever^2 / k of each axis; the contact's normal lies across the arm.
    """
    k_alpha, k_beta = STIFFNESS_NM_PER_RAD
    speed_rad_s = np.deg2rad(FULL_SPEED_DEG_S)
    tip, elbow = 22.1e-3, 7.4e-3
    print(f"a wall: {1e3 * speed_rad_s * k_alpha / GEAR:.2f} uNm/ms at the motor of alpha")
    for lever in (tip, 0.015, elbow):
        give = sum(a**2 / k_alpha + (a - elbow) ** 2 / k_beta for a in (lever, tip))
        rate = 1e3 * speed_rad_s * lever**2 / give / GEAR
        print(
            f"a neighbour's tip with {1e3 * lever:.1f} mm of lever: {rate:.3f} uNm/ms, twice if it drives too"
        )


WINDOW_TICKS = 240
"""What a detector looks back on: 120 ms, as long as two of the means of fl_touch.h."""


def covariance(residual_Nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of a window of raw residuals, newest first; the mean is unknown: what the drag is wrong by."""
    windows = np.lib.stride_tricks.sliding_window_view(residual_Nm, WINDOW_TICKS, axis=1)[:, ::7, ::-1]
    rows = windows.reshape(-1, WINDOW_TICKS)
    noise = rows.T @ rows / len(rows)
    unknown = 1e4 * np.trace(noise) / WINDOW_TICKS
    return noise + unknown


def matched(noise: NDArray[np.float64], after_ms: float) -> float:
    """Sigmas of a matched filter per Nm/ms of growth that began so long ago."""
    signal = np.maximum(after_ms - 0.5 * (np.arange(WINDOW_TICKS) + 1.0), 0.0)
    return float(np.sqrt(signal @ np.linalg.solve(noise, signal)))


STUDIES = {"legal": study_legal, "meet": study_meet, "bound": study_bound}

if __name__ == "__main__":
    sys.exit(main())
