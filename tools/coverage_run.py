"""Measures line and branch coverage into build/coverage: `make coverage`.

    python -m tools.coverage_run [--jobs N] [--only python|native]

Python by coverage.py under the tests of `make test` that no clock decides; C and C++ by gcov in a build of
their own, under those tests that reach most of them. What fails is tried once more, alone.
Exit code 1 where a test fails: no data are written then.
"""

import argparse
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from pathlib import Path

from tools.coverage_data import FOLDER, NATIVE, PYTHON, file_hash, write_hashes
from tools.layout import COUNTED, NATIVE_TESTS, ROOT, SMALL, TOPS, Group, files_below, group_of

BUILD = FOLDER / "native"
SITE = FOLDER / "site"


def run(command: Sequence[str], root: Path, **extra: str) -> bool:
    """Runs a command in the checkout, with the tools of this Python first; True where it succeeds."""
    path = os.pathsep.join([sysconfig.get_path("scripts"), os.environ.get("PATH", "")])
    return subprocess.run(command, cwd=root, env={**os.environ, "PATH": path, **extra}).returncode == 0


def present(root: Path, folders: Sequence[str]) -> list[str]:
    """Those folders that the checkout has."""
    return [f for f in folders if (root / f).is_dir()]


def python_coverage(root: Path, jobs: int) -> bool:
    """Runs the tests; what is left out of the count is in pyproject.toml."""
    target = root / FOLDER / PYTHON
    target.parent.mkdir(parents=True, exist_ok=True)
    parallel = ["-n", str(jobs), "--dist", "loadfile"] if jobs > 1 else []
    code = [f"--cov={top}" for top in present(root, TOPS)]
    command = [sys.executable, "-m", "pytest", "-m", COUNTED, "--cov-branch", *code]
    command.append(f"--cov-report=json:{target}")
    # absolute: tests start programs in other folders
    path = os.pathsep.join([str(root / "src"), os.environ.get("PYTHONPATH", "")]).strip(os.pathsep)
    if run([*command, *parallel], root, PYTHONPATH=path):
        return True
    # a test that other work on the machine has disturbed would cost the whole measurement
    print("coverage: what has failed once more, alone", file=sys.stderr)
    if run([*command, "--cov-append", "--last-failed"], root, PYTHONPATH=path):
        return True
    # pytest-cov writes what it has even where tests fail
    target.unlink(missing_ok=True)
    return False


def native_coverage(root: Path) -> bool:
    """Builds the compiled module with counters, runs its tests, sums up what gcov counted."""
    build = ["-DFIBERLOOM_COVERAGE=ON", f"-DPython_EXECUTABLE={sys.executable}"]
    if not run(["cmake", "-S", ".", "-B", str(BUILD), "-G", "Ninja", *build], root):
        return False
    if not run(["cmake", "--build", str(BUILD)], root):
        return False
    for counters in (root / BUILD).rglob("*.gcda"):
        counters.unlink()
    site = package_with(root, root / BUILD, root / SITE)
    tests = present(root, NATIVE_TESTS)
    # the very script that runs the sanitized build: it takes an editable installation out of the way
    if not run(
        [sys.executable, "tests/sanitized.py", str(site), "-m", SMALL, *tests], root, PYTHONPATH=str(site)
    ):
        return False
    filters = [f"--filter={top}/" for top in present(root, TOPS) if "/" not in top]
    # a line of a template counts once, however many types it is compiled for
    options = ["--exclude-throw-branches", "--merge-lines", *filters]
    command = [sys.executable, "-m", "gcovr", "--root", ".", *options]
    return run([*command, "--json-summary", str(FOLDER / NATIVE), str(BUILD)], root)


def package_with(root: Path, build: Path, site: Path) -> Path:
    """A copy of the Python package with the compiled module of a build; the folder to import it from."""
    shutil.rmtree(site, ignore_errors=True)
    ignored = shutil.ignore_patterns("*.so", "__pycache__")
    shutil.copytree(root / "src" / "fiberloom", site / "fiberloom", ignore=ignored)
    (module,) = build.rglob("_core*.so")
    shutil.copy(module, site / "fiberloom")
    return site


def sources(root: Path, python: bool) -> list[Path]:
    """The files of code that a measurement of Python, or of C and C++, is about."""
    groups: dict[Path, Group | None] = {path: group_of(path) for path in files_below(root)}
    return [p for p, g in groups.items() if g is not None and (g.language == "Python") == python]


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0, or 1 where a build or a test fails."""
    parser = argparse.ArgumentParser(prog="python -m tools.coverage_run", description="measure coverage")
    parser.add_argument("--jobs", type=int, default=1, help="test processes of the host's tests")
    parser.add_argument("--only", choices=["python", "native"])
    given = parser.parse_args(arguments)
    for name in (given.only,) if given.only else ("python", "native"):
        # as they are now: an edit while the tests run makes the data stale
        hashes = {p.as_posix(): file_hash(ROOT / p) for p in sources(ROOT, name == "python")}
        if not (python_coverage(ROOT, given.jobs) if name == "python" else native_coverage(ROOT)):
            print(f"coverage: {name} not measured; above: why", file=sys.stderr)
            return 1
        write_hashes(ROOT, hashes)
    return 0


if __name__ == "__main__":
    sys.exit(main())
