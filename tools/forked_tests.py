"""A plugin of pytest for the mutation run: collects once, then runs the tests in a fork for each mutant.

FL_FORKS names two file descriptors: from the first come lines of `number limit_s`, to the second goes for
each the exit code of pytest in the fork, or `timeout`. A build that holds every mutant of C chooses by a
variable, which is set in the fork: what is computed while tests are collected is computed without a mutant.
"""

import ctypes
import os
import signal
import time

import pytest

POLL_S = 0.02


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop() -> None:
    """In each fork returns, and pytest goes on to the tests; here ends with the input."""
    if "FL_FORKS" not in os.environ:
        return
    asked, told = (int(fd) for fd in os.environ["FL_FORKS"].split(","))
    chosen = mutant_switch()
    with os.fdopen(asked) as lines, os.fdopen(told, "w", buffering=1) as answers:
        for line in lines:
            number, limit_s = line.split()
            child = os.fork()
            if child == 0:
                os.setsid()
                chosen.value = int(number)
                return
            print(ended(child, float(limit_s)), file=answers)
    os._exit(0)


def mutant_switch() -> ctypes.c_int:
    """The variable that chooses the mutant."""
    import fiberloom._core as core

    return ctypes.c_int.in_dll(ctypes.CDLL(core.__file__), "fl_mutant")


def ended(child: int, limit_s: float) -> str:
    """Exit code of a process, negative where a signal ended it; `timeout` where it took too long."""
    until_s = time.monotonic() + limit_s
    while time.monotonic() < until_s:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return str(os.waitstatus_to_exitcode(status))
        time.sleep(POLL_S)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return "timeout"
