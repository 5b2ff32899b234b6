"""`fiberloom observe`: from a target list to fibres on target."""

from __future__ import annotations

import time
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.array.options import ArmsFileOptions, ExcludeOptions, array_book, command_line, excluded
from fiberloom.cli.options import (
    ErrorsOptions,
    JsonOptions,
    PointingOptions,
    RequireOptions,
    SupplyOptions,
    TimingsOptions,
    met,
    naming,
    require_file,
    require_folder,
)
from fiberloom.cli.plan import ChoiceOptions, TargetsArgument
from fiberloom.cli.terminal import waiting
from fiberloom.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from fiberloom.field import Field
    from fiberloom.instruments import FocalPlane
    from fiberloom.operation.results import Observation

TWIN = "twin:"


class CameraKind(StrEnum):
    """Cameras of the twin."""

    noise = "noise"
    image = "image"


class Correction(StrEnum):
    """How corrections weigh the images."""

    filtered = "filtered"
    plain = "plain"


class Pages(StrEnum):
    """Exposures that get pages with figures."""

    none = "none"
    last = "last"
    all = "all"


FieldCameraOption = Annotated[
    str | None,
    typer.Option(
        help="image or noise of the twin (default: image); with --bus: alpaca://HOST:PORT/N, folder:PATH, "
        "indi://HOST:PORT/NAME, aravis:NAME."
    ),
]
FaultsOption = Annotated[str, typer.Option(help="Put faults into the twin, e.g. dark=3,dead=1,lying=1.")]
MapsOption = Annotated[
    Path | None,
    typer.Option(help="Transmission maps; default: calibrate once, then the cache."),
]


@dataclass(frozen=True, kw_only=True)
class ObservationOptions(
    ChoiceOptions,
    PointingOptions,
    ExcludeOptions,
    ArmsFileOptions,
    RequireOptions,
    ErrorsOptions,
    SupplyOptions,
    TimingsOptions,
    JsonOptions,
):
    """Of `fiberloom observe`."""

    targets: TargetsArgument
    moves: Annotated[
        int | None,
        typer.Option(
            min=1, help="Exact number of moves, with the blind one; default: the instrument's stop rule."
        ),
    ] = None
    correction: Annotated[
        Correction | None,
        typer.Option(help="Kalman filter, or Eq. 25 as printed; default: the instrument's."),
    ] = None
    images: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="After each move, at most: as many as the camera's noise asks for; default: the "
            "instrument's.",
        ),
    ] = None
    exposures: Annotated[
        int,
        typer.Option(
            min=1,
            help="Of a series, each as long as the --field says; between them fibres follow their targets.",
        ),
    ] = 1
    camera: FieldCameraOption = None
    pages: Annotated[Pages, typer.Option(help="Exposures that get pages: image, residuals, distortion.")] = (
        Pages.last
    )
    save_images: Annotated[bool, typer.Option(help="Keep every exposure as FITS.")] = False
    faults: FaultsOption = ""
    compare_linear: Annotated[
        bool, typer.Option(help="Measure a blind move by a linear gear ratio too, at the end.")
    ] = False
    swap: Annotated[
        bool,
        typer.Option(
            "--swap/--no-swap",
            help="Choose targets by the ways from where the positioners are; swap them where the motion is "
            "held up.",
        ),
    ] = False
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the results; default: runs/0001, by the number of the run."),
    ] = None
    calibration: MapsOption = None
    fibres: Annotated[
        Path | None, typer.Option(help="Offsets of `calibrate fibres`: science fibres on their arms.")
    ] = None
    adapt: Annotated[
        bool, typer.Option("--adapt/--no-adapt", help="Learn the maps from every measured move.")
    ] = False
    learnt: Annotated[
        str | None,
        typer.Option(help="Store of the learnt maps; default with --adapt: beside the maps."),
    ] = None

    def required_of(self, plane: FocalPlane) -> float:
        """Share of the assigned fibres that must be on target: as `--require` says, else the instrument."""
        return plane.instrument.operation.required_share if self.require is None else self.required_share


