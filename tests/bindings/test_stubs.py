"""The type stubs of the compiled module are those that the module gives."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
STUBS = ROOT / "src" / "fiberloom" / "_core"
PATTERNS = ROOT / "core" / "bindings" / "stubs.txt"


def test_the_stubs_are_those_of_the_compiled_module(tmp_path):
    missing = "nanobind is not installed: `pip install nanobind` for the stubs"
    pytest.importorskip("nanobind.stubgen", reason=missing)
    command = [sys.executable, "-m", "nanobind.stubgen", "--quiet", "--recursive"]
    command += ["--module", "fiberloom._core", "--pattern-file", str(PATTERNS), "--output-dir", str(tmp_path)]
    subprocess.run(command, check=True, timeout=120)
    made = {path.name: path.read_text() for path in (tmp_path / "_core").iterdir()}
    kept = {path.name: path.read_text() for path in STUBS.iterdir()}
    assert made.keys() == kept.keys()
    for name in made:
        assert made[name] == kept[name], f"{name} is not up to date: run `make stubs`"
