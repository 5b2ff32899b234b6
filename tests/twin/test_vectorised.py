"""Law loops of every kernel are vector code: one that the compiler gives up costs the twin half its speed."""

import platform
import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TWIN = ROOT / "core/twin"
LAWS = TWIN / "src/kernel/law_body.hpp"
INCLUDES = [
    TWIN / "include",
    ROOT / "core/geometry/include",
    *(
        ROOT / "firmware" / part
        for part in ("law", "law/drive", "law/open_loop", "port", "positioner", "positioner/axis", "can")
    ),
]


def options(kernel):
    """The flags that the build gives to a kernel."""
    lists = (TWIN / "CMakeLists.txt").read_text()
    both = re.search(r'set\(kernel_options "([^"]*)"\)', lists)[1]
    own = re.search(rf'kernel_{kernel}\.cpp\s+PROPERTIES\s+COMPILE_OPTIONS "([^"]*)"', lists)[1]
    return own.replace("${kernel_options}", both).split(";")


def compiled(source, *flags):
    """What the compiler says of a source of the twin, and what it makes of it in assembly."""
    command = ["g++", "-O3", "-DNDEBUG", "-std=c++20", "-fPIC", "-fvisibility=hidden", "-ffp-contract=off"]
    command += ["-S", "-o", "-", *flags, *(f"-I{path}" for path in INCLUDES), TWIN / "src" / source]
    return subprocess.run(command, capture_output=True, text=True, check=True)


@cache
def of_kernel(kernel):
    """A kernel as its build compiles it, once for all that is looked for in it."""
    return compiled(f"kernel/kernel_{kernel}.cpp", *options(kernel), "-fopt-info-vec-optimized")


def vectorised_lines(kernel):
    """Lines of law_body.hpp with a loop that became vector code, once for each time it did."""
    said = of_kernel(kernel).stderr
    return [int(line) for line in re.findall(r"law_body\.hpp:(\d+):\d+: optimized: loop vectorized", said)]


def gcc():
    if platform.machine() not in ("x86_64", "AMD64") or not shutil.which("g++"):
        return False
    told = subprocess.run(["g++", "--version"], capture_output=True, text=True, check=False).stdout
    return "Free Software Foundation" in told


needs_gcc = pytest.mark.skipif(not gcc(), reason="apt-get install g++, on x86-64: its code is looked at")


@pytest.mark.slow
@needs_gcc
@pytest.mark.parametrize("kernel", ["baseline", "avx2", "avx512"])
def test_laws_are_vector_code(kernel):
    loops = [n for n, line in enumerate(LAWS.read_text().splitlines(), 1) if "for (int i = 0" in line]
    lines = vectorised_lines(kernel)
    assert not set(loops) - set(lines)
    torque, touch, phases = loops[-3:]
    assert lines.count(torque) == 4, "by either law, alone and among others"
    assert lines.count(touch) == 2, "where the contact's law knows whether teeth touch, and where none does"
    assert lines.count(phases) == 1


def functions(assembly):
    """The lines of each function, by its symbol."""
    found, lines = {}, []
    for line in assembly.splitlines():
        label = re.match(r"(_Z\w+):", line)
        if label:
            lines = found.setdefault(label[1], [])
        lines.append(line)
    return found


@pytest.mark.slow
@needs_gcc
@pytest.mark.parametrize("kernel", ["baseline", "avx2", "avx512"])
def test_no_call_is_left_inside_a_substep(kernel):
    made = functions(of_kernel(kernel).stdout)
    within = re.compile(
        r"\d(drift|kick|push|drift_now|load_pushing|end_pushing|torque_impulse|close_gap)I?[LE]?"
    )
    assert not [name for name in made if within.search(name)]


@pytest.mark.slow
@needs_gcc
def test_the_widest_kernel_keeps_in_registers_what_moves():
    made = functions(of_kernel("avx512").stdout)
    gliding = next(lines for name, lines in made.items() if "5glideILi4ELb0E" in name)
    products = sum("vmulps" in line for line in gliding)
    assert products > 2 * 4 * 15, "four vectors of a substep, in the loop and after it, not one of each"


@pytest.mark.slow
@needs_gcc
def test_amplitudes_of_a_gear_are_asked_for():
    """A function that only prefetches does nothing for the compiler, which once left out its calls."""
    made = functions(compiled("plant.cpp").stdout)
    used = "\n".join(line for name, lines in made.items() if "10fetch_gear" not in name for line in lines)
    called = re.search(r"(call|jmp)\s+\S*10fetch_gear", used)
    inlined = re.search(r"prefetch\w+\s+\(%\w+,\s*%\w+\)\s+addq\s+\$64", used)  # its loop over lines
    assert called or inlined
