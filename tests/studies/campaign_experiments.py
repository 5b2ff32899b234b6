"""Experiments that processes elsewhere can import."""

import os
import signal
import time
from pathlib import Path

import numpy as np


def draw(units, seed, settings):
    """Numbers that depend on the unit and the seed alone."""
    rows = [np.random.default_rng([seed, unit]).normal(size=3) for unit in units]
    return {"unit": np.array(units), "draw": np.array(rows)}


def killed_at(units, seed, settings):
    """The process is killed where the unit is reached, the first time."""
    mark = Path(settings["mark"])
    if settings["unit"] in units and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    with Path(settings["log"]).open("a") as log:
        log.write(f"{units.start}\n")
    return draw(units, seed, settings)


def deadly(units, seed, settings):
    """The process is killed at these units, each time."""
    if set(settings["units"]) & set(units):
        os.kill(os.getpid(), signal.SIGKILL)
    return draw(units, seed, settings)


def slow(units, seed, settings):
    """Takes a while, so that something can happen meanwhile."""
    time.sleep(0.3)
    return draw(units, seed, settings)


def lopsided(units, seed, settings):
    """A column that fits no unit."""
    return {"unit": np.zeros(len(units) + 1)}
