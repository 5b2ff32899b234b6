"""The command `fiberloom`. Everything it does can be done from Python too.

Commands import what they need when they run: help and refusals are quick.
"""

from __future__ import annotations

import atexit
import gc
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from fiberloom.cli.array.doctor import doctor
from fiberloom.cli.array.exclude import exclude_add, exclude_clear, exclude_list
from fiberloom.cli.array.move import home, park, recover, stop
from fiberloom.cli.array.serve import serve
from fiberloom.cli.array.status import status
from fiberloom.cli.calibrate.acceptance import acceptance
from fiberloom.cli.calibrate.fibres import fibres
from fiberloom.cli.calibrate.focal_plane import focal_plane
from fiberloom.cli.calibrate.gravity import gravity
from fiberloom.cli.calibrate.identification import arms, coast, friction, inertia, repeatability, stiffness
from fiberloom.cli.calibrate.learnt import history as learnt_history
from fiberloom.cli.calibrate.learnt import undo
from fiberloom.cli.calibrate.steppers import steppers
from fiberloom.cli.calibrate.transmission import transmission
from fiberloom.cli.commission import commission
from fiberloom.cli.design.budget import budget
from fiberloom.cli.design.check import check
from fiberloom.cli.design.compare import compare, sweep
from fiberloom.cli.design.coverage import coverage
from fiberloom.cli.design.efficiency import efficiency
from fiberloom.cli.design.gear import gear, spring
from fiberloom.cli.design.power import power
from fiberloom.cli.design.presets import presets
from fiberloom.cli.design.report import report
from fiberloom.cli.design.survey import survey as design_survey
from fiberloom.cli.design.throughput import throughput
from fiberloom.cli.health import health
from fiberloom.cli.images import centroid, match
from fiberloom.cli.instruments import instruments
from fiberloom.cli.lifetime import lifetime
from fiberloom.cli.night import night
from fiberloom.cli.observe import observe
from fiberloom.cli.options import add
from fiberloom.cli.past.history import history
from fiberloom.cli.past.runs import runs
from fiberloom.cli.past.show import show
from fiberloom.cli.past.store import check as check_store
from fiberloom.cli.past.store import copy, upgrade
from fiberloom.cli.plan import assign, plan, verify
from fiberloom.cli.reproduce import reproduce
from fiberloom.cli.sky.drift import drift
from fiberloom.cli.sky.guide import guide
from fiberloom.cli.sky.place import place, where
from fiberloom.cli.sky.survey import survey
from fiberloom.cli.twin import twin
from fiberloom.errors import InputError, StoppedError

HELP: dict[str, Any] = {"help_option_names": ["-h", "--help"]}

app = typer.Typer(
    invoke_without_command=True,
    context_settings=HELP,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="From a target list to fibres on target, for alpha-beta fibre positioners.",
)
calibrate = typer.Typer(
    no_args_is_help=True, context_settings=HELP, help="Measure the properties of each positioner."
)
exclude = typer.Typer(
    no_args_is_help=True, context_settings=HELP, help="Positioners of an array that must not be moved."
)
sky = typer.Typer(
    no_args_is_help=True, context_settings=HELP, help="From RA and Dec to the focal plane, and back."
)
store = typer.Typer(
    no_args_is_help=True, context_settings=HELP, help="Stores: brought up to date, checked, copied."
)
design = typer.Typer(
    no_args_is_help=True, context_settings=HELP, help="What a design promises, before anything is built."
)

add(app, observe)
add(app, night)
add(app, assign)
add(app, plan)
add(app, verify)
add(app, twin)
add(app, serve)
add(app, park)
add(app, home)
add(app, recover)
add(app, stop)
add(app, status)
add(app, doctor)
add(app, lifetime)
add(app, reproduce)
add(app, instruments)
add(app, runs)
add(app, show)
add(app, history)
add(app, health)
add(app, centroid)
add(app, match)
add(app, acceptance)
add(app, commission)

