"""What the firmware costs on a Cortex-M4F: flash, RAM, stack, instructions per tick; against the aims.

    python -m lab.report [--out DIR]      `make firmware-report`

Exit code 1 when an aim is missed, 2 when something is missing on this machine.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from lab import build, scenarios, stack
from lab.unit import Cost, Unit

FLASH_AIM = 48 * 1024
RAM_AIM = 24 * 1024
TICK_AIM = 3000
"""Instructions of both axes: 5 % of the 60 000 cycles that a 120 MHz core has in 0.5 ms."""
CYCLES_PER_TICK = 60_000
COUNT = 40
"""Instructions between two counts of the clock."""
UNSEEN = COUNT - 1
"""That may have been more than what was counted: begin and end lie anywhere between two counts."""

PORT = ("read_hall", "set_phases", "send_frame", "storage_read", "storage_write", "open_phases")
INTERRUPTS = ("adc_handler", "can_handler")
EXCEPTION_FRAME = 26 * 4 + 4
"""Bytes the core stacks for an interrupt: 8 registers, 18 of the floating-point unit, alignment."""

FLASH_SECTIONS = (".text", ".init_array", ".rodata", ".ARM.extab", ".ARM.exidx", ".data")
RAM_SECTIONS = (".data", ".bss")
PHASES = {
    "trajectory of 1000 points, both axes": "trajectory_of_a_thousand_points",
    "trajectory with approach": "precise_trajectory",
    "go-to": "go_to",
    "short moves at random": "short_moves",
    "open loop": "open_loop",
    "law 1, moves": "law_1",
    "law 1, datum search": "law_1_datum",
    "law 1, cogging calibration": "law_1_cogging",
    "hall calibration": "hall_calibration",
    "datum search": "datum_search",
    "cogging calibration": "cogging_calibration",
    "host silent": "host_watch",
    "rotor held": "collision",
    "arm against a stop": "arm_against_a_stop",
    "trace and torque step": "bench_trace",
    "save, power cycle": "save_and_restore",
    "save cut at every byte": "power_loss_in_a_save",
}


@dataclass(frozen=True)
class Aim:
    """One line of the verdict."""

    name: str
    value: int
    limit: int
    unit: str

    @property
    def met(self) -> bool:
        """Whether the value is below its limit."""
        return self.value < self.limit


def sections(image: Path) -> dict[str, int]:
    """Bytes of every section."""
    command = ["arm-none-eabi-size", "-A", str(image)]
    text = subprocess.run(command, check=True, text=True, capture_output=True).stdout
    return {m[1]: int(m[2]) for m in re.finditer(r"^(\.\S+)\s+(\d+)", text, re.MULTILINE)}


def modules(archive: Path) -> dict[str, int]:
    """Bytes of flash of every source file, before the linker drops what is not called."""
    command = ["arm-none-eabi-size", str(archive)]
    text = subprocess.run(command, check=True, text=True, capture_output=True).stdout
    rows = re.finditer(r"^\s*(\d+)\s+(\d+)\s+\d+\s+\d+\s+\S+\s+(\w+)\.c\.obj", text, re.MULTILINE)
    return {m[3]: int(m[1]) + int(m[2]) for m in rows}


def _graphs(objects: Path, sources: Path) -> list[Path]:
    """The call graphs beside objects whose sources exist: a build folder keeps those of moved files."""
    graphs = sorted(objects.glob("**/*.ci"))
    return [file for file in graphs if (sources / file.relative_to(objects)).with_suffix("").exists()]


def image_graph(folder: Path) -> stack.Graph:
    """The call graph of the image with the board; `folder` is the build's top."""
    firmware = folder / "firmware"
    objects = _graphs(firmware / "CMakeFiles" / "fl_firmware.dir", build.ROOT / "firmware")
    objects += _graphs(firmware / "boards" / "stm32f405" / "CMakeFiles" / "positioner.dir", build.BOARD)
    graph = stack.read_graph(objects)
    handlers = [name for name in map(stack.plain_name, graph) if name.startswith("fl_handle_")]
    tables = {name: [name] for name in PORT} | {"handler": handlers}
    # constructors of C++: none, as the empty section shows; the board takes no image of an upgrade, and has
    # no temperature sensor
    tables |= {"init": [], "image_write": [], "read_temperature": []}
    stack.resolve(graph, tables, build.ROOT)
    machine = stack.read_disassembly(stack.disassemble(folder / "programs" / "positioner.elf"))
    stack.complete(graph, machine)
    return graph


@dataclass(frozen=True)
class Stack:
    """Bytes: the background, the deepest interrupt on top of it, and its chain of calls."""

    background: int
    interrupt: int
    deepest: list[str]

    @property
    def total(self) -> int:
        """One interrupt at a time: tick and bus have the same priority."""
        return self.background + EXCEPTION_FRAME + self.interrupt


def worst_stack(graph: stack.Graph) -> Stack:
    """Raises stack.Unbounded."""
    background, _ = stack.deepest(graph, "reset_handler")
    interrupt, chain = max(stack.deepest(graph, name) for name in INTERRUPTS)
    return Stack(background, interrupt, chain)


def measure(command: list[str]) -> dict[str, dict[str, Cost]]:
    """Instructions of every phase."""
    costs = {}
    for phase, name in PHASES.items():
        unit = Unit(command)
        try:
            (scenarios.SCENARIOS | scenarios.MORE)[name](unit)
            costs[phase] = unit.cost()
        finally:
            unit.kill()
    return costs


