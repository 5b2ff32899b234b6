"""The storage of a board reads like plain memory, whatever of it takes room."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
AGAINST_PLAIN_MEMORY = """
#include "flash.hpp"
#include <cstdio>
#include <cstring>
#include <random>
using namespace fl::twin;
int main() {
    std::mt19937 random(1);
    const auto below = [&](size_t n) { return random() % n; };
    FactoryParams::Both first{}, own{};
    for (fl_axis_params_t *axis : {&first[0], &first[1]}) axis->u_dc = 12.0f;
    own = first;
    own[1].k_p = -0.0f; // differs in its bits alone
    own[0].hall_phase = __builtin_nanf("");
    FactoryParams factory;
    factory.set(first, own);
    const FactoryParams::Bytes image = factory.bytes();
    if (std::memcmp(image.data(), own.data(), image.size()) != 0) return 1;

    Flash flash;
    std::array<uint8_t, storage_bytes> plain, seen;
    plain.fill(0xff);
    const auto write = [&](size_t at, const uint8_t *bytes, size_t len) {
        flash.write(at, bytes, len);
        std::copy_n(bytes, len, &plain[at]);
    };
    write(8, image.data(), image.size());
    const size_t alone = flash.held_bytes();
    flash.share(factory);
    const size_t shared = flash.held_bytes();
    write(8, image.data(), image.size()); // changes nothing
    if (flash.held_bytes() != shared) return 2;
    for (int round = 0; round < 2000; ++round) {
        std::array<uint8_t, 100> bytes;
        for (uint8_t &b : bytes) b = static_cast<uint8_t>(below(3) == 0 ? 0xff : random());
        const size_t len = below(bytes.size() + 1), at = below(storage_bytes - len + 1);
        write(at, bytes.data(), len);
        flash.read(0, seen.data(), seen.size());
        if (seen != plain) return 3;
        const size_t some = below(storage_bytes - 64);
        flash.read(some, seen.data(), 64);
        if (!std::equal(&seen[0], &seen[64], &plain[some])) return 4;
    }
    std::printf("%zu %zu %zu\\n", alone, shared, flash.held_bytes());
}
"""


@pytest.mark.skipif(not shutil.which("g++"), reason="apt-get install g++: a program is built")
def test_flash_reads_like_plain_memory_and_holds_what_differs(tmp_path):
    (tmp_path / "flash.cpp").write_text(AGAINST_PLAIN_MEMORY)
    firmware = [folder for folder in (ROOT / "firmware").rglob("*") if folder.is_dir()]
    folders = [
        ROOT / "core/twin/src",
        ROOT / "core/twin/include",
        ROOT / "core/geometry/include",
        *firmware,
    ]
    command = ["g++", "-std=c++20", *(f"-I{folder}" for folder in folders)]
    subprocess.run([*command, tmp_path / "flash.cpp", "-o", tmp_path / "flash"], check=True)
    said = subprocess.run([tmp_path / "flash"], capture_output=True, text=True, check=True).stdout
    alone, shared, full = map(int, said.split())
    assert alone >= 464  # two axes of 58 parameters
    assert shared <= 32  # the ends of what is not whole cells
    assert full <= 17 * 256
