"""Worst-case stack of an image, from the compiler's call graph.

GCC writes the calls of each object and the stack of each function (-fcallgraph-info=su). Calls through
pointers are named here, by the member of the struct they go through; what comes from the compiler's own
library is read from the disassembly. Anything that cannot be bounded is refused: recursion, frames of
variable size, a call through a pointer without a name.
"""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

INDIRECT = "__indirect_call"
NODE = re.compile(r'node: \{ title: "([^"]+)" label: "([^"]*)"')
EDGE = re.compile(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"(?: label: "([^"]*)")?')
STACK = re.compile(r"(\d+) bytes \(([a-z,]+)\)")
CALL = re.compile(r"(\w+)\)?\s*\(")


class Unbounded(Exception):
    """The stack has no bound that this analysis can tell; the text says where."""


@dataclass
class Function:
    """A node: bytes of its own frame, and its calls."""

    frame: int | None = None
    calls: set[str] = field(default_factory=set)
    through: set[str] = field(default_factory=set)
    """Where it calls through pointers: file:line:column."""


Graph = dict[str, Function]


def plain_name(title: str) -> str:
    """Without the file of a static function and the suffixes of clones: as tables name it."""
    return title.rpartition(":")[2].split(".")[0]


def _frame(label: str, name: str) -> int | None:
    found = STACK.search(label)
    if found is None:
        return None
    if "dynamic" in found[2]:
        raise Unbounded(f"{name} has a frame of variable size")
    return int(found[1])


def read_graph(files: list[Path]) -> Graph:
    """All objects' graphs as one."""
    graph: Graph = {}
    for file in files:
        text = file.read_text()
        for title, label in NODE.findall(text):
            node = graph.setdefault(title, Function())
            frame = _frame(label, title)
            if frame is not None:
                node.frame = frame
        for source, target, label in EDGE.findall(text):
            node = graph.setdefault(source, Function())
            if target == INDIRECT:
                node.through.add(label)
            else:
                node.calls.add(target)
    graph.pop(INDIRECT, None)
    return graph


def _member(site: str, root: Path) -> str:
    """The struct's member that a call at file:line:column goes through."""
    name, line, column = site.rsplit(":", 2)
    path = Path(name) if Path(name).is_absolute() else root / name
    text = path.read_text().splitlines()[int(line) - 1]
    found = CALL.search(text[int(column) - 1 :])
    if found is None:
        raise Unbounded(f"{site}: which pointer is called here?")
    return found[1]


def _titles(graph: Graph) -> dict[str, list[str]]:
    """Functions by their plain names: static ones may share a name."""
    titles: dict[str, list[str]] = {}
    for title in graph:
        titles.setdefault(plain_name(title), []).append(title)
    return titles


def resolve(graph: Graph, tables: dict[str, list[str]], root: Path) -> None:
    """Calls through pointers become calls of everything that may stand behind them."""
    by_name = _titles(graph)
    for node in graph.values():
        for site in node.through:
            member = _member(site, root)
            if member not in tables:
                raise Unbounded(f"{site}: no name for what is behind '{member}'")
            for name in tables[member]:
                if name not in by_name:
                    raise Unbounded(f"'{member}' is said to be {name}, which is not in the image")
                node.calls.update(by_name[name])


# -- what has no graph: the compiler's library ---------------------------------------------------------

HEAD = re.compile(r"^[0-9a-f]+ <([^>]+)>:$")
PUSH = re.compile(r"\t(?:stmdb\tsp!,|push|vpush|vstmdb\tsp!,)\s*\{([^}]*)\}")
GROW = re.compile(r"\tsub(?:w|\.w)?\tsp, (?:sp, )?#(\d+)")
STORE = re.compile(r"\tstr\w*(?:\.w)?\t.*\[sp, #-(\d+)\]!")
BRANCH = re.compile(r"\t(?:bl|b|b\.n|b\.w|b[a-z]{2}\.[nw]|cbn?z)\t.*<([^>+]+)(\+0x[0-9a-f]+)?>")


def _registers(text: str) -> int:
    """How many 32-bit words a list of registers is."""
    words = 0
    for item in text.replace(" ", "").split(","):
        first, _, last = item.partition("-")
        count = int(last[1:]) - int(first[1:]) + 1 if last else 1
        words += count * (2 if first.startswith("d") else 1)
    return words


def read_disassembly(text: str) -> Graph:
    """Frames and calls as the instructions have them: every growth of a function's stack counted once."""
    graph: Graph = {}
    node = Function()
    name = ""
    for line in text.splitlines():
        if head := HEAD.match(line):
            name = head[1]
            node = graph.setdefault(name, Function(frame=0))
        elif push := PUSH.search(line):
            node.frame = (node.frame or 0) + 4 * _registers(push[1])
        elif grown := GROW.search(line) or STORE.search(line):
            node.frame = (node.frame or 0) + int(grown[1])
        elif (branch := BRANCH.search(line)) and branch[1] != name:
            node.calls.add(branch[1])
    return graph


def disassemble(image: Path) -> str:
    """The instructions of an image."""
    command = ["arm-none-eabi-objdump", "-d", "--no-show-raw-insn", str(image)]
    return subprocess.run(command, check=True, text=True, capture_output=True).stdout


def complete(graph: Graph, machine: Graph) -> None:
    """Adds what the compiler's graph leaves out: library functions, and calls of them that it inserted."""
    compiled = _titles({title: node for title, node in graph.items() if node.frame is not None})
    for name, code in machine.items():
        library = {call for call in code.calls if plain_name(call) not in compiled}
        for title in compiled.get(plain_name(name), []):
            graph[title].calls |= library
        if plain_name(name) not in compiled:
            ours = {title for call in code.calls - library for title in compiled[plain_name(call)]}
            graph[name] = Function(code.frame, library | ours)
    # an object declares what another one defines: the definition has the frame
    for node in graph.values():
        node.calls = {title for call in node.calls for title in compiled.get(plain_name(call), [call])}


# -- the deepest way -----------------------------------------------------------------------------------


def deepest(graph: Graph, entry: str) -> tuple[int, list[str]]:
    """Bytes of the deepest chain of calls from a function, and the chain."""
    known: dict[str, tuple[int, list[str]]] = {}

    def visit(title: str, above: tuple[str, ...]) -> tuple[int, list[str]]:
        if title in above:
            loop = [*above[above.index(title) :], title]
            raise Unbounded("recursion: " + " -> ".join(plain_name(name) for name in loop))
        if title in known:
            return known[title]
        node = graph.get(title)
        if node is None or node.frame is None:
            raise Unbounded(f"{plain_name(title)}: its stack is not known")
        below = max((visit(call, (*above, title)) for call in sorted(node.calls)), default=(0, []))
        known[title] = (node.frame + below[0], [plain_name(title), *below[1]])
        return known[title]

    titles = [title for title in graph if plain_name(title) == entry]
    if not titles:
        raise Unbounded(f"{entry} is not in the image")
    return visit(titles[0], ())
