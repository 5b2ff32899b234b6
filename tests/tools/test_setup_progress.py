"""`tools/setup/progress.py`: steps are counted, all is logged, a failure is shown."""

import subprocess
import sys
from pathlib import Path

TOOL = Path(__file__).resolve().parents[2] / "tools" / "setup" / "progress.py"


def run(log, script, *of):
    words = [sys.executable, str(TOOL), "build", str(log), *of, "--", "sh", "-c", script]
    return subprocess.run(words, capture_output=True, text=True, check=False)


def test_success_is_two_lines_and_a_log(tmp_path):
    done = run(tmp_path / "deep" / "log", "echo '[1/2] a'; echo noise; echo '[2/2] b'")
    assert done.returncode == 0
    first, last = done.stderr.splitlines()
    assert (first, last.startswith("build: done")) == ("build", True)
    assert (tmp_path / "deep" / "log").read_text() == "[1/2] a\nnoise\n[2/2] b\n"


def test_failure_shows_the_end_of_the_log_and_its_code(tmp_path):
    done = run(tmp_path / "log", "for i in $(seq 100); do echo line $i; done; exit 7")
    assert done.returncode == 7
    assert "build: FAILED" in done.stderr
    assert "line 100" in done.stderr
    assert "line 60\n" not in done.stderr


def test_steps_of_ninja_and_of_pip(monkeypatch):
    monkeypatch.syspath_prepend(str(TOOL.parent))
    import progress

    steps = progress.Steps(2)
    assert steps.take("Collecting numpy==2\n")
    assert not steps.take("  Downloading numpy\n")
    assert (steps.done, steps.total) == (1, 2)
    assert steps.take("  [37/72] Building CXX object\n")
    assert (steps.done, steps.total) == (37, 72)
    assert not progress.Steps(0).take("Collecting numpy\n")


def test_wrong_words(tmp_path):
    words = [sys.executable, str(TOOL), "title"]
    assert subprocess.run(words, capture_output=True, check=False).returncode == 2
