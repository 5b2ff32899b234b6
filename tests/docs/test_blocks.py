"""The pages and the README: Python blocks run, commands of the command line exist with their options.

`<!-- given: NAME -->` before a block names what `prepared.py` prepares for it; `<!-- fragment: REASON -->`
marks a block that does not run.
"""

import ast
import asyncio
import inspect
import re
import shlex
from pathlib import Path

import click
import prepared
import pytest
import typer

import fiberloom.cli.app

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(
    r"(?:^<!-- (?P<how>given|fragment): (?P<what>[^>]+?) -->\n+)?^```python[^\n]*\n(?P<code>.*?)^```",
    re.M | re.S,
)
INDENTED = re.compile(r"^    (?:from [\w.]+ import |import \w|async def |def \w+\(|\w+ = await )", re.M)


def blocks(text):
    """(how, what, code) of every fenced Python block."""
    return [(m["how"], m["what"], m["code"]) for m in BLOCK.finditer(text)]


def outside(text):
    """The page without its fenced blocks."""
    return re.sub(r"^```.*?^```", "", text, flags=re.M | re.S)


ALL = [
    pytest.param(how, what, code, id=f"{page.relative_to(ROOT)}-{k}")
    for page in PAGES
    for k, (how, what, code) in enumerate(blocks(page.read_text()))
]


def run_block(code, names, where):
    """As in a script; `await` at the top as in Jupyter."""
    compiled = compile(code, where, "exec", flags=ast.PyCF_ALLOW_TOP_LEVEL_AWAIT, dont_inherit=True)
    made = eval(compiled, names)
    if inspect.iscoroutine(made):
        asyncio.run(made)


@pytest.mark.parametrize(("how", "what", "code"), ALL)
def test_python_blocks_run(how, what, code, tmp_path, monkeypatch, request):
    if how == "fragment":
        compile(code, request.node.name, "exec", flags=ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)
        return
    monkeypatch.chdir(tmp_path)
    given = getattr(prepared, what)(tmp_path, monkeypatch) if what else {}
    run_block(code, {"__name__": "docs", **given}, request.node.name)


def test_no_block_of_python_is_hidden():
    """Python in indented blocks would not be found."""
    assert [p.name for p in PAGES if INDENTED.search(outside(p.read_text()))] == []
    assert len(ALL) >= 10


# commands


def command_line():
    """The command `fiberloom` as click sees it."""
    app = fiberloom.cli.app.app
    return typer.main.get_command(app) if isinstance(app, typer.Typer) else app


def options(command):
    """Every option of a command, both spellings of a flag."""
    return {o for p in command.params for o in (*p.opts, *p.secondary_opts)} | {"--help"}


def every_command(group, path=()):
    """(path, command) of a group and all below it."""
    yield path, group
    context = click.Context(group)
    for name in group.list_commands(context) if hasattr(group, "list_commands") else ():
        yield from every_command(group.get_command(context, name), (*path, name))


COMMANDS = dict(every_command(command_line()))


def spoken(text):
    """Every command `fiberloom ...` in blocks and in backticks, without comments."""
    inline = re.findall(r"`(fiberloom(?: [^`\n]+(?:\n[^`\n]+)?)?)`", text)
    lines = re.findall(r"^\s*(?:\$ )?(fiberloom [^\n]*)$", "\n".join(code_lines(text)), re.M)
    return [re.sub(r"\s+#\s.*", "", line).strip() for line in (*inline, *lines)]


def code_lines(text):
    """Lines of indented and fenced blocks."""
    fenced = "\n".join(re.findall(r"^```(?:sh|bash|shell|text|console)?\n(.*?)^```", text, re.M | re.S))
    return [*fenced.splitlines(), *re.findall(r"^ {4}.*\S.*$", text, re.M)]


