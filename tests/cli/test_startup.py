"""What help and refusals load: no clock is asked, only which modules are there afterwards."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SLOW = ("astropy", "scipy", "matplotlib", "sqlalchemy", "dask", "distributed", "can", "fiberloom._core")
MODEL = "fiberloom.instruments.model"
"""Where pydantic checks an instrument; typer may use pydantic too."""

LOADED = """
import sys
from pathlib import Path
try:
    from fiberloom.cli import main
    main()
except SystemExit as ended:
    print("code", ended.code or 0)
print("loaded", *sorted(sys.modules))
"""


def loaded(*words, cwd):
    done = subprocess.run(
        [sys.executable, "-c", LOADED, *words], cwd=cwd, capture_output=True, text=True, check=True
    )
    *_, code, modules = done.stdout.splitlines()
    return int(code.split()[1]), set(modules.split()[1:]), done.stderr


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "good.csv").write_text("target_id,x_mm,y_mm\na,1,2\n")
    (tmp_path / "bad.csv").write_text("target_id,x,y_mm\na,1,2\n")
    (tmp_path / "taken").write_text("a file, not a folder")
    return tmp_path


@pytest.mark.parametrize(
    "words",
    [
        "--help",
        "--version",
        "observe --help",
        "calibrate --help",
        "calibrate friction --help",
        "lifetime --help",
    ],
)
def test_help_loads_nothing_heavy(words, folder):
    code, modules, _ = loaded(*words.split(), cwd=folder)
    assert code == 0
    assert sorted(modules & {*SLOW, "numpy", "rich.console", MODEL}) == []
    if words.startswith("--"):
        assert "fiberloom.instruments" not in modules


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("observe nowhere.csv", "nowhere.csv"),
        ("observe bad.csv", "no column x_mm"),
        ("observe good.csv --instrument sloan", "sloan"),
        ("observe good.csv --faults frob=1", "--faults frob=1"),
        ("observe good.csv --faults late=0.1:1", "cannot act on late"),
        ("observe good.csv --out taken/x", "--out taken/x"),
        ("observe good.csv --camera film", "film"),
        ("observe good.csv --arms no.ecsv", "no.ecsv: no such file"),
        ("observe good.csv --positioners 7 --layout .", "--positioners goes with a preset"),
        ("observe good.csv --layout nowhere", "nowhere: no such directory"),
        ("assign bad.csv", "no column x_mm"),
        ("plan --start a.csv --goal good.csv", "a.csv: no such file"),
        ("plan --start good.csv --goal good.csv --animate x.avi", "--animate x.avi: a film is"),
        ("plan --start good.csv --goal good.csv --buffer 0", "--buffer 0: must be a finite number"),
        ("verify t.json", "t.json"),
        ("twin --faults dark=1", "cannot act on dark"),
        ("twin --listen 19228", "HOST:PORT"),
        ("lifetime --faults dead=1", "cannot act on dead"),
        ("lifetime --faults dark=#3 --positioners 2", "no such positioner"),
        ("lifetime --out taken/x", "--out taken/x"),
        ("reproduce 99", "figure 99"),
        ("instruments sloan", "sloan"),
        ("runs no.sqlite", "no.sqlite"),
        ("health no.sqlite", "no.sqlite"),
        ("centroid no.fits", "no.fits: no such file"),
        ("match no.csv", "no.csv: no such file"),
        ("acceptance --out taken/x", "--out taken/x"),
        ("calibrate arms --faults busoff=1", "cannot act on busoff"),
        ("calibrate transmission --instrument sloan", "sloan"),
        ("calibrate focal-plane --measured no.sqlite", "no.sqlite: no such file"),
        ("calibrate history no.sqlite", "no.sqlite"),
        ("calibrate undo no.sqlite --to 0", "no.sqlite"),
        ("frobnicate", "frobnicate"),
        ("calibrate", ""),
    ],
)
def test_a_refusal_loads_nothing_heavy(words, said, folder):
    code, modules, stderr = loaded(*words.split(), cwd=folder)
    assert said in stderr
    assert (code, len(stderr.splitlines())) == (2, 1) if said else code in (0, 2)
    assert sorted(modules & {*SLOW, MODEL}) == []


def test_the_package_alone_loads_nothing():
    code = "import sys, fiberloom; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert sorted(set(done.stdout.split()) & {*SLOW, "numpy", "pydantic", "typer"}) == []


def test_the_store_loads_no_mapper_of_objects():
    code = "import sys, fiberloom.store.database; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    modules = done.stdout.split()
    assert "sqlalchemy" in modules
    assert "sqlalchemy.orm" not in modules


THREADS = """
import os, sys
from fiberloom.cli import main
sys.argv = ["fiberloom", "instruments", "sdssv"]
try:
    main()
except SystemExit:
    import numpy
    print("threads", len(os.listdir("/proc/self/task")))
"""


@pytest.mark.skipif(
    not Path("/proc/self/task").exists(), reason="no /proc here, where threads are counted: Linux has it"
)
@pytest.mark.parametrize(("given", "alone"), [({}, True), ({"OPENBLAS_NUM_THREADS": "2"}, False)])
def test_linear_algebra_has_one_thread_so_that_cores_do_not_change_results(given, alone):
    env = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"} | given
    done = subprocess.run(
        [sys.executable, "-c", THREADS], env=env, capture_output=True, text=True, check=True, timeout=60
    )
    assert ("threads 1" in done.stdout.splitlines()) == alone


FROZEN = """
import atexit, gc, sys
atexit.register(lambda: print("left", len(gc.get_objects())))  # called last
from fiberloom.cli import main
sys.argv = ["fiberloom", "--version"]
main()
"""


def test_at_the_end_cycles_are_not_looked_for_among_all_that_was_imported():
    done = subprocess.run([sys.executable, "-c", FROZEN], capture_output=True, text=True, check=True)
    _, left = done.stdout.splitlines()
    assert int(left.split()[1]) < 100


def test_a_command_loads_no_other_one(folder):
    _, modules, _ = loaded("observe", "--help", cwd=folder)
    assert "fiberloom.cli.observe" in modules
    assert not modules & {
        "fiberloom.cli.lifetime",
        "fiberloom.cli.sky.survey",
        "fiberloom.cli.calibrate.bench",
    }


def test_an_observation_loads_no_astropy(folder):
    _, modules, _ = loaded("observe", "good.csv", "--positioners=7", "--moves=1", "--out=seen", cwd=folder)
    assert (folder / "seen/fibres.ecsv").exists()
    assert "astropy" not in modules
