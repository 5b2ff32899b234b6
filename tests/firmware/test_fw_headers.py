"""The headers of the firmware: what they declare is defined in their own folder and documented."""

import itertools
import re
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
DEFINITION = re.compile(r"^(?:FL_COLD )?[a-z]\w*(?: \**|\* )(fl_\w+)\([^;]*?\) \{", re.MULTILINE)
DECLARATION = re.compile(r"^(?:static inline |const )*\w+ \**(fl_\w+)\(|^FL_HANDLER\((fl_\w+)\);")


@pytest.mark.parametrize("floor", ["positioner", "can"])
def test_a_source_defines_what_the_headers_of_its_own_folder_declare(floor):
    """A function declared below and defined above would be a circle that includes do not show."""
    declared = "".join(f.read_text() for f in (FIRMWARE / floor).rglob("*.h"))
    defined = [name for f in (FIRMWARE / floor).rglob("*.c") for name in DEFINITION.findall(f.read_text())]
    assert defined
    assert [name for name in defined if not re.search(rf"\b{name}\(", declared)] == []


def test_every_function_of_a_header_is_documented():
    found = 0
    for file in FIRMWARE.rglob("*.h"):
        if file.relative_to(FIRMWARE).parts[0] == "tests":
            continue
        for before, line in itertools.pairwise(file.read_text().splitlines()):
            if match := DECLARATION.match(line):
                found += 1
                assert before.endswith("*/"), f"{file.name}: {match[1] or match[2]}"
    assert found > 150
