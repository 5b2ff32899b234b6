"""Plans from A to B, carried out by the firmware on the twin: contacts, and who is not where it was sent.

    python -m benchmarks.planning.played --pairs 20 --buffer 2.0 --out runs/played

The array is the real one of SDSS-V where its tables are, or `--array "hexagon 61"`. The twin begins at A.
Where all are is read over the bus, by a calibration of these units with noise. From there it is planned, and
the plan is verified, turned into counts and ticks, and sent. Contacts are those of the bodies, in the truth
of the twin, until all rest. Run again, it goes on where it was stopped; results of another build are not
mixed.

Exit code 0: no contact, none is refused, and every trajectory was carried out; 1: otherwise; 2: bad input;
130: interrupted.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
from benchmarks.faults.campaign import Campaign, interruptible

from fiberloom.bus.client import Client
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.drive.sdssv import on_the_wire
from fiberloom.field import Field
from fiberloom.instruments import FocalPlane
from fiberloom.planning import Plan, PlanSettings, plan, verify
from fiberloom.twin import draw_units
from fiberloom.twin.transport import TwinTransport
from fiberloom.twin.twin import Twin
from fiberloom.typing import Floats

from .. import pairs
from ..builds import claim
from ..rows import Line

HEAD = (
    "| array | buffer mm | pairs played | trajectories | not carried out | refused | contacts "
    "| off at the end, worst, deg | motion s, median / worst |\n|---|--:|--:|--:|--:|--:|--:|--:|--:|"
)


def main() -> int:
    """Runs what the command line asks for."""
    asked = arguments()
    return interruptible(asked.out, partial(run, asked))


def run(asked: argparse.Namespace) -> int:
    """All pairs, then a row."""
    array = asked.array or str(pairs.real_layout() or "hexagon 61")
    plane, name = pairs.array_of(array), Path(array).name
    folder = asked.out / f"{name.replace(' ', '-')}-{asked.buffer:g}mm"
    claim(folder, plane.config_hash())
    campaign = Campaign(folder, partial(one_pair, plane, asked.buffer), deadline_s=math.inf)
    seeds = range(asked.first_seed, asked.first_seed + asked.pairs)
    found = campaign.run(seeds, lambda line: print(told(line), file=sys.stderr, flush=True))
    print(f"{HEAD}\n{row(name, asked.buffer, list(found.values()))}")
    return 0 if all(map(good, found.values())) else 1


def one_pair(plane: FocalPlane, buffer_mm: float, seed: int, log: Path) -> Line:
    """In a process of its own. The calibration is kept in the cache."""
    maps = Field.twin(plane, camera="noise").run.calibrate()
    begin_s = time.process_time()
    line = asyncio.run(played(plane, maps, pairs.ends_of(plane, seed, buffer_mm), buffer_mm, seed))
    log.unlink(missing_ok=True)
    return {"seed": seed, "cpu_s": time.process_time() - begin_s} | line


async def played(
    plane: FocalPlane, maps: TransmissionMaps, ends_deg: tuple[Floats, Floats], buffer_mm: float, seed: int
) -> Line:
    """From where the bus says that all are at A, to B."""
    twin = Twin(plane, draw_units(plane, 0), seed=seed, start_deg=ends_deg[0])
    client = Client(TwinTransport(twin))
    await client.discover()
    wire_deg, _ = await client.positions_deg(plane.positioner_id)
    here_deg = maps.to_output(wire_deg)
    settings = PlanSettings(collision_buffer_mm=buffer_mm)
    made = plan(plane, here_deg, ends_deg[1], seed=seed, settings=settings)
    checked = verify(plane, made, start_deg=here_deg, goal_deg=ends_deg[1])
    line: Line = {
        "verified": checked.ok,
        "refused": {str(number): why for number, why in made.refused.items()},
        "motion_s": made.duration_s,
    }
    if not checked.ok:
        return line
    sent, failed = await carried_out(client, maps, plane, made)
    arrives = ~np.isin(plane.positioner_id, list(made.refused))
    off_deg = np.abs(twin.truth() - ends_deg[1])[arrives].max(initial=0.0)
    return line | {"sent": sent, "failed": failed, "contacts": twin.contacts(), "off_deg": float(off_deg)}


async def carried_out(
    client: Client, maps: TransmissionMaps, plane: FocalPlane, made: Plan
) -> tuple[int, dict[str, str]]:
    """How many trajectories were sent, and which were not carried out."""
    robots = [robot for robot in made.robots if robot.moves]
    numbers = [robot.positioner_id for robot in robots]
    rows = plane.index_of(numbers).tolist()
    await client.set_precise_moves(numbers, on=False)  # plans have their own approach
    ways = {r.positioner_id: on_the_wire(maps, k, r) for k, r in zip(rows, robots, strict=True)}
    results = await client.run_trajectories(ways)
    return len(robots), {str(i): str(r.outcome) for i, r in results.items() if i not in results.ok_ids}


def good(line: Line) -> bool:
    """Whether a pair went from A to B without a contact."""
    return "sent" in line and not (line["failed"] or line["contacts"] or line["refused"])


def told(line: Line) -> str:
    """A pair in a line."""
    if "crash" in line:
        return f"pair {line['seed']}: {line['crash'].strip().splitlines()[-1]}"
    if "sent" not in line:
        return f"pair {line['seed']}: the plan is not verified; not sent"
    why = [f"{number}: {reason}" for key in ("failed", "refused") for number, reason in line[key].items()]
    return f"pair {line['seed']}: {line['contacts']} contacts, {line['cpu_s']:.0f} CPU s; {'; '.join(why)}"


def row(name: str, buffer_mm: float, lines: list[Line]) -> str:
    """Of the table."""
    sent = [line for line in lines if "sent" in line]
    motion_s = [line["motion_s"] for line in sent] or [math.nan]
    cells = (
        name,
        f"{buffer_mm:g}",
        f"{len(sent)} of {len(lines)}",
        sum(line["sent"] for line in sent),
        sum(len(line["failed"]) for line in sent),
        sum(len(line["refused"]) for line in sent),
        sum(line["contacts"] for line in sent),
        f"{max((line['off_deg'] for line in sent), default=math.nan):.3f}",
        f"{np.median(motion_s):.1f} / {max(motion_s):.1f}",
    )
    return "| " + " | ".join(map(str, cells)) + " |"


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.planning.played", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--buffer", type=float, default=2.0, help="mm")
    parser.add_argument("--array", help='a folder of tables, or "hexagon N"; the real array if left out')
    parser.add_argument("--out", type=Path, default=Path("runs/played"))
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