def observe(options: ObservationOptions) -> int:
    """Put fibres on the targets of a list, and report the error of each one.

    Exit code 1 where fewer of the assigned fibres than `--require` says, or else the instrument's file
    (operation.required_share), are within the requirement, or a verified trajectory has a collision.
    """
    started_s = time.monotonic()
    check(options)
    options.pointing()  # one that cannot be is told before anything is read
    if options.require is not None:
        _ = options.required_share  # one that is no share is told before anything is read
    targets = options.read_targets(options.targets, options.instrument)
    from fiberloom.store.place import Place

    require_folder(Place.of(options.out).base)
    field = field_of(options)
    required = options.required_of(field.plane)
    field.command_line, field.begun_s = command_line(), started_s
    from fiberloom.assignment.candidates import check_targets

    with naming(options.targets):
        check_targets(field.plane, targets)
    summary: dict[str, Any] = {}

    def keep(seen: Observation) -> None:
        assert field.folder is not None
        if seen.targets.on_sky is not None:
            from fiberloom.operation.results.fibermap import write_fibermap

            write_fibermap(seen, field.folder)
        seen.save(field.folder)
        summary.update(seen.summary() | {"folder": str(field.folder)})

    field.keep = keep
    with waiting(options.as_json, options.timings) as field.watcher:
        field.run.observe(
            targets,
            None if options.moves is None else options.moves - 1,
            out=options.out,
            correction=None if options.correction is None else options.correction.value,
            images=options.images,
            compare_linear=options.compare_linear,
            strict=options.strict,
            swap=options.swap,
            exposures=options.exposures,
            arms=options.arms,
            fibres=options.fibres,
            gravity=options.gravity,
            pointing=options.pointing(),
            learnt=options.learnt,
            adapt=options.adapt,
            pages=options.pages.value,
            save_images=options.save_images,
        )
    if options.as_json:
        options.print_json(summary)
    else:
        print_observation(summary, required)
    enough = met(summary["n_within_requirement"], summary["n_assigned"], required)
    return 0 if enough and not summary["collisions_verified"] else 1


_FILES = {
    "calibration": "make one with 'fiberloom calibrate transmission'",
    "arms": "make one with 'fiberloom calibrate focal-plane'",
    "fibres": "make one with 'fiberloom calibrate fibres'",
    "gravity": "make one with 'fiberloom calibrate gravity'",
    "measured": "name the store of an earlier run",
}
"""Options that name files, and where the files come from."""


def check(options: Any) -> None:
    """Raises InputError for bad options that can be found without a slow import."""
    from fiberloom.twin.errors.switches import check_switches

    options.check_plane()
    check_switches(options.errors)
    _check_faults(options)
    check_camera(options)
    begins = {"calibration"} if getattr(options, "adapt", False) else set()  # such a file may be made yet
    for name, hint in _FILES.items():
        if name not in begins:
            require_file(getattr(options, name, None), hint)


def _check_faults(options: Any) -> None:
    """Raises InputError for faults that the twin of this instrument does not know."""
    if not options.faults:
        return
    from fiberloom.twin.faults.grammar import parse_faults
    from fiberloom.twin.faults.kinds import ANYWHERE, OBSERVED

    # twins of other motors have faults of their own, and refuse the others themselves
    parse_faults(options.faults, OBSERVED if _is_sdssv(options.instrument) else ANYWHERE)


def _is_sdssv(instrument: str) -> bool:
    """Whether its motors are those of SDSS-V: of a file by its protocol, the preset without slow imports."""
    if not instrument.endswith(".toml"):
        return instrument == "sdssv"
    from fiberloom.instruments import load_instrument

    return load_instrument(instrument).drive.protocol == "sdssv"


