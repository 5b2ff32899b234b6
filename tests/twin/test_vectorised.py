"""Law loops of every kernel are vector code: one that the compiler gives up costs the twin half its speed."""

import platform
import re
import shutil
import subprocess
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


def vectorised_lines(kernel):
    """Lines of law_body.hpp with a loop that became vector code, once for each time it did."""
    command = ["g++", "-O3", "-DNDEBUG", "-std=c++20", "-ffp-contract=off", "-S", "-o", "/dev/null"]
    command += [*options(kernel), *(f"-I{path}" for path in INCLUDES), "-fopt-info-vec-optimized"]
    done = subprocess.run(
        [*command, TWIN / f"src/kernel/kernel_{kernel}.cpp"], capture_output=True, text=True, check=True
    )
    return [
        int(line) for line in re.findall(r"law_body\.hpp:(\d+):\d+: optimized: loop vectorized", done.stderr)
    ]


def gcc():
    if platform.machine() not in ("x86_64", "AMD64") or not shutil.which("g++"):
        return False
    told = subprocess.run(["g++", "--version"], capture_output=True, text=True, check=False).stdout
    return "Free Software Foundation" in told


@pytest.mark.slow
@pytest.mark.skipif(not gcc(), reason="apt-get install g++, on x86-64: it says which loops it vectorised")
@pytest.mark.parametrize("kernel", ["baseline", "avx2", "avx512"])
def test_laws_are_vector_code(kernel):
    loops = [n for n, line in enumerate(LAWS.read_text().splitlines(), 1) if "for (int i = 0" in line]
    lines = vectorised_lines(kernel)
    assert not set(loops) - set(lines)
    torque, touch, phases = loops[-3:]
    assert lines.count(torque) == 4, "by either law, alone and among others"
    assert lines.count(touch) == 2, "where the contact's law knows whether teeth touch, and where none does"
    assert lines.count(phases) == 1
