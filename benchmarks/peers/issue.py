"""What a processor can issue at best: its clock, core by core, and the bound of a loop that gcc made.

The bound is that of the inner loop of `plant.c` as it was compiled: its vector arithmetic (no loads,
stores or moves) on two pipes, at the clock that a chain of dependent additions shows. Memory costs nothing
in it, nor does waiting for results.
"""

import os
import re
import subprocess
import tempfile
from pathlib import Path

PIPES, STEPS = 2, 10
"""Of vector arithmetic in a core (Intel and AMD, 512 bit); plant steps in a tick."""
ADDITIONS = 400_000_000
# a register to itself: newer processors fold the addition of a constant away
_CLOCK = r"""
#include <stdio.h>
#include <time.h>
int main(void) {
    unsigned long x = 1;
    const clock_t begin = clock();
    for (long i = 0; i < %d; i += 16)
        __asm__ volatile(".rept 16\n add %%0, %%0\n .endr" : "+r"(x));
    printf("%%.3f\n", %d / (1e9 * (double)(clock() - begin) / CLOCKS_PER_SEC));
    return x == 1;
}
"""


def compiled(source, options, path):
    """What gcc makes of a C text, at this path; None where there is no gcc."""
    command = ["gcc", "-O3", "-march=native", "-xc", "-", *options, "-o", str(path), "-lm"]
    try:
        subprocess.run(command, input=source, text=True, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return path


def clocks_GHz():
    """Of each core of this process, alone and then all at once, by a fixed loop; empty without gcc."""
    cores = sorted(os.sched_getaffinity(0))
    with tempfile.TemporaryDirectory() as folder:
        program = compiled(_CLOCK % (ADDITIONS, ADDITIONS), [], Path(folder) / "clock")
        if program is None:
            return {}
        alone = [float(started(program, core).communicate()[0]) for core in cores]
        running = [started(program, core) for core in cores]
        together = [float(p.communicate()[0]) for p in running]
    return {"cores": cores, "alone": alone, "together": together}


def started(program, core):
    """The program on one core."""

    def there():
        os.sched_setaffinity(0, {core})

    return subprocess.Popen([str(program)], stdout=subprocess.PIPE, text=True, preexec_fn=there)


def bound_ns(source, real, clock_GHz):
    """ns per axis and tick below which the inner loop of a plant cannot come; None without gcc.

    `source`: its C text; `real`: double or float; `clock_GHz`: of the core.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = compiled(source, ["-S", "-ffast-math", f"-DREAL={real}"], Path(folder) / "plant.s")
        if path is None:
            return None
        loops = inner_loops(path.read_text().splitlines())
    loop = max(loops, key=lambda body: len(vector_arithmetic(body)))
    axes = bytes_of_turn(loop) / (8 if real == "double" else 4)
    return STEPS * len(vector_arithmetic(loop)) / (PIPES * clock_GHz * axes)


def bytes_of_turn(lines):
    """How far its pointer goes on in one turn of a loop."""
    steps = [re.fullmatch(r"\s+(?:add|sub)q\s+\$(-?\d+), %r\w+", line) for line in lines]
    return max(abs(int(step[1])) for step in steps if step)


def inner_loops(lines):
    """Bodies between a label and a jump back to it that hold no other such pair."""
    at = {line[:-1]: k for k, line in enumerate(lines) if re.fullmatch(r"\.L\w+:", line)}
    jumps = [(k, re.fullmatch(r"\s+j\w+\s+(\.L\w+)", line)) for k, line in enumerate(lines)]
    loops = [(at[jump[1]], k) for k, jump in jumps if jump and at.get(jump[1], k) < k]
    inner = [(a, b) for a, b in loops if not any(a <= c and d <= b and (a, b) != (c, d) for c, d in loops)]
    return [lines[a:b] for a, b in inner]


def vector_arithmetic(lines):
    """Those that a pipe of vector arithmetic has to take."""
    return [line for line in lines if re.match(r"\s+v(?!mov|broadcast)\w+\s.*[xyz]mm", line)]
