"""Runs inside the environment of the real jaeger, which knows nothing of fiberloom.

Reads a line of JSON for each scenario, {"scenario", "profile", ...}, and answers with a line "RESULT
{...}". What jaeger is asked to do is what its users do; nothing of it is replaced.
"""

import asyncio
import json
import sys
import time
import traceback

import numpy as np
from jaeger import FPS
from jaeger.commands import CommandID
from jaeger.commands.bootloader import load_firmware
from jaeger.commands.calibration import calibrate_positioners
from jaeger.commands.trajectory import Trajectory
from jaeger.maskbits import BootloaderStatus, FPSStatus
from jaeger.maskbits import PositionerStatus as PS

QUIET = {"save_snapshot": False}  # snapshots need the observatory's calibration files
SCENARIOS = {}


def scenario(function):
    SCENARIOS[function.__name__] = function
    return function


def where(fps, ids):
    return [[float(a) for a in fps[i].position] for i in ids]


def largest_miss(fps, goals):
    """Degrees, over all axes: where jaeger reads that they are, against where it sent them."""
    return float(max(np.abs(np.subtract(fps[i].position, goal)).max() for i, goal in goals.items()))


def ramp(here, there, rpm=2000.0):
    """Straight lines at a motor speed that starts at 0.1 s, as jaeger's own go-to makes them."""
    return {
        arm: [(here[k], 0.1), (there[k], 0.1 + 0.25 + abs(there[k] - here[k]) * 1024 / (6 * rpm))]
        for k, arm in enumerate(("alpha", "beta"))
    }


async def sent(fps, goals, bends=0):
    """A trajectory to the goals, by way of so many points in between."""
    await fps.update_position()
    paths = {}
    for i, goal in goals.items():
        path = ramp(fps[i].position, goal)
        paths[i] = {arm: bent(points, bends) for arm, points in path.items()}
    trajectory = await fps.send_trajectory(paths, dump=False, **QUIET)
    return float(trajectory.data_send_time)


def bent(points, bends):
    """The same way, with points on it at uneven times (speeds between 0.8 and 1.2 of the mean)."""
    (a0, t0), (a1, t1) = points
    share = np.linspace(0, 1, bends + 2)
    times = t0 + (t1 - t0) * (share + 0.05 * np.sin(2 * np.pi * share))
    return [(float(a0 + (a1 - a0) * s), float(t)) for s, t in zip(share, times, strict=True)]


@scenario
async def moves(fps, job):
    ids = sorted(fps)
    answer = {"ids": ids, "firmware": sorted({fps[i].firmware for i in ids}), "misses_deg": {}}
    answer["idle"] = bool(fps.status & FPSStatus.IDLE)
    answer["initialised"] = all(fps[i].initialised for i in ids)
    answer["closed_loop"] = all(PS.CLOSED_LOOP_ALPHA in fps[i].status for i in ids)
    goals = {i: (20.0 + i % 7, 160.0) for i in ids}
    await fps.goto(goals, go_cowboy=True, **QUIET)
    answer["misses_deg"]["goto"] = largest_miss(fps, goals)
    goals = {i: (31.25, 172.5 - i % 5) for i in ids}
    await sent(fps, goals, bends=job.get("bends", 3))
    answer["misses_deg"]["send_trajectory"] = largest_miss(fps, goals)
    single = ids[0]
    await fps[single]._goto_position(25.0, 165.0)
    await fps[single].wait_for_status([PS.DISPLACEMENT_COMPLETED])
    await fps.update_position()
    answer["misses_deg"]["command 30"] = largest_miss(fps, {single: (25.0, 165.0)})
    return answer


@scenario
async def stop(fps, job):
    """Stops a trajectory on its way; then moves on."""
    ids = sorted(fps)
    goals = dict.fromkeys(ids, (90.0, 160.0))
    trajectory = Trajectory(fps, {i: ramp(fps[i].position, goals[i]) for i in ids})
    await trajectory.send()
    running = asyncio.create_task(trajectory.start(use_sync_line=False))
    await asyncio.sleep(2.0)
    moving = not any(PS.DISPLACEMENT_COMPLETED in fps[i].status for i in ids)
    await fps.stop_trajectory()
    await asyncio.gather(running, return_exceptions=True)
    await fps.update_status()
    await fps.update_position()
    at = where(fps, ids)
    goals = dict.fromkeys(ids, (10.0, 170.0))
    await sent(fps, goals)
    return {
        "was_moving": moving,
        "idle_after": bool(fps.status & FPSStatus.IDLE),
        "stopped_at": at,
        "miss_deg": largest_miss(fps, goals),
    }


