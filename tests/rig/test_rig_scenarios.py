"""The same scenarios on the host and on an emulated Cortex-M4F: each right, and all the same to the last bit.

Without the Arm compiler or QEMU the target's half is left out; `make firmware-report` says what to install.
"""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "rig"))

from lab import build, scenarios

said: dict[tuple[str, str], list[str]] = {}


def rig(target):
    try:
        return build.rig_command(target)
    except build.Missing as missing:
        pytest.skip(f"left out: {missing}")


def conversation(name, target):
    """What was said in a scenario, which is run once a session."""
    if (name, target) not in said:
        said[name, target] = scenarios.run(name, rig(target))
    return said[name, target]


@pytest.mark.parametrize("name", scenarios.SCENARIOS)
def test_on_the_host(name):
    assert conversation(name, "host")


@pytest.mark.parametrize("name", scenarios.SCENARIOS)
def test_on_the_cortex_m4f_every_bit_is_the_same(name):
    target = conversation(name, "cortex-m4f")
    host = conversation(name, "host")
    differ = [pair for pair in zip(host, target, strict=False) if pair[0] != pair[1]]
    assert not differ, f"{len(differ)} of {len(host)} lines, first host, then target: {differ[0]}"
    assert len(host) == len(target)
