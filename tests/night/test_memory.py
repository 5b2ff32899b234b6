"""A night of many fields holds no more than one of a few: neither objects nor pages."""

import gc
import subprocess
import sys
import threading
import weakref
from collections import Counter
from ctypes import CDLL
from itertools import pairwise
from pathlib import Path
from statistics import median

import numpy as np
import pytest
from nights import Night

from fiberloom.night import carry, runner
from fiberloom.operation.safety import memory

FIELDS = 14
QUEUE = "".join(
    f'[[field]]\nid = "f{k}"\ntargets = "{"abc"[k % 3]}.csv"\nexposure_s = 60\n' for k in range(FIELDS)
)
SETTLED = 4
"""Fields until what is made once is there."""
MOST_OBJECTS = 20
"""That one field more may leave, the median: rows of its visit, of its exposure and of its stages."""
PAGE = 4096
GLIBC = hasattr(CDLL(None), "malloc_info")
NO_GLIBC = "heaps of the GNU C library are looked at; this system has another one"


def resident():
    """Bytes of this process in memory."""
    return PAGE * int(Path("/proc/self/statm").read_text().split()[1])


def tracked():
    """Objects that Python keeps, by the name of their type, without those that only wait to be collected.

    Weak references to what is gone are not counted: they are cleared some hundred at a time.
    """
    gc.collect()
    alive = (one for one in gc.get_objects() if not isinstance(one, weakref.ref) or one() is not None)
    return Counter(type(one).__name__ for one in alive)


@pytest.fixture(scope="module")
def night(tmp_path_factory):
    """A night of many fields, with its objects counted while each shutter is open."""
    night = Night(tmp_path_factory.mktemp("memory"), QUEUE)
    night.counted, night.given, night.few = [], [], []
    with pytest.MonkeyPatch.context() as patch:

        def give_back():
            night.given.append(night.book.exposures()[-1])
            night.counted.append(tracked())
            memory.give_back()

        patch.setattr(runner, "give_back", give_back)
        patch.setattr(carry, "few_heaps", lambda: night.few.append(True))
        assert night.run().status == "finished"
    return night


def test_what_positioning_has_left_is_given_back_while_the_shutter_is_open(night):
    assert [exposure.number for exposure in night.given] == [1] * FIELDS
    assert len({exposure.visit_id for exposure in night.given}) == FIELDS


def test_a_night_has_few_heaps(night):
    assert night.few == [True]


def test_objects_do_not_grow_with_the_fields(night):
    settled = night.counted[SETTLED:]
    more = {name: median(b[name] - a[name] for a, b in pairwise(settled)) for name in settled[-1]}
    growing = {name: n for name, n in more.items() if n > 0}
    assert sum(growing.values()) < MOST_OBJECTS, growing


@pytest.mark.skipif(not GLIBC, reason=NO_GLIBC)
def test_free_pages_of_all_heaps_are_given_back():
    kept, size = [], 64 * 1024  # below 128 KiB the C library takes memory of a heap, not of the system

    def work():
        made = [np.full(size, 1, dtype=np.uint8) for _ in range(1000)]
        kept.append(made[-1])  # at the top of the heap: what is below cannot be given back by itself

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    before = resident()
    memory.give_back()
    assert before - resident() > 0.7 * 2 * 1000 * size


HEAPS_OF_SIX_THREADS = """
import ctypes, sys, threading
from fiberloom.operation.safety.memory import few_heaps
if "few" in sys.argv:
    few_heaps()
meet = threading.Barrier(6)
def work():
    meet.wait()  # all are there before one allocates
    kept = [bytes(1000) for _ in range(100)]
    meet.wait()
threads = [threading.Thread(target=work) for _ in range(6)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
c = ctypes.CDLL(None)
c.fopen.restype = ctypes.c_void_p
file = ctypes.c_void_p(c.fopen(sys.argv[1].encode(), b"w"))
c.malloc_info(0, file)
c.fclose(file)
"""


@pytest.mark.skipif(not GLIBC, reason=NO_GLIBC)
@pytest.mark.parametrize(("asked", "fewest", "most"), [((), 3, 99), (("few",), 1, memory.HEAPS)])
def test_threads_share_few_heaps(tmp_path, asked, fewest, most):
    file = tmp_path / "malloc.xml"
    subprocess.run([sys.executable, "-c", HEAPS_OF_SIX_THREADS, file, *asked], check=True)
    assert fewest <= file.read_text().count("<heap nr=") <= most


LARGE_BLOCK_FREED = """
import sys
from pathlib import Path
import numpy as np
from fiberloom.operation.safety.memory import few_heaps
def resident():
    return 4096 * int(Path("/proc/self/statm").read_text().split()[1])
if "few" in sys.argv:
    few_heaps()
np.ones(16 * 2**20, dtype=np.uint8)  # freed at once: by default blocks up to this size lie in the heap now
block = np.ones(8 * 2**20, dtype=np.uint8)
heap = [line.split()[0] for line in Path("/proc/self/maps").read_text().splitlines() if "[heap]" in line]
within = any(int(a, 16) <= block.ctypes.data < int(b, 16) for a, b in (part.split("-") for part in heap))
before = resident()
del block
print(before - resident(), within)
"""


@pytest.mark.skipif(not GLIBC, reason=NO_GLIBC)
@pytest.mark.parametrize(("asked", "given_back"), [((), False), (("few",), True)])
def test_large_blocks_are_given_back_when_they_are_free(asked, given_back):
    command = [sys.executable, "-c", LARGE_BLOCK_FREED, *asked]
    for _ in range(5):
        freed, within = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
        if asked or within == "True":  # else the heap could not grow, for want of addresses behind it
            break
    assert within == str(not given_back)
    assert (int(freed) > 0.9 * 8 * 2**20) == given_back