app.add_typer(exclude, name="exclude")
add(exclude, exclude_add, "add")
add(exclude, exclude_list, "list")
add(exclude, exclude_clear, "clear")

app.add_typer(store, name="store")
add(store, upgrade)
add(store, check_store)
add(store, copy)

app.add_typer(sky, name="sky")
add(sky, place)
add(sky, where)
add(sky, drift)
add(sky, guide)
add(sky, survey)

app.add_typer(design, name="design")
add(design, budget)
add(design, check)
add(design, compare)
add(design, coverage)
add(design, efficiency)
add(design, gear)
add(design, power)
add(design, presets)
add(design, report)
add(design, spring)
add(design, design_survey)
add(design, sweep)
add(design, throughput)

app.add_typer(calibrate, name="calibrate")
add(calibrate, transmission)
add(calibrate, steppers)
add(calibrate, focal_plane, "focal-plane")
add(calibrate, fibres)
add(calibrate, gravity)
add(calibrate, learnt_history, "history")
add(calibrate, undo)
add(calibrate, friction)
add(calibrate, inertia)
add(calibrate, coast)
add(calibrate, stiffness)
add(calibrate, arms)
add(calibrate, repeatability)


def _version(show: bool) -> None:
    if show:
        from fiberloom.version import __version__

        typer.echo(f"fiberloom {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    context: typer.Context,
    site: Annotated[
        Path | None,
        typer.Option(
            help="TOML file of an observatory: what is not typed of bus, camera, layout, store, ..."
        ),
    ] = None,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit
    if site is not None:
        from fiberloom.cli.array.site import load_site

        context.default_map = load_site(site).defaults()


BELOW, BAD_INPUT, INTERRUPTED = 1, 2, 130

_YOUNG = 100_000
"""New objects before the interpreter looks for cycles among them; 700 by default, which the replies of 500
positioners are at every poll.
"""

_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "1")
"""Sums over several threads differ in the last bit, so a calibration would depend on the number of cores.
Read when a command imports numpy, later than this.
"""

_BAD_WORDS: Any = typer.BadParameter.__mro__[2]
"""ClickException, of the click that this typer uses: newer versions of typer contain one."""


def main() -> None:
    """Entry point: exit code 0, 1 (ran, below requirement), 2 (bad input) or 130 (interrupted)."""
    gc.set_threshold(_YOUNG)
    # a process that ends gives all back at once: no need to look for cycles among all it has imported
    atexit.register(gc.freeze)
    os.environ.setdefault(*_ONE_THREAD)
    try:
        code = app(standalone_mode=False)
        if code == INTERRUPTED:  # typer's exit code for Ctrl-C
            raise KeyboardInterrupt
        sys.exit(code)
    except InputError as error:
        _fail(str(error), BAD_INPUT)
    except (typer.Abort, KeyboardInterrupt):
        _fail("interrupted; what was measured is kept: `fiberloom runs`, or the output folder", INTERRUPTED)
    except _BAD_WORDS as error:
        if type(error).__name__ == "NoArgsIsHelpError":
            print(error.format_message())
            sys.exit(0)
        context = getattr(error, "ctx", None)
        command = context.command_path if context else "fiberloom"
        _fail(f"{error.format_message().rstrip('.')}; see `{command} --help`", BAD_INPUT)
    except StoppedError as error:
        _fail(str(error), INTERRUPTED)
    except RuntimeError as error:
        from fiberloom.metrology.sources.errors import CameraError
        from fiberloom.operation.motion import UnsafePlanError

        if not isinstance(error, CameraError | UnsafePlanError):
            raise
        _fail(str(error), BELOW)
    except OSError as error:
        _fail(f"{error.filename or 'input/output'}: {error.strerror or error}", BAD_INPUT)


def _fail(message: str, code: int) -> None:
    print(f"fiberloom: {message}", file=sys.stderr)
    sys.exit(code)
