"""`fiberloom calibrate transmission`: on the bench of the twin, or where positioners are mounted."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fiberloom.cli.array.options import CameraOption, ExcludeOptions, array_book, excluded
from fiberloom.cli.observe import TWIN
from fiberloom.cli.options import JsonOptions, PlaneOptions, TimingsOptions, require_folder
from fiberloom.cli.terminal import waiting
from fiberloom.errors import InputError
from fiberloom.wholefile import write_whole

if TYPE_CHECKING:
    from fiberloom.field import Field


@dataclass(frozen=True, kw_only=True)
class TransmissionOptions(ExcludeOptions, PlaneOptions, TimingsOptions, JsonOptions):
    """Of `calibrate transmission`."""

    camera: CameraOption = None
    points: Annotated[int, typer.Option(min=8, help="Points per axis and direction.")] = 200
    out: Annotated[Path, typer.Option(help="Folder for the maps.")] = Path("runs/transmission")

    @property
    def on_bench(self) -> bool:
        """The twin inside of this process, each unit alone."""
        return self.bus is None or self.bus.startswith(TWIN)

    def check(self) -> None:
        """Raises InputError for bad options that can be found without a slow import."""
        self.check_plane()
        left = excluded(self.exclude)
        if not self.on_bench and self.camera is None:
            raise InputError("--bus: name the camera too, e.g. --camera alpaca://10.1.10.40:11111/0")
        if self.on_bench and self.bus is None and (self.camera or left):
            option = "--camera" if self.camera else "--exclude"
            raise InputError(f"{option} goes with --bus: without one, the twin's bench is swept")

    def field(self) -> Field:
        """The units of the twin, or the array that `--bus` names."""
        from fiberloom.connect import open_hardware
        from fiberloom.field import Field

        plane = self.plane()
        if self.on_bench:
            return Field.twin(plane, self.seed, camera="noise")
        source = open_hardware(plane, self.address, self.camera, seed=self.seed)
        field = Field(plane, source, self.seed)
        field.book, field.exclude = array_book(self.address, self.store), excluded(self.exclude)
        return field


def transmission(options: TransmissionOptions) -> int:
    """Measure motor angle against output angle in both directions (Kronig 2020, Eq. 6 and 7).

    Exit code 1 where a positioner is refused.
    """
    options.check()
    require_folder(options.out)
    from fiberloom.report.outputs import marks
    from fiberloom.report.transmission import plot_transmission
    from fiberloom.store.calibrations import record_calibration

    out, field = options.out, options.field()
    field.command_line = " ".join(sys.argv)
    with waiting(options.as_json, options.timings) as field.watcher:
        calibration = field.run.sweep(
            options.points, out=out, keep=lambda found: found.maps.save(out / "transmission.npz")
        )
    summary = marks(field.plane, options.seed) | calibration.summary()
    write_whole(out / "transmission.json", json.dumps(summary, indent=2) + "\n")
    ok = calibration.report.ok
    plot_transmission(out / "transmission.png", calibration.maps, row=int(ok.argmax()))
    record_calibration(
        out / "transmission.npz",
        "transmission",
        field.plane.positioner_id[ok],
        summary,
        field.command_line,
        same_run=not options.on_bench,
    )
    options.show(summary | {"maps": str(out / "transmission.npz")})
    return 1 if summary["refused"] else 0
