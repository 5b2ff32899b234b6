"""A night whose process is killed (-9) at random instants, and resumed until it ends; then the account.

Lost is what the shutter has exposed, or the camera has seen, and the record does not have; doubled is an
exposure of the queue that the shutter was open for twice.
"""

from __future__ import annotations

import asyncio
import random
import re
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from fiberloom.calibration.transmission.cache import load_for
from fiberloom.instruments import FocalPlane
from fiberloom.night.carry import NightEnd, carry_out
from fiberloom.night.clock import NightClock
from fiberloom.night.queue import read_queue
from fiberloom.night.setup import NightSetup
from fiberloom.night.shutter import Exposed
from fiberloom.operation.known import Known
from fiberloom.operation.session.session import KnownArray
from fiberloom.operation.source import OpenedArray
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.store.nights.book import NightBook, nights
from fiberloom.store.nights.records import NightRecord
from fiberloom.store.run import FINISHED, STOPPED
from fiberloom.store.upkeep.check import check_store
from fiberloom.targets import random_targets, read_targets, write_targets
from fiberloom.twin.units import Units

from .world import FORK, NightWorld, PipedArray, kill_after

BUS = "cannet://10.0.0.1:19228"
BEGIN = datetime(2026, 11, 25, 18, 0, tzinfo=UTC)
GAP_S = 60.0
"""At most so long after a process was killed the next one begins."""
MOST_DELAY_S = 0.1
"""Between an answer and the kill, of this machine."""
POSITIONING = 3
"""Requests for each positioner, at most, before a kill with the shutter closed: half a positioning."""
AFTER_OPENING = 20
"""Requests at most with the shutter open, before a kill that is meant for that."""
MOST_EXPOSURES = 0.1
"""Until a kill that is drawn by time, in exposures."""
TURNS = 6, 3, 2
"""Kills in a row with the shutter closed, with the shutter open, by time."""
STILL_UM = 1.0
"""A fibre that moves less while the shutter is open is at rest: the twin's own rest is far below."""


@dataclass(frozen=True)
class Account:
    """What came of a night."""

    status: str
    kills: int
    kills_exposing: int
    """Of those, with the shutter open."""
    visits: int
    exposures_asked: int
    exposures_done: int
    openings: int
    lost: int
    doubled: int
    not_still: int
    """Openings during which a fibre has moved."""
    off_target: int
    """Openings with fibres further from their targets than the requirement, of those that were on target."""
    images: int
    images_on_record: int
    images_lost: int
    """Beyond the one that may be on its way when a process is killed."""
    contacts: int
    store_faults: int
    night_s: float

    @property
    def ok(self) -> bool:
        """Nothing lost, nothing doubled, nothing touched."""
        wrong = (self.lost, self.doubled, self.not_still, self.images_lost, self.contacts, self.store_faults)
        return self.status == "finished" and not any(wrong) and self.exposures_done == self.exposures_asked


@dataclass(frozen=True)
class Scene:
    """The array, the queue and where its record is."""

    plane: FocalPlane
    units: Units
    maps: Path
    folder: Path
    seed: int = 0
    exposure_s: float = 900.0


def write_queue(scene: Scene, fields: int) -> None:
    """Fields of random targets, two exposures in the first, two dithers in the second."""
    text = f"begin = {BEGIN.isoformat()}\ndawn = {(BEGIN + timedelta(days=2)).isoformat()}\nrequire = 0.5\n"
    for k in range(fields):
        targets = random_targets(scene.plane, 3 * len(scene.plane), scene.seed + 100 + k)
        write_targets(targets, scene.folder / f"f{k}.csv")
        more = {0: "exposures = 2", 1: "dithers_um = [[0, 0], [60, 0]]"}.get(k, "")
        text += f'[[field]]\nid = "f{k}"\ntargets = "f{k}.csv"\nexposure_s = {scene.exposure_s}\n{more}\n'
    (scene.folder / "queue.toml").write_text(text)


