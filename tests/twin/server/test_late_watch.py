"""Why a tick was late: of each its own reason, however long the thread has not slept."""

import shutil
import subprocess
from pathlib import Path

import pytest

TWIN = Path(__file__).parents[3] / "core/twin"
LATE_TICKS = """
#include "fiberloom/twin/late_watch.hpp"
#include <cstdio>
#include <thread>
#include <vector>
using namespace fl::twin;
using namespace std::chrono;
int main() {
    LateWatch watch;
    std::vector<LateWatch::Found> found;
    watch.resumed(false);
    const auto due = LateWatch::Clock::now();
    for (int k = 0; k < 20; ++k) { // the first one waits for others, the rest compute for too long
        const auto end = watch.begins() + milliseconds(1);
        if (k == 0) std::this_thread::sleep_for(milliseconds(100));
        while (LateWatch::Clock::now() < end) {}
        found.push_back(watch.late(due + k * microseconds(500), LateWatch::Clock::now(), microseconds(500)));
    }
    for (const auto &one : found) std::puts(late_names[static_cast<std::size_t>(one.cause)]);
}
"""


@pytest.mark.skipif(not shutil.which("g++"), reason="apt-get install g++: a program is built")
def test_one_wait_is_not_told_of_the_ticks_after_it(tmp_path):
    (tmp_path / "late.cpp").write_text(LATE_TICKS)
    program = tmp_path / "late"
    sources = [tmp_path / "late.cpp", TWIN / "src/late_watch.cpp"]
    subprocess.run(["g++", "-std=c++20", f"-I{TWIN / 'include'}", *sources, "-o", program], check=True)
    first, *others = subprocess.run([program], capture_output=True, text=True, check=True).stdout.split()
    assert first == "blocked"
    assert len(others) == 19
    assert "blocked" not in others
