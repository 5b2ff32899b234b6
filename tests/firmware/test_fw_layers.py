"""The firmware is a leaf with floors: can above positioner above law and port, and nothing back."""

import itertools
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FIRMWARE = ROOT / "firmware"
MAY_INCLUDE = {
    "port": {"port"},
    "law": {"law", "port"},
    "positioner": {"positioner", "law", "port"},
    "can": {"can", "positioner", "law", "port"},
    "boards": {"boards", "can", "positioner", "law", "port"},
}
HEADERS = {file.name: file.relative_to(FIRMWARE).parts[0] for file in FIRMWARE.rglob("*.h")}
SYSTEM = {"stdbool.h", "stddef.h", "stdint.h"}


def includes(file):
    return re.findall(r'^#include ["<]([^">]+)[">]', file.read_text(), re.MULTILINE)


@pytest.mark.parametrize("floor", MAY_INCLUDE)
def test_a_floor_includes_only_itself_and_what_is_below(floor):
    files = list((FIRMWARE / floor).rglob("*.[ch]"))
    assert files
    for file in files:
        for name in includes(file):
            assert name in SYSTEM or HEADERS[name] in MAY_INCLUDE[floor], f"{file} includes {name}"


def test_a_source_defines_what_the_headers_of_its_own_folder_declare():
    """A function declared below and defined above would be a circle that includes do not show."""
    defined = re.compile(r"^(?:FL_COLD )?[a-z]\w*(?: \**|\* )(fl_\w+)\([^;]*?\) \{", re.MULTILINE)
    for floor in ("positioner", "can"):
        declared = "".join(f.read_text() for f in (FIRMWARE / floor).rglob("*.h"))
        for file in (FIRMWARE / floor).rglob("*.c"):
            for name in defined.findall(file.read_text()):
                assert re.search(rf"\b{name}\(", declared), f"{file} defines {name}"


def test_no_python_and_nothing_of_the_core_in_the_firmware():
    sources = [f for f in FIRMWARE.rglob("*") if f.is_file() and "__pycache__" not in f.parts]
    assert not [f for f in sources if f.suffix in {".py", ".cpp", ".hpp"}]
    assert not [f for f in sources if "fiberloom/" in f.read_text()]


def test_no_folder_is_too_full():
    for folder in [FIRMWARE, ROOT / "rig", *FIRMWARE.rglob("*/"), ROOT / "rig" / "lab"]:
        if folder.is_dir() and folder.name != "__pycache__":
            assert sum(f.is_file() for f in folder.iterdir()) <= 15, folder


def test_every_function_of_a_header_is_documented():
    function = re.compile(r"^(?:static inline |const )*\w+ \**(fl_\w+)\(|^FL_HANDLER\((fl_\w+)\);")
    found = 0
    for file in FIRMWARE.rglob("*.h"):
        if file.relative_to(FIRMWARE).parts[0] == "tests":
            continue
        lines = file.read_text().splitlines()
        for before, line in itertools.pairwise(lines):
            if match := function.match(line):
                found += 1
                assert before.endswith("*/"), f"{file.name}: {match[1] or match[2]}"
    assert found > 150