class PipedShutter:
    """The world's shutter by the night's clock. Implements `Shutter`."""

    def __init__(self, array: PipedArray) -> None:
        self.array = array

    async def start(self, key: str, exposure_s: float) -> None:
        """Opens it."""
        await self.array.start(key, exposure_s)

    async def seen(self, key: str) -> Exposed:
        """When it was open."""
        return Exposed(
            *(None if s is None else BEGIN + timedelta(seconds=s) for s in await self.array.seen_s(key))
        )


def observe(pipe: Connection, scene: Scene, resume: bool) -> None:
    """One process of the night: from its begin, or from where it was left, to the end."""
    array = PipedArray(pipe)
    try:
        pipe.send(("ended", asyncio.run(_carried(scene, array, resume))))
    except BaseException:
        (scene.folder / "errors.txt").open("a").write(traceback.format_exc())
        pipe.send(("ended", NightEnd(0, "error", traceback.format_exc(limit=-1))))


async def _carried(scene: Scene, array: PipedArray, resume: bool) -> NightEnd:
    maps = load_for(scene.plane, scene.maps)
    with Store.open(scene.folder / "store.sqlite") as store:
        book = ArrayBook(store, BUS)
        known = KnownArray(scene.plane, maps, OpenedArray(array, array), book)
        own = Known(scene.plane, maps, files={"transmission": scene.maps})
        return await carry_out(_setup(scene, own, known, array), store, resume)


def _setup(scene: Scene, own: Known, known: KnownArray, array: PipedArray) -> NightSetup:
    def shutter(setup: NightSetup, book: NightBook, clock: NightClock) -> PipedShutter:
        return PipedShutter(array)

    return NightSetup(
        own,
        known,
        scene.folder / "queue.toml",
        scene.folder,
        "killed",
        scene.seed,
        virtual=True,
        reborn=False,
        shutter=shutter,
    )


def killed_night(
    scene: Scene,
    kills: int,
    seed: int,
    say: Callable[[str], None] = lambda _: None,
    turns: tuple[int, int, int] = TURNS,
) -> Account:
    """Carries out the queue of a scene, with so many kills at most, at instants drawn by the seed."""
    world, draw = NightWorld.of(scene.plane, scene.units, scene.seed), random.Random(seed)
    done, exposing, resume = 0, 0, False
    while True:
        end, lit = _one_process(world, scene, draw if done < kills else None, resume, _turn(done, turns))
        if end is not None:
            return _account(scene, world, end, done, exposing)
        assert lit, (scene.folder / "errors.txt").read_text()
        done, found = done + 1, _night(scene)
        resume = found is not None
        exposing += world.is_open
        say(f"killed {done} of {kills} at {world.twin.time_s:.1f} s")
        if found is not None and found.status == FINISHED:  # between its end and that of the process
            return _account(scene, world, NightEnd(found.id, FINISHED, ""), done, exposing)
        world.passes(draw.uniform(0.0, GAP_S))


def _one_process(
    world: NightWorld, scene: Scene, draw: random.Random | None, resume: bool, turn: int
) -> tuple[NightEnd | None, bool]:
    """How it has ended, None: it was killed; and whether it was killed by us."""
    ours, theirs = FORK.Pipe()
    process = FORK.Process(target=_alone, args=(ours, theirs, scene, resume), daemon=True)
    process.start()
    theirs.close()
    assert process.pid is not None
    lit: list[bool] = []
    # with the shutter open at once: a busy machine may be past the exposure a moment later
    at_once = draw is None or turn == 1
    fuse = kill_after(process.pid, 0.0 if at_once else draw.uniform(0.0, MOST_DELAY_S))
    end = world.serve(ours, _when(world, draw, scene.exposure_s, turn), lambda: (lit.append(True), fuse())[1])
    process.join()
    return end, bool(lit)


def _alone(ours: Connection, theirs: Connection, scene: Scene, resume: bool) -> None:
    ours.close()
    observe(theirs, scene, resume)