def faults(line):
    """What is wrong with one command of the pages."""
    line = re.sub(r"\[([A-Z_]+)(?: \.\.\.)?\]", r"\1", line.replace("...", "").replace(" &", ""))
    words = shlex.split(re.sub(r"(?<!\S)\[|\](?!\S)", " ", line))[1:]
    if words[:1] == ["--site"]:  # an option of the program, before the command
        words = words[2:]
    paths = [()]
    while words and any((*path, name) in COMMANDS for path in paths for name in words[0].split("|")):
        paths = [(*path, name) for path in paths for name in words[0].split("|")]
        words = words[1:]
    wrong = [f"{line}: no command {' '.join(p)}" for p in paths if p not in COMMANDS]
    groups = [p for p in paths if p in COMMANDS and hasattr(COMMANDS[p], "list_commands")]
    if groups and words and not words[0].startswith("-"):
        wrong.append(f"{line}: no command {words[0]}")
    for path in (p for p in paths if p in COMMANDS):
        said = {w.split("=")[0] for w in words if w.startswith("--")}
        wrong += [f"{line}: no option {word}" for word in sorted(said - options(COMMANDS[path]))]
    return wrong


SPOKEN = sorted({(str(p.relative_to(ROOT)), line) for p in PAGES for line in spoken(p.read_text())})


@pytest.mark.parametrize(("page", "line"), SPOKEN)
def test_commands_exist(page, line):
    assert faults(line) == []


def test_options_alone_exist():
    """`--option` in backticks belongs to some command, benchmark or study."""
    known = {o for command in COMMANDS.values() for o in options(command)}
    programs = [p for room in ("benchmarks", "examples", "tools") for p in (ROOT / room).rglob("*.py")]
    known |= {o for p in programs for o in re.findall(r'"(--[\w-]+)"', p.read_text())}
    used = {
        (p.name, word)
        for p in PAGES
        for code in re.findall(r"`([^`\n]+)`", outside(p.read_text()))
        for word in re.findall(r"(?<![\w-])--[a-z][\w-]*", code)
        if not code.startswith(("fiberloom", "make", "chrt", "gcc", "mkdocs"))
    }
    assert len(used) > 20
    assert sorted((page, word) for page, word in used if word not in known) == []


def test_programs_and_targets_exist():
    """`python benchmarks/x.py --option`, `pytest -s tests/x.py`, `make target`."""
    make = set(re.findall(r"^([a-z][\w-]*):", (ROOT / "Makefile").read_text(), re.M))
    wrong = []
    for page in PAGES:
        text = page.read_text()
        for path in re.findall(
            r"(?:python|pytest -s) ((?:benchmarks|tests|examples|tools)/[\w/]+\.py)", text
        ):
            wrong += [f"{page.name}: {path}"] if not (ROOT / path).is_file() else []
        for path, rest in re.findall(r"(benchmarks/\w+\.py)((?: [^`\n]+)?)`", text):
            there = set(re.findall(r'"(--[\w-]+)"', (ROOT / path).read_text()))
            wrong += [f"{page.name}: {path} {o}" for o in re.findall(r"--[a-z-]+", rest) if o not in there]
        for target in re.findall(r"(?:`|^ {4})make ([a-z][\w-]*)", text, re.M):
            wrong += [f"{page.name}: make {target}"] if target not in make else []
    assert wrong == []


# the checks can fail


def test_the_checks_can_fail():
    assert faults("fiberloom observe TARGETS --no-such-option")
    assert faults("fiberloom calibrate nothing")
    assert faults("fiberloom no-such-command")
    assert not faults("fiberloom calibrate friction|stiffness")
    assert faults("fiberloom calibrate friction|nothing")
    page = "text\n\n<!-- given: maps -->\n```python\nx = await y\n```\n\n```python\n1 / 0\n```\n"
    assert blocks(page) == [("given", "maps", "x = await y\n"), (None, None, "1 / 0\n")]
    with pytest.raises(ZeroDivisionError):
        run_block(blocks(page)[1][2], {}, "page")
