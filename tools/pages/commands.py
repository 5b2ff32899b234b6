"""The page of the commands, written from the command line itself when the site is built."""

import re
from collections.abc import Iterator
from typing import Any

import typer

PROGRAM = "fiberloom"
HEAD = """# Commands

Written from the command line when this site was built: `{program} COMMAND --help` says the same.
Options are read as `--name value`; `--site FILE.toml` goes before the command and gives what is not typed
([Arrays and sessions](operation/array.md)).

Exit codes of every command:

| code | meaning |
|---|---|
| 0 | done |
| 1 | it ran, and the result is below what is required, as said with the command; or the camera failed |
| 2 | bad input: one line says what, where, what to do |
| 130 | interrupted or stopped; what was measured is kept |

"""
EXIT_ONE = re.compile(r"exit code 1 (where|if) ([^.]+)\.", re.I)
"""What the help of a command says of its exit code 1."""
BESIDE = re.compile(r"(?:^|\s\s)\[([^\[\]]*(?:\[[^\]]*\][^\[\]]*)*)\]$")
"""The end of an option's help: default, range, required."""


def commands() -> list[tuple[str, Any]]:
    """Every command that does something, with its full name, in the order of the help."""
    from fiberloom.cli.app import app

    return list(_below(PROGRAM, typer.main.get_command(app)))


def _below(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    inside = getattr(command, "commands", None)
    if inside is None:
        yield name, command
    for word, found in (inside or {}).items():
        if found.hidden:
            continue
        yield from _below(f"{name} {word}", found)


def page() -> str:
    """The page as Markdown."""
    found = commands()
    listed = "".join(f"- [`{name}`](#{anchor(name)}): {_first(command)}\n" for name, command in found)
    return HEAD.format(program=PROGRAM) + listed + "\n" + "\n".join(_section(*pair) for pair in found)


def anchor(name: str) -> str:
    """The heading of a command as the site links to it."""
    return name.replace(" ", "-")


def _first(command: Any) -> str:
    return str(command.help).strip().split("\n\n")[0].replace("\n", " ")


def _said(command: Any) -> str:
    """The help without the paragraph about the exit code, which follows the options."""
    paragraphs = str(command.help).strip().split("\n\n")
    return "\n\n".join(p for p in paragraphs if not EXIT_ONE.match(p))


def _section(name: str, command: Any) -> str:
    context = typer.Context(command, info_name=name)
    usage = " ".join([name, *command.collect_usage_pieces(context)])
    return (
        f"## {name}\n\n{_said(command)}\n\n```text\n{usage}\n```\n\n"
        + "".join(_table(kind, command, context) for kind in ("argument", "option"))
        + f"Exit code 1: {exit_one(command)}.\n"
    )


def exit_one(command: Any) -> str:
    """When the command ends with exit code 1."""
    said = EXIT_ONE.search(" ".join(str(command.help).split()))
    return f"{said[1].lower()} {said[2]}" if said else "none of its own"


def shown(command: Any, kind: str) -> list[Any]:
    """Parameters of a kind (argument, option) that the help shows."""
    return [p for p in command.params if p.param_type_name == kind and not getattr(p, "hidden", False)]


def _table(kind: str, command: Any, context: typer.Context) -> str:
    rows = "".join(_row(parameter, context) for parameter in shown(command, kind))
    return f"| {kind} | meaning | default, range |\n|---|---|---|\n{rows}\n" if rows else ""


def _row(parameter: Any, context: typer.Context) -> str:
    names, text = parameter.get_help_record(context)
    names = names.replace("|", ", ").replace(" range>", ">")
    beside = BESIDE.search(text)
    said = BESIDE.sub("", text).strip()
    cells = (f"`{names}`", said, (beside[1] if beside else "").removeprefix("default: "))
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"