@scenario
async def collision(fps, job):
    """Two neighbours into each other, and away again. The path: alpha while folded, then beta."""
    goals = {int(i): tuple(goal) for i, goal in job["goals"].items()}
    home = {i: tuple(map(float, fps[i].position)) for i in goals}
    await sent(fps, {i: (alpha, home[i][1]) for i, (alpha, _) in goals.items()})
    try:
        await sent(fps, goals)
        why = ""
    except Exception as error:
        why = str(error)
    await fps.update_position()
    answer = {
        "why": why,
        "locked": fps.locked,
        "locked_by": list(fps.locked_by),
        "collided": [i for i in goals if fps[i].collision],
        "stopped_at": where(fps, goals),
    }
    try:
        await sent(fps, home)
        answer["refused_while_locked"] = False
    except Exception:
        answer["refused_while_locked"] = True
    await fps.unlock()
    answer["locked_after"] = fps.locked
    await sent(fps, {i: (goals[i][0], home[i][1]) for i in goals})
    answer["folded_again_at"] = where(fps, goals)
    await sent(fps, home)
    answer["miss_deg"] = largest_miss(fps, home)
    answer["began_and_ended_at"] = [list(home.values()), where(fps, home)]
    return answer


@scenario
async def calibrations(fps, job):
    """Motor, datum and cogging calibration, homing; units alone on a bench."""
    ids = sorted(fps)
    await calibrate_positioners(fps, "both", ids, motors=True, datums=True, cogging=False)
    answer = {"hall_and_datum": status_has(fps, ids, PS.MOTOR_BETA_CALIBRATED, PS.DATUM_BETA_CALIBRATED)}
    await fps.update_status()
    command = await fps.send_command(CommandID.START_COGGING_CALIBRATION, positioner_ids=ids)
    answer["cogging_accepted"] = not command.status.failed
    # calibrate_positioners(cogging=True) would wait for ever: COGGING_BETA_CALIBRATED is bit 32, and
    # jaeger 1.11.1 reads 32 bits
    done = [PS.DISPLACEMENT_COMPLETED, PS.COGGING_ALPHA_CALIBRATED]
    answer["cogging"] = all(await asyncio.gather(*(fps[i].wait_for_status(done, timeout=60) for i in ids)))
    saved = await fps.send_command(CommandID.SAVE_INTERNAL_CALIBRATION, positioner_ids=ids)
    answer["saved"] = not (saved.status.failed or saved.status.timed_out)
    await fps.update_status()
    await asyncio.gather(*(fps[i].home() for i in ids))
    await fps.update_status()
    await fps.update_position()
    answer["homed"] = status_has(fps, ids, PS.DATUM_ALPHA_INITIALIZED, PS.DATUM_BETA_INITIALIZED)
    answer["home_deg"] = where(fps, ids)
    goals = dict.fromkeys(ids, (10.0, 170.0))
    await sent(fps, goals)
    answer["miss_deg"] = largest_miss(fps, goals)
    return answer


def status_has(fps, ids, *bits):
    return all(bit in fps[i].status for i in ids for bit in bits)


@scenario
async def upgrade(fps, job):
    """A new firmware image through the bootloader."""
    answer = {"bootloader": fps.is_bootloader(), "firmware": sorted({fps[i].firmware for i in fps})}
    answer["loaded"] = await load_firmware(fps, job["image"], stop_logging=False)
    await asyncio.gather(*(fps[i].update_status() for i in fps))
    answer["check_ok"] = all(BootloaderStatus.NEW_FIRMWARE_CHECK_OK in fps[i].status for i in fps)
    await asyncio.sleep(job.get("wait_s", 10.5))  # the bootloader starts the main firmware
    await fps.initialise()
    answer["firmware_after"] = sorted({fps[i].firmware for i in fps})
    answer["idle"] = bool(fps.status & FPSStatus.IDLE)
    return answer


@scenario
async def array(fps, job):
    """The whole focal plane: everybody turns the same way, which nobody minds."""
    ids = sorted(fps)
    begin = time.monotonic()
    goals = dict.fromkeys(ids, (25.0, 175.0))
    send_s = await sent(fps, goals, bends=job.get("bends", 4))
    return {
        "count": len(ids),
        "misses_deg": {"send_trajectory": largest_miss(fps, goals)},
        "data_send_s": send_s,
        "wall_s": time.monotonic() - begin,
        "ids": ids,
    }


async def run(job):
    begin = time.monotonic()
    fps = await FPS.create(can=job["profile"], ieb=False)
    answer = {"initialise_s": time.monotonic() - begin}
    try:
        answer |= await SCENARIOS[job["scenario"]](fps, job)
    finally:
        fps.can.stop()
        fps.discard()
        await asyncio.sleep(0.1)
    return answer


async def main():
    loop = asyncio.get_running_loop()
    print("RESULT {}", flush=True)  # ready
    while line := await loop.run_in_executor(None, sys.stdin.readline):
        try:
            answer = await run(json.loads(line))
        except Exception:
            answer = {"error": traceback.format_exc()}
        print("RESULT " + json.dumps(answer), flush=True)


if __name__ == "__main__":
    asyncio.run(main())
