"""One fact, one place: what has a name is not written out a second time in the package."""

import ast
import re
from pathlib import Path

import pytest

import fiberloom
from fiberloom import units
from fiberloom._core import firmware, twin
from fiberloom.calibration.transmission.sweep import SweepSettings, wire_grid
from fiberloom.instruments import generate, load_instrument

PACKAGE = Path(fiberloom.__file__).parent

FACTS = {
    "columns of arms": (r"arms\[[^\]]*, ?-?[0-9]", "instruments/arms.py"),
    "length of the beta arm": (r"hypot\(\*?[\w.]*points\[", "instruments/views.py"),
    "names of the axes": (r"[(\[]['\"]alpha['\"], ['\"]beta['\"][)\]]", "units.py"),
    "gear": (r"(?<!SAMPLES = )\b1024(\.0)?\b(?!, )|\bN_BAR\b", "units.py"),
    "tick": (r"\b(0\.5e-3|5e-4|0\.0005|0\.25e-3)\b", "units.py"),
    "run-up": (r"\b840(\.0)?\b(?! motor)|\b0\.82\b", "units.py"),
    "camera of the workspace": (r"float = 0\.669\b", "metrology/noise.py"),
}
"""Pattern of the fact written out, and the file that may."""


def written_out(pattern: str, home: str) -> list[str]:
    """Lines of other files that match; a docstring may show the figure in an example."""
    return [
        f"{path.relative_to(PACKAGE)}:{number}: {line.strip()}"
        for path in sorted(PACKAGE.rglob("*.py"))
        if str(path.relative_to(PACKAGE)) != home
        for number, line in enumerate(without_docstrings(path.read_text()), 1)
        if re.search(pattern, line) and "Literal[" not in line
    ]


def without_docstrings(source: str) -> list[str]:
    """The lines, those of strings that stand alone left empty."""
    lines = source.splitlines()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            for number in range(node.lineno, (node.end_lineno or node.lineno) + 1):
                lines[number - 1] = ""
    return lines


@pytest.mark.parametrize("fact", FACTS)
def test_a_fact_is_written_once(fact):
    assert written_out(*FACTS[fact]) == []


def test_gear_and_tick_are_those_of_the_compiled_firmware_and_of_the_instrument():
    assert units.TICK_S == twin.TICK_S
    assert units.TICKS_PER_S * units.TICK_S == 1.0
    assert [axis.gear for axis in load_instrument("sdssv").axes] == [units.GEAR, units.GEAR]


def test_the_run_up_is_the_firmwares_and_the_presets():
    default = {name: line for name, *line in firmware.AXIS_PARAMS}["approach"]
    assert units.RUN_UP_MOTOR_DEG in default
    for axis in load_instrument("sdssv").axes:
        # the preset gives two digits
        assert axis.approach_deg == round(units.RUN_UP_MOTOR_DEG / axis.gear, 2)


def test_a_sweep_runs_up_by_the_approach_of_its_instrument():
    plane = generate(load_instrument("sdssv"), 0, n_positioners=1)
    there = wire_grid(plane, SweepSettings(run_up_deg=0.82))
    assert (wire_grid(plane, SweepSettings()) == there).all()
    assert (wire_grid(plane, SweepSettings(run_up_deg=0.5)) != there).any()