DEEP = ("save_and_restore", "hall_calibration", "precise_trajectory", "power_loss_in_a_save")
"""Scenarios that go deep: saves, fits, notes of the position."""
ENTRIES = {"tick": "fl_positioner_tick", "frame": "fl_positioner_receive", "boot": "fl_positioner_init"}


def seen_stack(command: list[str]) -> dict[str, int]:
    """Bytes of stack that the firmware's functions really took, on the rig."""
    deepest = dict.fromkeys(ENTRIES, 0)
    for name in DEEP:
        unit = Unit(command)
        unit.look_deep = True
        try:
            scenarios.SCENARIOS[name](unit)
            for kind, cost in unit.cost().items():
                deepest[kind] = max(deepest[kind], cost.deepest)
        finally:
            unit.kill()
    return deepest


def report() -> dict:
    """Everything, as it is written to JSON. Raises Missing, Unbounded."""
    programs = build.build("cortex-m4f")
    folder = programs.parent
    size = sections(programs / "positioner.elf")
    assert size.get(".init_array", 0) == 0, "the firmware has constructors"
    costs = measure(build.rig_command("cortex-m4f"))
    graph = image_graph(folder)
    deep = worst_stack(graph)
    moving = costs[next(iter(PHASES))]["tick"]
    return {
        "flash_bytes": sum(size.get(name, 0) for name in FLASH_SECTIONS),
        "ram_bytes": sum(size.get(name, 0) for name in RAM_SECTIONS),
        "stack_bytes": deep.total,
        "stack": asdict(deep),
        "stack_bounds": {kind: stack.deepest(graph, entry)[0] for kind, entry in ENTRIES.items()},
        "stack_seen": seen_stack(build.rig_command("cortex-m4f")),
        "tick_instructions_mean": round(moving.mean),
        "tick_instructions_worst": max(cost["tick"].most for cost in costs.values()) + UNSEEN,
        "frame_instructions_worst": max(cost["frame"].most for cost in costs.values()) + UNSEEN,
        "boot_instructions_worst": max(cost["boot"].most for cost in costs.values()) + UNSEEN,
        "phases": {phase: {k: asdict(v) for k, v in cost.items()} for phase, cost in costs.items()},
        "modules_bytes": modules(folder / "firmware" / "libfl_firmware.a"),
    }


def aims(data: dict) -> list[Aim]:
    """What the firmware is held to."""
    return [
        Aim("flash", data["flash_bytes"], FLASH_AIM, "bytes"),
        Aim("RAM, with 1000 points an axis", data["ram_bytes"], RAM_AIM, "bytes"),
        Aim("RAM and worst-case stack", data["ram_bytes"] + data["stack_bytes"], RAM_AIM, "bytes"),
        Aim("instructions a tick, both axes, worst", data["tick_instructions_worst"], TICK_AIM, ""),
    ]


def tables(data: dict) -> str:
    """The report as Markdown, readable on a terminal."""
    deep = data["stack"]
    share = data["tick_instructions_worst"] / CYCLES_PER_TICK
    lines = ["| | | aim | |", "|---|--:|--:|---|"]
    for aim in aims(data):
        verdict = "met" if aim.met else "MISSED"
        lines.append(f"| {aim.name} | {aim.value} {aim.unit} | < {aim.limit} | {verdict} |")
    lines += [
        "",
        f"Stack: {data['stack_bytes']} bytes = {deep['background']} before interrupts "
        f"+ {EXCEPTION_FRAME} of the core + {deep['interrupt']} in the deepest:",
        "  " + " > ".join(deep["deepest"]),
        "Seen on the rig, of the bound: "
        + ", ".join(f"{kind} {data['stack_seen'][kind]} of {data['stack_bounds'][kind]}" for kind in ENTRIES)
        + ".",
        "",
        f"Instructions (counted in steps of {COUNT}; worst: with {UNSEEN} added). Worst tick: "
        f"{100 * share:.1f} % of a 120 MHz core's {CYCLES_PER_TICK} cycles.",
        "",
        "| phase | ticks | mean | worst |",
        "|---|--:|--:|--:|",
    ]
    for phase, cost in data["phases"].items():
        tick = cost["tick"]
        if tick["calls"] == 0:
            continue
        lines.append(f"| {phase} | {tick['calls']} | {tick['mean']:.0f} | {tick['most'] + UNSEEN} |")
    lines += [
        "",
        f"A frame: at most {data['frame_instructions_worst']} (53, save). "
        f"Power-up: at most {data['boot_instructions_worst']}.",
        "",
        "| source | flash, bytes |",
        "|---|--:|",
    ]
    lines += [f"| {name} | {n} |" for name, n in sorted(data["modules_bytes"].items(), key=lambda m: -m[1])]
    return "\n".join(lines)


def write(data: dict, folder: Path) -> None:
    """firmware-report.json and firmware-report.md."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "firmware-report.json").write_text(json.dumps(data, indent=1) + "\n")
    (folder / "firmware-report.md").write_text("# The firmware on a Cortex-M4F\n\n" + tables(data) + "\n")


def main(arguments: list[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, default=build.ROOT / "build", help="folder of the report")
    options = parser.parse_args(arguments)
    build.install()
    try:
        data = report()
    except build.Missing as missing:
        print(f"firmware-report: {missing}: nothing was measured", file=sys.stderr)
        return 2
    except stack.Unbounded as unbounded:
        print(f"firmware-report: no bound for the stack: {unbounded}", file=sys.stderr)
        return 1
    write(data, options.out)
    print(tables(data))
    return 0 if all(aim.met for aim in aims(data)) else 1


if __name__ == "__main__":
    sys.exit(main())
