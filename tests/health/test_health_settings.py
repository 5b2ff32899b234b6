"""Thresholds of the monitor have names and an origin, and each of them acts."""

import ast
import inspect
import re
from dataclasses import fields

import pytest

from fiberloom.health import monitor, settings
from fiberloom.health.settings import Clips, HealthSettings

TREE = ast.parse(inspect.getsource(monitor))
NO_THRESHOLDS = {0.0, 0.5, 1.0, 2.0, 100.0, 360.0}
"""Halves and doubles of variances, signs, per cent, a turn."""


def test_the_monitor_has_no_number_without_a_name():
    found = {n.value for n in ast.walk(TREE) if isinstance(n, ast.Constant) and isinstance(n.value, float)}
    assert found <= NO_THRESHOLDS


def test_every_threshold_is_read_by_the_monitor():
    read = {n.attr for n in ast.walk(TREE) if isinstance(n, ast.Attribute)}
    assert {f.name for f in (*fields(HealthSettings), *fields(Clips))} - read == set()


@pytest.mark.parametrize("name", [f.name for f in fields(HealthSettings) if f.name != "clips"])
def test_every_threshold_says_where_it_comes_from(name):
    after = inspect.getsource(settings).split(f"    {name}: ", 1)[1]
    assert re.match(r'[^"]*"""\[[AD]\] ', after)
