"""A drive without boards: arms go where they are told, but for errors that a test puts in."""

import numpy as np

from fiberloom.bus.outcome import Outcome, all_of
from fiberloom.drive.port import BelievedPlaces, DriveModel, Programme, verified
from fiberloom.hardware import Hardware
from fiberloom.metrology import Measurement
from fiberloom.metrology.noise import CorrectionNoise
from fiberloom.planning import plan, plan_corrections


class PlainDrive:
    """Adds up what it has told; each move falls short by a share of its way, and scatters by another one."""

    def __init__(self, plane, *, blind_um=10.0, short=0.0, scatter=0.0, believes=False, stuck=(), seed=0):
        self.plane, self.short, self.scatter, self.believes = plane, short, scatter, believes
        self.stuck = np.isin(plane.positioner_id, stuck)
        self.model = DriveModel(
            CorrectionNoise(blind_um=blind_um, slope=max(short, 0.1)),
            astray_share=1.0,
            seen_is_believed=believes,
            reports=False,
        )
        self.ids, self.time_s = plane.positioner_id.tolist(), 0.0
        self.true_deg, self.told_deg = plane.park_deg.copy(), plane.park_deg.copy()
        self.rng, self.stops, self.ran = np.random.default_rng(seed), 0, []

    async def sleep(self, duration_s):
        self.time_s += duration_s

    async def connect(self):
        pass

    async def rest(self, alarm, left_moving=False):
        pass

    async def believed(self, ids):
        rows = self.plane.index_of(ids)
        return BelievedPlaces(self.told_deg[rows], self.told_deg[rows], np.ones(len(ids), dtype=bool))

    async def heard_again(self, silent):
        return list(silent)

    async def prepare(self, wanted):
        make = plan_corrections if wanted.small else plan
        return await self.compile(
            make(
                wanted.obstacles, wanted.here_deg, wanted.goal_deg,
                seed=wanted.seed, approach_deg=wanted.approach_deg,
            )
        )  # fmt: skip

    async def compile(self, plan):
        return Programme(plan)

    def verify(self, obstacles, programme):
        return verified(obstacles, programme)

    async def run(self, programme, watch, say):
        rows = self.plane.index_of(np.array(programme.moving, dtype=np.int64))
        way = programme.plan.end_deg[rows] - self.told_deg[rows]
        gone = way * (1.0 - self.short + self.scatter * self.rng.standard_normal(way.shape))
        self.true_deg[rows] += np.where(self.stuck[rows, None], 0.0, gone)
        self.told_deg[rows] += way
        self.time_s += programme.plan.duration_s
        self.ran.append(programme)
        return all_of(programme.moving, Outcome.DONE)

    def arrived(self, goal_deg, last=False):
        return None

    async def settle(self, ids):
        pass

    async def stop(self):
        self.stops += 1
        return self.ids

    def excused(self, image):
        return None

    def seen(self, image, mobile):
        if not self.believes:
            return None
        found = self.plane.inverse(np.nan_to_num(image.xy_mm))
        known = image.seen & found.reachable
        seen_deg = np.column_stack([found.alpha_deg, found.beta_deg])
        self.told_deg = np.where(known[:, None], seen_deg, self.told_deg)
        return self.told_deg.copy()

    def suspects(self):
        return {}

    async def close(self):
        pass


class PlainCamera:
    """True places with noise, um per coordinate."""

    def __init__(self, drive, noise_um=0.0, seed=0):
        self.drive, self.noise_um, self.rng = drive, noise_um, np.random.default_rng(seed)

    def measure(self, expected_mm):
        xy = self.drive.plane.forward(*self.drive.true_deg.T)
        xy = xy + 1e-3 * self.noise_um * self.rng.standard_normal(xy.shape)
        return Measurement(*xy.T, np.ones(len(xy), dtype=bool), self.drive.time_s)


def plain_hardware(plane, noise_um=0.0, **drive):
    made = PlainDrive(plane, **drive)
    known = np.ones(len(plane), dtype=bool)
    return Hardware(None, PlainCamera(made, noise_um), vouched=known, drive=made)


__all__ = ["PlainCamera", "PlainDrive", "plain_hardware"]