def _when(
    world: NightWorld, draw: random.Random | None, exposure_s: float, turn: int
) -> Callable[[NightWorld], bool]:
    """When to kill, by the turn: 0 with the shutter closed, 1 with it open, 2 at any time."""
    if draw is None:
        return lambda _: False
    if turn == 0:
        return _after(draw.randrange(1, POSITIONING * len(world.twin.plane)), lambda now: not now.is_open)
    if turn == 1:
        return _after(draw.randrange(0, AFTER_OPENING), lambda now: now.is_open)
    time_s = world.twin.time_s + draw.uniform(0.0, MOST_EXPOSURES * exposure_s)
    return lambda now: now.twin.time_s >= time_s


def _turn(number: int, turns: tuple[int, int, int]) -> int:
    """Which turn it is for a kill, by its number."""
    left = number % sum(turns)
    return 0 if left < turns[0] else 1 if left < turns[0] + turns[1] else 2


def _after(requests: int, counts: Callable[[NightWorld], bool]) -> Callable[[NightWorld], bool]:
    """After so many requests at which something holds."""
    left = [requests]

    def reached(now: NightWorld) -> bool:
        left[0] -= counts(now)
        return left[0] < 0

    return reached


def _night(scene: Scene) -> NightRecord | None:
    """As the record has it; None: it was not begun."""
    with Store.open(scene.folder / "store.sqlite") as store:
        return next(reversed(nights(store)), None)


# the account


def _account(scene: Scene, world: NightWorld, end: NightEnd, kills: int, exposing: int) -> Account:
    queue = read_queue(scene.folder / "queue.toml")
    with Store.open(scene.folder / "store.sqlite") as store:
        book = NightBook(store, nights(store)[-1].id)
        visits, exposures = {v.id: v for v in book.visits()}, book.exposures()
        on_record = sum(images_of(store, run.id) for run in store.runs())
        faults = len(check_store(store).faults)
        night_s = (book.about.utc_end or BEGIN) - BEGIN
    booked = {e.key for e in exposures if e.utc_end is not None}
    part = {
        e.key: (visits[e.visit_id].field, visits[e.visit_id].repeat, visits[e.visit_id].dither)
        for e in exposures
    }
    opened = Counter((*part[o.key], int(re.search(r"exposure (\d+)", o.key)[1])) for o in world.openings)
    asked = sum(len(entry.parts) * entry.exposures for entry in queue.fields)
    return Account(
        status=end.status if end.status != "error" else end.why,
        kills=kills,
        kills_exposing=exposing,
        visits=len(visits),
        exposures_asked=asked,
        exposures_done=len(booked),
        openings=len(world.openings),
        lost=sum(o.key not in booked for o in world.openings),
        doubled=sum(n - 1 for n in opened.values()),
        not_still=sum(o.moved_um > STILL_UM for o in world.openings),
        off_target=_off_target(scene, world, part),
        images=world.images,
        images_on_record=on_record,
        images_lost=max(world.images - on_record - kills, 0),
        contacts=len(world.contacts),
        store_faults=faults,
        night_s=night_s.total_seconds(),
    )


def images_of(store: Store, run: int) -> int:
    """Images that its moves and its begin checks are made of."""
    parts = store.parts(run)[1]
    moves = store.moves(run)
    kinds = zip(moves["id"].tolist(), moves["kind"].tolist(), strict=True)
    return sum(parts[i].head["images"] if i in parts else 1 for i, kind in kinds if kind != STOPPED)


def _off_target(scene: Scene, world: NightWorld, part: dict[str, tuple[str, int, int]]) -> int:
    """Openings in which the median fibre is further from every target than the requirement."""
    queue, off = read_queue(scene.folder / "queue.toml"), 0
    for opening in world.openings:
        field, _, dither = part[opening.key]
        entry = queue.entry(field)
        targets_mm = read_targets(entry.targets).xy_mm + np.array(entry.dithers_um[dither]) / 1000.0
        apart_mm = np.linalg.norm(opening.begin_mm[:, :, None] - targets_mm, axis=-1).min(axis=(0, 2))
        off += bool(np.median(apart_mm) * 1000.0 > scene.plane.instrument.operation.requirement_um)
    return off


def as_dict(account: Account) -> dict[str, object]:
    """For JSON."""
    return asdict(account) | {"ok": account.ok}
