"""A plugin of pytest for the mutation run: notes how long tests take; the quickest first, chosen ones only.

FL_TIMES names a JSON file of seconds by node id, written where it does not exist. FL_CHOSEN names a file of
node ids, one a line: other tests are left out.
"""

import json
import os
from pathlib import Path

import pytest
from hypothesis import Phase, settings

_took_s: dict[str, float] = {}


def pytest_configure() -> None:
    """One example that fails is enough: hypothesis does not look for the smallest."""
    phases = (Phase.explicit, Phase.generate)
    settings.register_profile(
        "mutants", settings.get_profile(settings.get_current_profile_name()), phases=phases
    )
    settings.load_profile("mutants")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leaves out and sorts. Sorting keeps the order of tests that take the same."""
    chosen = os.environ.get("FL_CHOSEN")
    if chosen is not None:
        wanted = set(Path(chosen).read_text(encoding="utf-8").splitlines())
        config.hook.pytest_deselected(items=[i for i in items if i.nodeid not in wanted])
        items[:] = [i for i in items if i.nodeid in wanted]
    times = _times()
    if times is not None and times.exists():
        took_s = json.loads(times.read_text(encoding="utf-8"))
        items.sort(key=lambda i: took_s.get(i.nodeid, 0.0))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Adds up set-up, call and tear-down."""
    _took_s[report.nodeid] = _took_s.get(report.nodeid, 0.0) + report.duration


def pytest_sessionfinish() -> None:
    """Writes the times of the run without any change."""
    times = _times()
    if times is not None and not times.exists():
        times.write_text(json.dumps(_took_s, indent=1), encoding="utf-8")


def _times() -> Path | None:
    name = os.environ.get("FL_TIMES")
    return None if name is None else Path(name)
