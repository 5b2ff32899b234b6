"""One fact, one place: what has a name is not written out a second time in the package."""

import re
from pathlib import Path

import pytest

import fiberloom

PACKAGE = Path(fiberloom.__file__).parent

FACTS = {
    "columns of arms": (r"arms\[[^\]]*, ?-?[0-9]", "instruments/focal_plane.py"),
    "length of the beta arm": (r"hypot\(\*?[\w.]*points\[", "instruments/focal_plane.py"),
    "names of the axes": (r"[(\[]['\"]alpha['\"], ['\"]beta['\"][)\]]", "instruments/model.py"),
}
"""Pattern of the fact written out, and the file that may."""


def written_out(pattern: str, home: str) -> list[str]:
    """Lines of other files that match."""
    return [
        f"{path.relative_to(PACKAGE)}:{number}: {line.strip()}"
        for path in sorted(PACKAGE.rglob("*.py"))
        if str(path.relative_to(PACKAGE)) != home
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if re.search(pattern, line) and "Literal[" not in line
    ]


@pytest.mark.parametrize("fact", FACTS)
def test_a_fact_is_written_once(fact):
    assert written_out(*FACTS[fact]) == []
