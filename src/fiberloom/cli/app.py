"""The command `fiberloom`. Everything it does can be done from Python too.

Commands import what they need when they run: help and refusals are quick. Of the commands themselves only
the one that is called is loaded.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from fiberloom.cli.options import add
from fiberloom.errors import InputError, StoppedError

HELP: dict[str, Any] = {"help_option_names": ["-h", "--help"]}

_COMMANDS: dict[str, dict[str, str]] = {
    "": {
        "observe": "observe:observe",
        "night": "night:night",
        "assign": "plan:assign",
        "plan": "plan:plan",
        "verify": "plan:verify",
        "twin": "twin:twin",
        "serve": "array.serve:serve",
        "park": "array.move:park",
        "home": "array.move:home",
        "recover": "array.move:recover",
        "stop": "array.move:stop",
        "status": "array.status:status",
        "doctor": "array.doctor:doctor",
        "lifetime": "lifetime:lifetime",
        "reproduce": "reproduce:reproduce",
        "instruments": "instruments:instruments",
        "runs": "past.runs:runs",
        "show": "past.show:show",
        "history": "past.history:history",
        "health": "health:health",
        "centroid": "images:centroid",
        "match": "images:match",
        "acceptance": "calibrate.acceptance:acceptance",
        "commission": "commission:commission",
    },
    "exclude": {
        "add": "array.exclude:exclude_add",
        "list": "array.exclude:exclude_list",
        "clear": "array.exclude:exclude_clear",
    },
    "store": {
        "upgrade": "past.store:upgrade",
        "check": "past.store:check",
        "copy": "past.store:copy",
    },
    "sky": {
        "place": "sky.place:place",
        "where": "sky.place:where",
        "drift": "sky.drift:drift",
        "guide": "sky.guide:guide",
        "survey": "sky.survey:survey",
    },
    "design": {
        "budget": "design.budget:budget",
        "check": "design.check:check",
        "compare": "design.compare:compare",
        "coverage": "design.coverage:coverage",
        "efficiency": "design.efficiency:efficiency",
        "gear": "design.gear:gear",
        "power": "design.power:power",
        "presets": "design.presets:presets",
        "report": "design.report:report",
        "spring": "design.gear:spring",
        "survey": "design.survey:survey",
        "sweep": "design.compare:sweep",
        "throughput": "design.throughput:throughput",
    },
    "calibrate": {
        "transmission": "calibrate.transmission:transmission",
        "steppers": "calibrate.steppers:steppers",
        "focal-plane": "calibrate.focal_plane:focal_plane",
        "fibres": "calibrate.fibres:fibres",
        "gravity": "calibrate.gravity:gravity",
        "history": "calibrate.learnt:history",
        "undo": "calibrate.learnt:undo",
        "friction": "calibrate.identification:friction",
        "inertia": "calibrate.identification:inertia",
        "coast": "calibrate.identification:coast",
        "stiffness": "calibrate.identification:stiffness",
        "arms": "calibrate.identification:arms",
        "repeatability": "calibrate.identification:repeatability",
    },
}
"""Where commands are below this package, by their group and name; those in no group first."""

_GROUPS = {
    "exclude": "Positioners of an array that must not be moved.",
    "store": "Stores: brought up to date, checked, copied.",
    "sky": "From RA and Dec to the focal plane, and back.",
    "design": "What a design promises, before anything is built.",
    "calibrate": "Measure the properties of each positioner.",
}


def app_of(words: Sequence[str] = ()) -> typer.Typer:
    """The command that `words` of a command line call, or the group of commands; all where they call none."""
    first = words[0] if words else ""
    known = first in _COMMANDS[""] or first in _GROUPS
    app = typer.Typer(
        invoke_without_command=True,
        context_settings=HELP,
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        help="From a target list to fibres on target, for alpha-beta fibre positioners.",
    )
    app.callback()(_root)
    for name, place in _COMMANDS[""].items():
        if name == first or not known:
            add(app, _command(place), name)
    for name, help_text in _GROUPS.items():
        if name == first or not known:
            app.add_typer(_group(name, help_text), name=name)
    return app


def _group(name: str, help_text: str) -> typer.Typer:
    group = typer.Typer(no_args_is_help=True, context_settings=HELP, help=help_text)
    for command, place in _COMMANDS[name].items():
        add(group, _command(place), command)
    return group


def _command(place: str) -> Any:
    module, _, function = place.partition(":")
    return getattr(importlib.import_module(f"fiberloom.cli.{module}"), function)


def __getattr__(name: str) -> Any:
    """`app`: the whole command line."""
    if name != "app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = app_of()
    return globals()[name]


def _version(show: bool) -> None:
    if show:
        from fiberloom.version import __version__

        typer.echo(f"fiberloom {__version__}")
        raise typer.Exit


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

_YOUNG = 400_000
"""New objects before the interpreter looks for cycles among them: more than a command imports, which are no
garbage. It is 700 by default, which the replies of 500 positioners are at every poll.
"""

_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "1")
"""Sums over several threads differ in the last bit, so a calibration would depend on the number of cores.
Read when a command imports numpy, later than this.
"""

_NO_PLUGINS = ("PYDANTIC_DISABLE_PLUGINS", "true")
"""Settings of ours need none: to find some, pydantic reads the files of every installed package."""

_BAD_WORDS: Any = typer.BadParameter.__mro__[2]
"""ClickException, of the click that this typer uses: newer versions of typer contain one."""


def main() -> None:
    """Entry point: exit code 0, 1 (ran, below requirement), 2 (bad input) or 130 (interrupted)."""
    gc.set_threshold(_YOUNG)
    # a process that ends gives all back at once: no need to look for cycles among all it has imported
    atexit.register(gc.freeze)
    os.environ.setdefault(*_ONE_THREAD)
    os.environ.setdefault(*_NO_PLUGINS)
    try:
        code = app_of(sys.argv[1:])(standalone_mode=False)
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
