"""Tries mutants against tests, in copies of the code."""

import enum
import importlib
import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import coverage

from tools.coverage_run import package_with, present, run
from tools.layout import LANGUAGES, ROOT, SMALL, Target, files_below, group_of
from tools.mutation.native import PRELUDE, Change, native_mutants, schema
from tools.mutation.python import Mutant

FOLDER = Path("build/mutate")
PATIENCE, AT_LEAST_S = 4.0, 30.0
"""A mutant may take so many times what all tests took without it, and this long in any case."""
ROOM_BYTES = 6 * 2**30
"""Address space of the tests: a mutant that asks for more fails with a memory error, and is killed by it."""


class Verdict(enum.Enum):
    """What the tests made of a mutant."""

    KILLED = "killed"
    SURVIVED = "survived"
    TIMEOUT = "timeout"


class TestsFail(Exception):
    """The tests fail, or cannot be run, without any mutant."""

    __test__ = False


class Runs(Protocol):
    """A target made ready, and its mutants tried one by one."""

    target: Target
    mutants: list[Mutant]

    def prepare(self) -> None:
        """Copies, builds, runs the tests once without any change; TestsFail where that fails."""

    def try_one(self, mutant: Mutant) -> Verdict:
        """Runs tests on one mutant."""

    def close(self) -> None:
        """Ends what `prepare` has started."""


class Pytest:
    """Runs the tests of a target on a package elsewhere."""

    def __init__(self, root: Path, folder: Path, tests: Sequence[str]) -> None:
        self.root, self.folder, self.tests = root, folder, list(tests)
        self.site = folder / "site"
        self.limit_s = 3600.0

    def run(self, options: Sequence[str] = (), **extra: str) -> Verdict:
        """The quickest first, up to the first failure. TestsFail where pytest itself cannot run."""
        process = self.start(options, (), **extra)
        try:
            return self.verdict(process.wait(self.limit_s))
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            return Verdict.TIMEOUT

    def start(self, options: Sequence[str], fds: Sequence[int], **extra: str) -> subprocess.Popen[bytes]:
        """Starts pytest; `fds` stay open in it."""
        # the script of the sanitized build: it takes an editable installation out of the way
        command = [sys.executable, "tests/sanitized.py", str(self.site), "-p", "tools.quickest_first", "-x"]
        # no bytecode: two mutants within a second may have files of the same size
        own = {"PYTHONPATH": f"{self.site}{os.pathsep}{ROOT}", "PYTHONDONTWRITEBYTECODE": "1", "CI": "1"}
        environment = {**os.environ, **own, "FL_TIMES": str(self._times), **extra}
        with self._log.open("w") as out:
            return subprocess.Popen(
                [*command, "-m", SMALL, *options, *self.tests],
                cwd=self.root, env=environment, stdout=out, stderr=out, start_new_session=True, pass_fds=fds,
                preexec_fn=as_by_hand,
            )  # fmt: skip

    def verdict(self, code: int) -> Verdict:
        """What an exit code of pytest means."""
        # 3, 4, 5: internal error, wrong usage, no tests; negative: a signal, as after a bad index in C
        if code in (3, 4, 5):
            raise TestsFail(f"pytest ended with {code}: {self._log}")
        return Verdict.KILLED if code else Verdict.SURVIVED

    @property
    def _times(self) -> Path:
        return self.folder / "times.json"

    @property
    def _log(self) -> Path:
        return self.folder / "pytest.log"

    def only(self, tests: Sequence[str]) -> Verdict:
        """Those of the tests that are named by their node ids."""
        chosen = self.folder / "chosen.txt"
        chosen.write_text("\n".join(tests), encoding="utf-8")
        return self.run(FL_CHOSEN=str(chosen))

    def all_but(self, tests: Sequence[str]) -> list[str]:
        """Node ids of the tests that ran without any change, less those named."""
        return sorted(set(json.loads(self._times.read_text(encoding="utf-8"))) - set(tests))

    def baseline(self, options: Sequence[str] = (), **extra: str) -> None:
        """Must pass; notes how long each test takes, and sets how long a mutant may take."""
        self._times.unlink(missing_ok=True)
        start_s = time.monotonic()
        if self.run(options, **extra) is not Verdict.SURVIVED:
            raise TestsFail(f"the tests fail without any change: {self._log}")
        self.limit_s = max(AT_LEAST_S, PATIENCE * (time.monotonic() - start_s))


def as_by_hand() -> None:
    """Of the process of the tests: little memory, and signals as a shell leaves them.

    What runs in the background ignores SIGINT or SIGHUP (`&` in a script, `nohup`), and so does all that it
    starts: a test of an interrupted command would wait in vain.
    """
    limit_memory()
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def limit_memory() -> None:
    """Leaves this process and its children ROOM_BYTES of address space, or less where there is less."""
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    room = ROOM_BYTES if hard == resource.RLIM_INFINITY else min(ROOM_BYTES, hard)
    resource.setrlimit(resource.RLIMIT_AS, (room, hard))


class Forks:
    """The tests of a target collected once; a fork runs them for each mutant of C."""

    def __init__(self, tests: Pytest) -> None:
        self.tests = tests
        (asked, ask), (answer, told) = os.pipe(), os.pipe()
        self._process = tests.start(["-p", "tools.forked_tests"], (asked, told), FL_FORKS=f"{asked},{told}")
        os.close(asked)
        os.close(told)
        self._ask, self._answer = os.fdopen(ask, "w", buffering=1), os.fdopen(answer)

    def close(self) -> None:
        """Ends the process that forks."""
        self._ask.close()
        self._answer.close()
        self._process.wait()

    def run(self, number: int) -> Verdict:
        """The quickest first, up to the first failure. TestsFail where pytest itself cannot run."""
        print(number, self.tests.limit_s, file=self._ask)
        told = self._answer.readline().strip()
        if told == "timeout":
            return Verdict.TIMEOUT
        return self.tests.verdict(int(told or 3))


