"""Options are declared once: fields of a dataclass become parameters of a command."""

import dataclasses
import typing
from dataclasses import dataclass
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from fiberloom.cli import app as cli_app
from fiberloom.cli import options as cli_options
from fiberloom.cli.options import JsonOptions, PlaneOptions, add
from fiberloom.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Some(JsonOptions):
    """Of a command of this test."""

    name: Annotated[str, typer.Argument(help="Who.")]
    times: Annotated[int, typer.Option(min=1, help="How often.")] = 2


def greet(options: Some) -> int:
    """Greets."""
    options.show({"greeting": options.name * options.times})
    return 3 if options.times > 5 else 0


def invoke(*words):
    app = typer.Typer(rich_markup_mode=None)
    add(app, greet)
    return CliRunner().invoke(app, list(words))


def test_fields_are_parameters_with_their_defaults_limits_and_help():
    assert '"greeting": "abab"' in invoke("ab", "--json").output
    assert "aaa" in invoke("a", "--times", "3").output
    assert invoke("a", "--times", "6").exit_code == 3
    assert invoke("a", "--times", "0").exit_code == 2
    assert invoke().exit_code == 2
    text = invoke("--help").output
    assert all(words in text for words in ("Greets.", "Who.", "How often.", "default: 2", "--json"))


def commands(group):
    for command in group.registered_commands:
        yield command.callback
    for below in group.registered_groups:
        yield from commands(below.typer_instance)


def test_every_parameter_of_every_command_has_help():
    for command in commands(cli_app.app):
        assert command.__doc__
        for name, hint in typing.get_type_hints(command, include_extras=True).items():
            (told,) = typing.get_args(hint)[1:]
            assert told.help, (command.__name__, name)


def test_no_option_is_declared_in_two_classes_alike():
    """Shared options live in a base class: none is repeated with the same name, help and default."""
    seen = {}
    for cls in all_below(JsonOptions) | all_below(cli_options.LayoutOptions):
        for name in cls.__annotations__:
            hint = typing.get_type_hints(cls, include_extras=True)[name]
            told = typing.get_args(hint)[1].help
            seen.setdefault((name, told), set()).add(cls.__name__)
    twice = {key: names for key, names in seen.items() if len(names) > 1}
    assert {name for name, _ in twice} <= {"out", "faults", "camera", "targets", "calibration", "points",
                                           "seed", "instrument", "where"}  # fmt: skip


def all_below(cls):
    return {cls} | {
        deeper for below in cls.__subclasses__() if below is not Some for deeper in all_below(below)
    }


def test_a_layout_says_itself_how_many_there_are(tmp_path):
    with pytest.raises(InputError, match="goes with a preset"):
        PlaneOptions(layout=tmp_path, positioners=3).plane()
    assert len(PlaneOptions(positioners=3).plane()) == 3
    assert dataclasses.asdict(PlaneOptions()) == {
        "instrument": "sdssv", "layout": None, "seed": 0, "positioners": None,
    }  # fmt: skip
