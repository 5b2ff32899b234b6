"""MuJoCo with its DC motor, the independent motor of the tests, or a skip that says what to install."""

from types import ModuleType

import pytest

MICRO = 1e6
"""Torques are given to MuJoCo in uN m, so that a rotor's 3.4e-9 kg m2 is not lost in its floors."""


def mujoco_with_dcmotor() -> ModuleType:
    """The module; skips where it is not installed or older than 4.0, which has the dcmotor actuator."""
    mujoco = pytest.importorskip(
        "mujoco", reason="pip install 'mujoco>=4.0': the independent check of the motor"
    )
    if not hasattr(mujoco.mjtGain, "mjGAIN_DCMOTOR"):
        pytest.skip(
            f"mujoco {mujoco.__version__} has no dcmotor actuator: pip install 'mujoco>=4.0'",
            allow_module_level=True,
        )
    return mujoco