class PythonRuns:
    """Mutants of a package of the host, in a copy of the whole package."""

    def __init__(self, root: Path, target: Target, mutants: list[Mutant]) -> None:
        self.root, self.target, self.mutants = root, target, mutants
        self.pytest = Pytest(root, root / FOLDER / target.name, present(root, target.tests))
        self._reached: dict[Path, dict[int, list[str]]] = {}

    def prepare(self) -> None:
        """Copies the package; learns which test reaches which line, and how long each takes."""
        site = package_with(self.root, compiled_folder(), self.pytest.site)
        data = self.pytest.folder / "coverage"
        data.unlink(missing_ok=True)
        code = [f"--cov={site / Path(c).relative_to('src')}" for c in self.target.code]
        self.pytest.baseline([*code, "--cov-context=test", "--cov-report="], COVERAGE_FILE=str(data))
        self._reached = reached(data, site, self.root / "src")

    def try_one(self, mutant: Mutant) -> Verdict:
        """The tests that reach the line; then, if need be, the others."""
        path = self.pytest.site / mutant.path.relative_to("src")
        original = path.read_bytes()
        path.write_bytes(mutant.text)
        try:
            nearest = self._reached.get(self.root / mutant.path, {}).get(mutant.line, [])
            if nearest and (verdict := self.pytest.only(nearest)) is not Verdict.SURVIVED:
                return verdict
            others = self.pytest.all_but(nearest)
            return self.pytest.only(others) if others else Verdict.SURVIVED
        finally:
            path.write_bytes(original)

    def close(self) -> None:
        """Nothing was left running."""


def compiled_folder() -> Path:
    """Where this Python's fiberloom has its compiled module."""
    return Path(str(importlib.import_module("fiberloom._core").__file__)).parent


def reached(data: Path, copy: Path, original: Path) -> dict[Path, dict[int, list[str]]]:
    """Node ids of the tests that ran each line, by the file of the checkout."""
    read = coverage.CoverageData(str(data))
    read.read()
    found = {}
    for name in read.measured_files():
        lines = read.contexts_by_lineno(name).items()
        ids = {line: sorted({c.partition("|")[0] for c in contexts if c}) for line, contexts in lines}
        found[original / Path(name).relative_to(copy)] = ids
    return found


class NativeRuns:
    """Mutants of C, all of them in one build."""

    def __init__(self, root: Path, target: Target, files: Sequence[Path]) -> None:
        self.root, self.target = root, target
        self.folder = root / FOLDER / target.name
        self.pytest = Pytest(root, self.folder, present(root, target.tests))
        self._prelude = self.folder / "fl_mutant.h"
        groups = {p: group_of(p) for p in files_below(root)}
        sources = [p for p, g in groups.items() if g is not None and LANGUAGES[p.suffix] != "Python"]
        self._changes: list[tuple[Mutant, Change]] = [
            c for f in files for c in native_mutants(root, f, sources)
        ]
        self.mutants = [m for m, _ in self._changes]
        # 0 is no mutant
        self._number = {m.key: i for i, m in enumerate(self.mutants, 1)}

    def prepare(self) -> None:
        """Copies the sources, builds them with every mutant inside, runs the tests with none chosen."""
        tree, build = self.folder / "tree", self.folder / "build"
        write_if_new(self._prelude, PRELUDE.encode())
        self._copy(tree)
        options = [f"-DPython_EXECUTABLE={sys.executable}", "-DCMAKE_BUILD_TYPE=Release"]
        options.append("-DFIBERLOOM_WERROR=OFF")
        for command in (["cmake", "-S", str(tree), "-B", str(build), "-G", "Ninja", *options],
                        ["cmake", "--build", str(build)]):  # fmt: skip
            if not run(command, self.root):
                raise TestsFail("the sources with the mutants inside do not build; above: why")
        package_with(self.root, build, self.pytest.site)
        self.pytest.baseline()
        self._forks = Forks(self.pytest)

    def _copy(self, tree: Path) -> None:
        """The sources, those that are mutated with every mutant inside. What is the same keeps its time."""
        changed = {m.path for m in self.mutants}
        tops = {p.parent.name for p in self.root.glob("*/CMakeLists.txt")}
        own = {p for p in files_below(self.root) if p.parts[0] in tops or p == Path("CMakeLists.txt")}
        for gone in set(files_below(tree)) - own:
            (tree / gone).unlink()
        for path in own:
            content = (self.root / path).read_bytes()
            if path in changed:
                own_changes = [(self._number[m.key], c) for m, c in self._changes if m.path == path]
                # here and not by a flag: what does not use the file is not built again
                content = f'#include "{self._prelude}"\n'.encode() + schema(content, own_changes)
            write_if_new(tree / path, content)

    def try_one(self, mutant: Mutant) -> Verdict:
        """All tests of the target."""
        return self._forks.run(self._number[mutant.key])

    def close(self) -> None:
        """Ends the process in which the tests are collected."""
        self._forks.close()


def write_if_new(path: Path, content: bytes) -> None:
    """Writes a file unless it has that content: what is the same is not built again."""
    if not path.exists() or path.read_bytes() != content:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
