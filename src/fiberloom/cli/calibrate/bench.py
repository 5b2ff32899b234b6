"""Options and steps of all commands of a bench: units of a preset, alone under a camera, with weights."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from fiberloom.cli.options import JsonOptions, LayoutOptions, require_folder
from fiberloom.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    from fiberloom.calibration.bench.bench import Progress
    from fiberloom.calibration.bench.rig import BenchRig
    from fiberloom.instruments import FocalPlane
    from fiberloom.twin import Units
    from fiberloom.twin.draw import Knowledge

Found = TypeVar("Found")


@dataclass(frozen=True, kw_only=True)
class BenchOptions(LayoutOptions, JsonOptions):
    """Of every command of a bench."""

    positioners: Annotated[
        int | None,
        typer.Option(
            min=1, help="Number of positioners of the preset on the bench, from its centre; default: 1."
        ),
    ] = None
    faults: Annotated[str, typer.Option(help="Put faults into the twin, e.g. dark=1.")] = ""
    bus: Annotated[str | None, typer.Option(help="A bus that a site file names is refused.", hidden=True)] = (
        None
    )

    def check(self, out: Path) -> None:
        """Raises InputError for bad options that can be found without a slow import."""
        from fiberloom.twin.faults.grammar import parse_faults
        from fiberloom.twin.faults.kinds import OBSERVED

        if self.bus is not None and not self.bus.startswith("twin:"):
            raise InputError(
                f"--bus {self.bus}: single units are measured on the bench of the twin here, not in an "
                "array; leave --site out, or use fiberloom.calibration.bench with your own rig"
            )
        parse_faults(self.faults, OBSERVED)
        self.check_plane()
        require_folder(out)

    def plane(self) -> FocalPlane:
        """The layout, or `positioners` of the preset from its centre; one unless given."""
        return self._plane(self.positioners if self.layout is not None else self.positioners or 1)

    def rig(
        self, plane: FocalPlane, firmware: Knowledge = "identified", serial: str = ""
    ) -> tuple[BenchRig, Units]:
        """The bench, and for reports the true properties of its units.

        `firmware`: its parameters; `serial`: number of the unit, another one is another unit.
        """
        from fiberloom.twin import draw_units
        from fiberloom.twin.bench import bench_rig, seed_of_serial

        units = draw_units(plane, seed_of_serial(self.seed, serial), firmware=firmware)
        return bench_rig(plane, units, self.seed, self.faults), units


@dataclass(frozen=True, kw_only=True)
class UnitOptions(BenchOptions):
    """Of a command that judges units."""

    points: Annotated[int, typer.Option(min=8, help="Points per axis and direction.")] = 200
    visits: Annotated[int, typer.Option(min=5, help="Visits to each of three targets, per axis.")] = 30
    serial: Annotated[str, typer.Option(help="Serial number of the unit, for the report.")] = ""
    tilt: Annotated[
        float | None, typer.Option(help="Tilt of the fibre, deg, measured elsewhere: this bench cannot.")
    ] = None
    engineer: Annotated[str, typer.Option(help="Name of the engineer, for the report.")] = ""


@dataclass(frozen=True, kw_only=True)
class CreepOptions(BenchOptions):
    """Of a command that measures friction."""

    places: Annotated[int, typer.Option(min=2, help="Output angles at which to creep.")] = 5
    span: Annotated[
        float | None, typer.Option(min=5.0, help="Length of the runs, deg of the arm; default: the range.")
    ] = None


def on_bench(rig: BenchRig, work: Callable[[BenchRig], Awaitable[Found]]) -> Found:
    """Finds the units that answer, and lets `work` measure them."""

    async def connected() -> Found:
        await rig.client.discover()
        return await work(rig)

    return asyncio.run(connected())


def counting(count: Progress) -> Progress:
    """Hands on one of eight reports, and the last: a terminal is not redrawn more often."""
    return lambda done, total: count(done, total) if done % 8 == 0 or done == total else None
