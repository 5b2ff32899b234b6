"""Options of commands, each declared once: the fields of a dataclass are the parameters of a command.

A command is a function of its options that returns its exit code; `add` puts it on the command line.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import MISSING, Field, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_type_hints

import typer

from fiberloom.errors import InputError, StoppedError

if TYPE_CHECKING:
    from fiberloom.instruments import FocalPlane
    from fiberloom.instruments.pointing import ExposurePointing

Options = TypeVar("Options")


def add(app: typer.Typer, run: Callable[[Options], int | None], name: str | None = None) -> None:
    """Makes a command of `run`, a function of one dataclass whose fields carry typer's declarations.

    The command has the name of the function unless `name` is given, and exits with what the function
    returns (None: 0).
    """
    app.command(name, context_settings={"help_option_names": ["-h", "--help"]})(_typer_function(run))


def _typer_function(run: Callable[[Options], int | None]) -> Callable[..., None]:
    (parameter,) = inspect.signature(run).parameters
    options: Any = get_type_hints(run)[parameter]
    hints = get_type_hints(options, include_extras=True)

    def command(**values: Any) -> None:
        if code := run(options(**values)):
            raise typer.Exit(code)

    command.__name__, command.__doc__ = run.__name__, run.__doc__
    command.__annotations__ = hints
    command.__signature__ = inspect.Signature(  # type: ignore[attr-defined]  # functions may have one
        [_parameter(field, hints[field.name]) for field in fields(options)]
    )
    return command


def _parameter(field: Field[Any], hint: Any) -> inspect.Parameter:
    default = inspect.Parameter.empty if field.default is MISSING else field.default
    return inspect.Parameter(field.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=hint)


@dataclass(frozen=True, kw_only=True)
class JsonOptions:
    """Of a command that reports."""

    as_json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False

    def show(self, report: Any) -> None:
        """Prints a report: as a table, or as JSON."""
        if self.as_json:
            self.print_json(report)
        else:
            from fiberloom.report.tables import print_report

            print_report(report)

    @staticmethod
    def print_json(report: Any) -> None:
        """Prints a report as JSON."""
        typer.echo(json.dumps(report, indent=2, default=str))


@dataclass(frozen=True, kw_only=True)
class DatabaseOptions:
    """Of a command that keeps runs and nights."""

    database: Annotated[
        str, typer.Option(help="URL of the store, e.g. postgresql+psycopg://...; default: a file in --out.")
    ] = ""

    def check_database(self) -> None:
        """Raises InputError where the database is no URL."""
        if self.database and "://" not in self.database:
            raise InputError(
                f"--database: '{self.database}' is no URL; for a file in a folder give --out alone"
            )


@dataclass(frozen=True, kw_only=True)
class TimingsOptions:
    """Of a command that takes long."""

    timings: Annotated[
        bool,
        typer.Option(
            "--timings", help="Tell on stderr where the seconds went: by stage, and by kind of work."
        ),
    ] = False


@dataclass(frozen=True, kw_only=True)
class ErrorsOptions:
    """What a real array has wrong, in the twin."""

    errors: Annotated[
        str,
        typer.Option(
            help="What a real array has wrong, in the twin: none (default), all, or some: fibre=2,air."
        ),
    ] = ""


@dataclass(frozen=True, kw_only=True)
class PointingOptions:
    """Where the telescope points, at the image and while light is collected; deg."""

    zenith: Annotated[float | None, typer.Option(help="Zenith distance at the images, deg.")] = None
    rotator: Annotated[float, typer.Option(help="Rotator angle at the images, deg.")] = 0.0
    turn: Annotated[
        float, typer.Option(help="By which the rotator turns until the middle of the exposure, deg.")
    ] = 0.0
    fall: Annotated[
        float, typer.Option(help="By which the zenith distance grows until the middle of the exposure, deg.")
    ] = 0.0
    swing: Annotated[
        float, typer.Option(help="By which the rotator turns during the exposure, begin to end, deg.")
    ] = 0.0
    gravity: Annotated[
        Path | None, typer.Option(help="Sag of `calibrate gravity`: fibres are led by it; with --zenith.")
    ] = None

    def pointing(self) -> ExposurePointing | None:
        """None where no zenith distance is given; InputError for one that cannot be."""
        if self.zenith is None:
            for name in ("rotator", "turn", "fall", "swing", "gravity"):
                if getattr(self, name):
                    raise InputError(f"--{name}: goes with --zenith, the zenith distance at the images")
            return None
        from fiberloom.instruments.pointing import ExposurePointing, Pointing

        return ExposurePointing(Pointing(self.zenith, self.rotator), self.turn, self.fall, self.swing)


REQUIRED_SHARE = 0.95
"""Where neither a command nor an instrument says more."""


@dataclass(frozen=True, kw_only=True)
class RequireOptions:
    """Of a command that fails where too little was achieved."""

    require: Annotated[
        str | None,
        typer.Option(
            help="Least share that must succeed, 0.95 or 95%; below it the exit code is 1. Default: 95%; of "
            "observe what the instrument's file says (operation.required_share)."
        ),
    ] = None

    @property
    def required_share(self) -> float:
        """From 0 to 1; raises InputError for anything else."""
        if self.require is None:
            return REQUIRED_SHARE
        text = self.require.strip()
        try:
            share = float(text.removesuffix("%")) / (100.0 if text.endswith("%") else 1.0)
        except ValueError:
            share = -1.0
        if not 0.0 <= share <= 1.0:
            raise InputError(f"--require {text}: give a share, 0 to 1, or per cent with its sign: 0.95, 95%")
        return share

    def met(self, done: int, of: int) -> bool:
        """Are so many of so many enough?"""
        return met(done, of, self.required_share)  # also of nothing: one that is no share is told


def met(done: int, of: int, share: float) -> bool:
    """Are so many `done` `of` so many at least this `share`, 0 to 1? Nothing at all never is."""
    return done > 0 and done >= share * of


@dataclass(frozen=True, kw_only=True)
class LayoutOptions:
    """Of a command that needs to know which positioners there are."""

    instrument: Annotated[str, typer.Option(help="Preset name, or a TOML file of your own.")] = "sdssv"
    layout: Annotated[
        Path | None, typer.Option(help="Folder with the layout: ours, or SDSS-V calibration files.")
    ] = None
    seed: Annotated[int, typer.Option(min=0, help="The one seed of everything random.")] = 0

    def check_plane(self) -> None:
        """Raises InputError for bad options that can be found without a slow import."""
        if self.layout is not None and getattr(self, "positioners", None) is not None:
            raise InputError("--positioners goes with a preset; a --layout gives their number itself")
        if self.layout is not None and not self.layout.is_dir():
            raise InputError(f"{self.layout}: no such directory; a layout is a folder of tables")
        require_instrument(self.instrument)

    def _plane(self, positioners: int | None) -> FocalPlane:
        self.check_plane()
        from fiberloom.instruments import generate, load_instrument, read_layout

        model = load_instrument(self.instrument)
        if self.layout is None:
            return generate(model, self.seed, n_positioners=positioners)
        return read_layout(self.layout, model)


@dataclass(frozen=True, kw_only=True)
class PlaneOptions(LayoutOptions):
    """Of a command that works with a focal plane."""

    positioners: Annotated[
        int | None,
        typer.Option(min=1, help="Number of positioners of the preset, from the centre; default: all."),
    ] = None

    def plane(self) -> FocalPlane:
        """The focal plane of a preset or file, or of a layout."""
        return self._plane(self.positioners)


@dataclass(frozen=True, kw_only=True)
class SupplyOptions(PlaneOptions):
    """Of a command whose plans keep what the supply of the motors gives."""

    power: Annotated[
        float | None,
        typer.Option(
            help="Of the supply for all motors, W: plans are made slower, or in waves, until they keep it; "
            "in place of [care]. As `design power` counts."
        ),
    ] = None

    def plane(self) -> FocalPlane:
        """The focal plane; with `--power` its plans keep it."""
        return powered(super().plane(), self.power, self.seed)


def powered(plane: FocalPlane, limit_W: float | None, seed: int) -> FocalPlane:
    """The plane, whose plans keep a limit for all motors in W; None: that of its file.

    `seed`: of the units whose median motor counts.
    """
    if limit_W is None:
        return plane
    from dataclasses import replace

    from fiberloom.design.power import within_power

    try:
        return replace(plane, instrument=within_power(plane.instrument, limit_W, seed))
    except InputError as error:
        raise InputError(f"--power {limit_W:g}: {error}") from None


# checks that need no slow import


def require_instrument(name: str) -> None:
    """Raises InputError for a name that is neither a preset nor a file."""
    from fiberloom.instruments.names import check_name

    check_name(name)


def require_file(path: Path | None, hint: str = "") -> None:
    """Raises InputError for a file that does not exist; `hint`: what to do, for the message."""
    if path is not None and path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file")
    if path is not None and not path.is_file():
        raise InputError(f"{path}: no such file{hint and '; ' + hint}")


@contextmanager
def interruptible(kept: str) -> Iterator[None]:
    """After Ctrl-C the command says what is `kept`, not where measurements are: it has none."""
    try:
        yield
    except KeyboardInterrupt:
        raise StoppedError(f"interrupted; {kept}") from None


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Puts the name of a file before complaints about what is in it."""
    try:
        yield
    except InputError as error:
        raise InputError(str(error) if str(path) in str(error) else f"{path}: {error}") from None


def require_folder(out: Path) -> None:
    """Creates the folder of the results; raises InputError where it cannot be written."""
    from fiberloom.report.folder import prepare_folder

    prepare_folder(out)
