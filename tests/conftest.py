import os

# workers whose matrices use every core wait for one another: 44 s in place of 1 s
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
from pathlib import Path

import pytest
from hypothesis import settings

from fiberloom.instruments import generate, load_instrument
from fiberloom.operation.safety.memory import few_heaps

# threads of thousands of tests: a worker whose heaps are one for each grows to 6 GB
few_heaps()

# no deadlines: machines differ; in continuous integration always the same examples
settings.register_profile("here", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True)
# what tests calibrate is kept below the checkout, also by the processes that they start
os.environ.setdefault("FIBERLOOM_CACHE", str(Path(__file__).resolve().parents[1] / ".cache"))

settings.load_profile("ci" if os.environ.get("CI") else "here")


@pytest.fixture(scope="session")
def sdssv():
    return load_instrument("sdssv")


@pytest.fixture(scope="session")
def plane(sdssv):
    return generate(sdssv, seed=0)


@pytest.fixture(scope="session")
def patch(sdssv):
    return generate(sdssv, seed=0, n_positioners=37)


def beside_checkout(name):
    """A folder of data beside the checkout (or beside the folder of its worktrees)."""
    root = Path(__file__).resolve().parents[1]
    for parent in (root.parent, root.parent.parent):
        folder = parent / "shared" / "data" / name
        if folder.is_dir():
            return folder
    pytest.skip(f"no ../shared/data/{name} beside the checkout: its tables are not part of this project")


@pytest.fixture(scope="session")
def shared_sdssv():
    """The SDSS-V data."""
    return beside_checkout("sdssv")


@pytest.fixture(scope="session")
def shared_desi():
    """Calibrations and alignments of DESI."""
    return beside_checkout("desi")


@pytest.fixture(scope="session")
def shared_pfs():
    """Cobras, dots and fiducials of PFS."""
    return beside_checkout("pfs")


@pytest.fixture(scope="session")
def shared_megara():
    """Robots of MEGARA."""
    return beside_checkout("megara")


@pytest.fixture
def fl(monkeypatch, capsys):
    """Runs the command line in this process: exit code, stdout, stderr."""
    from fiberloom.cli import main

    monkeypatch.setenv("COLUMNS", "200")

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["fiberloom", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            main()
        out, err = capsys.readouterr()
        return ended.value.code or 0, out, err

    return run


@pytest.fixture
def written(monkeypatch):
    """Every figure that is written to a file, in order, to look at what was drawn."""
    from matplotlib.figure import Figure

    kept = []
    original = Figure.savefig

    def savefig(figure, *arguments, **how):
        kept.append(figure)
        return original(figure, *arguments, **how)

    monkeypatch.setattr(Figure, "savefig", savefig)
    return kept


def pytest_terminal_summary(terminalreporter):
    """What this machine could not run and why, once, in the last lines."""
    reasons = {
        str(r.longrepr[2]).removeprefix("Skipped: ") for r in terminalreporter.stats.get("skipped", [])
    }
    for reason in sorted(r for r in reasons if r.startswith("left out: ")):
        terminalreporter.write_line(reason)