def check_camera(options: Any) -> None:
    """Raises InputError for a camera that does not go with the bus."""
    excluded(options.exclude)
    if options.bus is not None and not options.bus.startswith(TWIN):
        if options.camera is None:
            raise InputError(
                "--bus: name the camera too, e.g. --camera alpaca://10.1.10.40:11111/0; --camera none "
                "where no camera looks (MEGARA, MOONS)"
            )
        for option, text in (("--faults", options.faults), ("--errors", options.errors)):
            if text:
                raise InputError(f"{option} goes with the twin inside of this process")
    elif options.camera is not None and options.camera.removeprefix(TWIN) not in tuple(CameraKind):
        raise InputError(f"--camera {options.camera}: known are {', '.join(CameraKind)}; others need a --bus")


def field_of(options: Any, camera: str = "image") -> Field:
    """The field of a command: on the twin inside of this process, unless `--bus` says otherwise.

    `camera`: of the twin, where none is named.
    """
    from fiberloom.connect import open_hardware
    from fiberloom.field import Field

    plane, bus = options.plane(), options.bus or TWIN
    wrong = {"faults": options.faults, "errors": options.errors}
    source = open_hardware(plane, bus, options.camera or camera, seed=options.seed, **wrong)
    field = Field(plane, source, options.seed, options.calibration)
    field.exclude = excluded(options.exclude)
    if options.bus is not None or field.exclude:
        field.book = array_book(bus, options.store)
    return field


def print_observation(summary: dict[str, Any], required: float = 0.0) -> None:
    """Prints how an observation went; in red what is below `required`, a share of the assigned fibres.

    `summary`: of the observation, and `folder`, where its files are.
    """
    from rich.console import Console

    from fiberloom.report.tables import (
        budget_line,
        drift_line,
        guiding_lines,
        left_out_line,
        observation_table,
        series_lines,
        shortfall,
        spread_table,
        temperature_line,
    )

    console = Console()
    console.print(observation_table(summary))
    console.print()  # below the caption of the first table
    console.print(spread_table(summary))
    say(console, budget_line(summary["budget"]))
    images = sum(move["images"] for move in summary["moves"] if not move["comparison"])
    console.print(
        f"planning {summary['plan_cpu_s']:.1f} CPU s, motion {summary['motion_s']:.1f} s, {images} images, "
        f"{summary['collisions_verified']} collisions in verified trajectories; "
        f"everything took {summary['wall_s']:.0f} s"
    )
    if summary["contacts_true"]:
        console.print(f"arms touched {summary['contacts_true']} times, as only a twin knows", style="red")
    console.print(f"corrections ended: {summary['stopped']}")
    if "temperature" in summary and (line := temperature_line(summary["temperature"])):
        say(console, line)
    if "referenced" in summary:
        how = ", ".join(f"{n} {how}" for how, n in summary["referenced"].items() if n)
        console.print(f"no datum was on record, positioners were referenced first: {how}")
    if line := left_out_line(summary.get("left_out", {})):
        say(console, line)
    for note in summary["notes"]:
        say(console, f"note: {note}")
    if "learnt" in summary:
        console.print(
            "learnt: {moves} moves of generation {generation} in {store}".format(**summary["learnt"])
        )
    if "reposition_every_s" in summary.get("sky", {}):
        say(console, drift_line(summary["sky"]))
    for line in guiding_lines(summary):
        say(console, line)
    for line in series_lines(summary.get("series", [])):
        say(console, line)
    for kind, positioners in summary["faults"].items():
        console.print(f"flagged {kind}: {', '.join(map(str, positioners))}", style="red")
    for line in shortfall(summary, required):
        console.print(line, style="red")
    files = "summary.json, fibres.ecsv, trajectories.json, *.png"
    if "sky" in summary:
        files += ", fibermap.fits (RA and Dec under each fibre)"
    say(console, f"results in {summary['folder']}/: {files}")


def say(console: Console, line: str) -> None:
    """Prints a line as it is: paths and what was typed are not broken, their brackets are no colours."""
    console.print(line, markup=False, soft_wrap=True)
