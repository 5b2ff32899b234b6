"""An array that stands still while the telescope tilts it and turns it: images that tell how arms sag.

The positioners go to a configuration and rest; the telescope points at each of several zenith distances and
rotator angles in turn, and an image is taken there. Then comes the next configuration.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.calibration.focal_plane.design import candidates
from fiberloom.calibration.gravity.images import TiltImages
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.pointing import Pointing
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.move import Goals, Recorder
from fiberloom.operation.recording import SurveyRecorder
from fiberloom.operation.safety.writing import entered
from fiberloom.operation.source import Source
from fiberloom.planning.placing import place_by_worth
from fiberloom.store import Store
from fiberloom.store.place import STORE
from fiberloom.typing import Floats

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class TiltSettings:
    """Of how many images."""

    configurations: int = 6
    """In which the positioners rest."""
    rotators: int = 6
    """Rotator angles, evenly over a turn: opposite ones turn the sign of every shift."""
    zenith_deg: float = 60.0
    """Zenith distance of the images."""
    seed: int = 0
    """Of places and planner."""

    def __post_init__(self) -> None:
        for name, least in (("configurations", 1), ("rotators", 2)):
            if getattr(self, name) < least:
                raise InputError(f"{name} = {getattr(self, name)}: must be {least} or more")
        self.pointings()

    def pointings(self) -> list[Pointing]:
        """Of the images of a configuration."""
        turns = np.arange(self.rotators) * 360.0 / self.rotators
        return [Pointing(self.zenith_deg, float(turn)) for turn in turns]


@dataclass(frozen=True)
class TiltRun:
    """Who records it."""

    command_line: str
    folder: Path
    """Of the store, exists."""
    marks: dict[str, Any]
    """Version, seed, instrument, configuration hash, UTC."""


async def record_tilts(
    known: tuple[FocalPlane, TransmissionMaps],
    source: Source,
    settings: TiltSettings,
    run: TiltRun,
    progress: Progress = lambda done, total: None,
) -> TiltImages:
    """Opens a field and takes its images, with a record of every move.

    `known`: layout and maps; `source`: of bus, camera and telescope; `settings`: which images; `run`: for the
    record; `progress`: called with the images done and all. InputError where the telescope is pointed from
    elsewhere.
    """
    plane, maps = known
    async with contextlib.AsyncExitStack() as stack:
        store = await stack.enter_async_context(entered(Store.open, run.folder / STORE))
        marks = run.marks
        recorded = await stack.enter_async_context(
            entered(
                lambda: store.start_run(
                    command_line=run.command_line,
                    instrument=marks["instrument"],
                    config_hash=marks["config_hash"],
                    seed=settings.seed,
                )
            )
        )
        hardware = await source.open()
        recorder = SurveyRecorder(recorded, plane)
        return await tilt_images((plane, maps), hardware, settings, recorder, progress)


async def tilt_images(
    known: tuple[FocalPlane, TransmissionMaps],
    hardware: Hardware,
    settings: TiltSettings,
    recorder: Recorder,
    progress: Progress = lambda done, total: None,
) -> TiltImages:
    """Images of N positioners in each configuration and at each pointing; then every positioner folds.

    `known`: layout and transmission maps; `hardware`: bus, camera and telescope; `settings`: which images;
    `recorder`: keeps every move; `progress`: called with the images done and all. Raises InputError where the
    telescope is pointed from elsewhere, no positioner answers or most fibres are not seen, UnsafePlanError
    where the verifier refuses a plan.
    """
    plane, maps = known
    if (telescope := hardware.telescope) is None:
        raise InputError(
            "the telescope is pointed from elsewhere: record the images and name their file, --images FILE"
        )
    motion = FieldMotion(plane, maps, hardware, recorder, lambda _: None)
    pointings, rng = settings.pointings(), np.random.default_rng([settings.seed, 0x6A])
    seen: list[tuple[Floats, Floats]] = []
    total = settings.configurations * len(pointings)
    try:
        telescope.point(pointings[0])
        await motion.connect()
        for number in range(settings.configurations):
            options = candidates(plane, rng)
            worth = rng.random(options.shape[:2])
            goal = place_by_worth(motion.state.obstacles(), options, worth, settings.seed + number)
            await motion.go(Goals.without_targets(plane, goal), settings.seed)
            for pointing in pointings:
                telescope.point(pointing)
                seen.append(await _seen(motion))
                progress(len(seen), total)
        await motion.go(Goals.without_targets(plane, plane.park_deg), settings.seed)
    finally:
        telescope.point(Pointing())
        await motion.close()
    angles, xy = (np.stack(column, axis=1) for column in zip(*seen, strict=True))
    configuration = np.repeat(np.arange(1, settings.configurations + 1), len(pointings))
    every = tuple(pointings * settings.configurations)
    return TiltImages(plane.positioner_id.astype(np.int64), configuration, every, angles, xy)


async def _seen(motion: FieldMotion) -> tuple[Floats, Floats]:
    """(N, 2) angles as reported, and places in an image; NaN where a report is not to be trusted."""
    image = await motion.look()
    good = image.seen & motion.state.healthy
    return motion.state.here_deg.copy(), np.where(good[:, None], image.xy_mm, np.nan)
