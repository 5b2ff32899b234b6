"""The stack analysis refuses what it cannot bound; the image of the board is what it is said to be."""

import re
import struct
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "rig"))

from lab import build, report, stack


def graph_of(tmp_path, *lines):
    """A call graph as the compiler writes it."""
    file = tmp_path / "some.ci"
    file.write_text('graph: { title: "some.c"\n' + "\n".join(lines) + "\n}\n")
    return stack.read_graph([file])


def node(name, size, kind="static"):
    return f'node: {{ title: "{name}" label: "{name}\\nsome.c:1:1\\n{size} bytes ({kind})" }}'


def edge(source, target, where="some.c:1:1"):
    return f'edge: {{ sourcename: "{source}" targetname: "{target}" label: "{where}" }}'


def test_the_deepest_way_is_not_the_longest(tmp_path):
    graph = graph_of(
        tmp_path,
        *(node(name, size) for name, size in {"a": 8, "b": 16, "c": 4, "d": 100}.items()),
        edge("a", "b"),
        edge("b", "c"),
        edge("a", "d"),
    )
    assert stack.deepest(graph, "a") == (108, ["a", "d"])
    assert stack.deepest(graph, "b") == (20, ["b", "c"])


def test_recursion_is_refused(tmp_path):
    lines = [node("a", 8), node("b", 8), node("c", 8), edge("a", "b"), edge("b", "c"), edge("c", "b")]
    with pytest.raises(stack.Unbounded, match="b -> c -> b"):
        stack.deepest(graph_of(tmp_path, *lines), "a")


def test_a_frame_of_variable_size_is_refused(tmp_path):
    with pytest.raises(stack.Unbounded, match="variable"):
        graph_of(tmp_path, node("a", 8, "dynamic"))


def test_a_function_without_a_frame_is_refused(tmp_path):
    with pytest.raises(stack.Unbounded, match="mystery"):
        stack.deepest(graph_of(tmp_path, node("a", 8), edge("a", "mystery")), "a")


@pytest.mark.parametrize("call", ["p->port.action(p, f(1));", "    return row->action(p);", "(*action)();"])
def test_pointers_are_followed_through_the_table_and_only_that(tmp_path, call):
    (tmp_path / "some.c").write_text(call + "\n")
    column = call.index("action") + 1
    lines = [node("a", 8), node("small", 16), node("other.c:large", 64), edge("a", stack.INDIRECT)]
    lines[3] = edge("a", stack.INDIRECT, f"some.c:1:{max(column - 3, 1)}")
    graph = graph_of(tmp_path, *lines)
    with pytest.raises(stack.Unbounded, match="'action'"):
        stack.resolve(graph, {}, tmp_path)
    with pytest.raises(stack.Unbounded, match="gone"):
        stack.resolve(graph, {"action": ["gone"]}, tmp_path)
    stack.resolve(graph, {"action": ["small", "large"]}, tmp_path)
    assert stack.deepest(graph, "a") == (72, ["a", "large"])


DISASSEMBLY = """
08000200 <__aeabi_ldivmod>:
 8000200:\tpush\t{r4, r5, r7, lr}
 8000202:\tsub\tsp, #8
 8000204:\tbl\t8000300 <__udivmoddi4>
 8000208:\tbeq.n\t800020c <__aeabi_ldivmod+0xc>
08000300 <__udivmoddi4>:
 8000300:\tstmdb\tsp!, {r4-r8, lr}
 8000304:\tvpush\t{d8-d9}
"""


def test_the_library_is_read_from_its_instructions(tmp_path):
    graph = graph_of(tmp_path, node("a", 8), edge("a", "__aeabi_ldivmod"))
    stack.complete(graph, stack.read_disassembly(DISASSEMBLY))
    assert stack.deepest(graph, "a") == (8 + 24 + 40, ["a", "__aeabi_ldivmod", "__udivmoddi4"])


def test_what_the_guide_shows_is_what_is_compiled():
    guide = (build.ROOT / "docs" / "firmware" / "porting.md").read_text()
    board = (build.BOARD / "board_stm32f405.c").read_text()
    blocks = re.findall(r"```c\n(.*?)```", guide, re.DOTALL)
    assert len(blocks) == 4
    for block in blocks:
        assert block in board


# -- the image -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def programs():
    try:
        return build.build("cortex-m4f")
    except build.Missing as missing:
        pytest.skip(f"left out: {missing}")


def symbols(image):
    done = subprocess.run(["arm-none-eabi-nm", str(image)], check=True, text=True, capture_output=True)
    return {line.split()[-1]: int(line.split()[0], 16) for line in done.stdout.splitlines()}


def test_the_vectors_of_the_board_lead_to_its_handlers(programs, tmp_path):
    binary = tmp_path / "positioner.bin"
    image = programs / "positioner.elf"
    subprocess.run(["arm-none-eabi-objcopy", "-O", "binary", str(image), str(binary)], check=True)
    vectors = struct.unpack("<37I", binary.read_bytes()[: 4 * 37])
    at = symbols(image)
    assert vectors[0] == at["link_stack_top"] == 0x20020000
    # bit 0: Thumb; interrupts follow the sixteen of the core, RM0090 table 61
    assert vectors[1] == at["reset_handler"] | 1
    assert vectors[16 + 18] == at["adc_handler"] | 1
    assert vectors[16 + 20] == at["can_handler"] | 1


def test_no_heap_and_no_double_in_the_image(programs):
    names = set(symbols(programs / "positioner.elf"))
    assert not names & {"malloc", "_malloc_r", "_sbrk", "free"}
    doubles = {name for name in names if name.startswith(("__aeabi_d", "__aeabi_f2d", "__aeabi_i2d"))}
    assert not doubles
    # the same search finds them where they are: the rig's plant is calculated in double
    assert {"__aeabi_dmul", "_sbrk"} <= set(symbols(programs / "rig.elf"))


def test_every_aim_is_met(programs):
    data = report.report()
    missed = [aim for aim in report.aims(data) if not aim.met]
    assert not missed
    # counted at all: less than these no firmware with two loops needs
    assert data["tick_instructions_mean"] > 500
    # the rig's port is not the board's: some words of difference; and the scenarios do go deep
    for kind, bound in data["stack_bounds"].items():
        assert 0.8 * bound < data["stack_seen"][kind] < bound + 32, kind
    assert report.tables(data).count(" met |") == len(report.aims(data))


def test_a_missed_aim_is_told():
    aim = report.Aim("flash", 49152, report.FLASH_AIM, "bytes")
    assert not aim.met
