"""A mutant that a test kills is counted killed, one that no test sees survives."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tools import mutate
from tools.forked_tests import ended
from tools.layout import ROOT, Target
from tools.mutation.native import PRELUDE, native_mutants, schema
from tools.mutation.python import KINDS, Mutant, mutants_of
from tools.mutation.runs import PythonRuns, TestsFail, Verdict

LAW = '''\
"""Not mutated: 1 < 2."""

LIMIT = 3.0


def clip(x: float, low=-LIMIT) -> float:
    if x > LIMIT and x < 100.0:
        raise ValueError("above " + str(LIMIT))
    return x - low


def turns(x):
    while x > 10:
        x -= 10
    return x
'''
TESTS = """\
from fiberloom.room.law import clip, turns

def test_clip():
    assert clip(1.0) == 4.0

def test_turns():
    assert turns(25) == 5
"""


def write(root, path, text):
    target = root / path
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(text)


@pytest.fixture
def runs(tmp_path):
    write(tmp_path, "src/fiberloom/__init__.py", "")
    write(tmp_path, "src/fiberloom/room/__init__.py", "")
    write(tmp_path, "src/fiberloom/room/law.py", LAW)
    write(tmp_path, "tests/room/test_law.py", TESTS)
    shutil.copy(ROOT / "tests" / "sanitized.py", tmp_path / "tests")
    target = Target("room", ("src/fiberloom/room",), ("tests/room",))
    files = mutate.code_of(tmp_path, target)
    return PythonRuns(tmp_path, target, [m for f in files for m in mutants_of(tmp_path, f)])


def changes(mutants):
    return {(m.before, m.after) for m in mutants}


def test_every_kind_of_change_is_made(tmp_path):
    write(tmp_path, "law.py", LAW)
    found = mutants_of(tmp_path, Path("law.py"))
    head, test, back = (
        "def clip(x: float, low=-LIMIT) -> float:",
        "if x > LIMIT and x < 100.0:",
        "return x - low",
    )
    assert changes(found) == {
        ("LIMIT = 3.0", "LIMIT = 4.0"),
        (head, head.replace("-LIMIT", "LIMIT")),
        (test, test.replace("x >", "x <=")),
        (test, test.replace("x <", "x >=")),
        (test, test.replace("and", "or")),
        (test, test.replace("100.0", "200.0")),
        (back, "return x + low"),
        ("while x > 10:", "while x <= 10:"),
        ("while x > 10:", "while x >= 10:"),
        ("while x > 10:", "while x > 11:"),
        ("x -= 10", "x += 10"),
        ("x -= 10", "x -= 11"),
    }
    assert {m.line for m in found if m.before == back} == {9}


def test_what_a_test_sees_is_killed_and_the_rest_survives(runs):
    wanted = {
        "return x + low": Verdict.KILLED,
        "LIMIT = 4.0": Verdict.KILLED,
        "while x >= 10:": Verdict.SURVIVED,
        "if x > LIMIT and x < 200.0:": Verdict.SURVIVED,
    }
    chosen = [m for m in runs.mutants if m.after in wanted]
    results = mutate.mutate(runs, chosen, lambda result: None)
    assert {r.mutant.after: r.verdict for r in results} == wanted
    assert (runs.pytest.site / "fiberloom/room/law.py").read_text() == LAW
    text, well = mutate.judge(results, {}, None)
    assert not well
    assert "survived, not explained: 2" in text
    assert "law.py:13" in text
    reasons = {r.mutant.key: "ten turns are none" for r in results if r.verdict is Verdict.SURVIVED}
    assert mutate.judge(results, reasons, {m.key for m in runs.mutants})[1]
    assert mutate.summary(results).splitlines()[1].split() == ["room", "2", "0", "2"]


def test_an_endless_loop_is_a_timeout(runs):
    runs.prepare()
    runs.pytest.limit_s = 5.0
    (endless,) = (m for m in runs.mutants if m.after == "x += 10")
    assert runs.try_one(endless) is Verdict.TIMEOUT


def test_tests_that_fail_without_a_change_prove_nothing(runs):
    write(runs.root, "tests/room/test_law.py", TESTS.replace("== 4.0", "== 5.0"))
    with pytest.raises(TestsFail, match="without any change"):
        runs.prepare()


HEEDING = """
import signal

def test_an_interrupt_would_be_noticed():
    assert signal.getsignal(signal.SIGHUP) == signal.SIG_DFL
    assert signal.getsignal(signal.SIGINT) == signal.default_int_handler
"""


def test_in_the_background_tests_of_interrupts_pass_as_well(runs):
    write(runs.root, "tests/room/test_heeding.py", HEEDING)
    before = {n: signal.signal(n, signal.SIG_IGN) for n in (signal.SIGHUP, signal.SIGINT)}
    try:
        runs.prepare()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_no_tests_at_all_are_no_verdict(runs):
    runs.prepare()
    write(runs.root, "tests/room/test_law.py", "")
    with pytest.raises(TestsFail, match="pytest ended with 5"):
        runs.try_one(runs.mutants[0])


def test_an_explanation_of_no_mutant_is_told():
    text, well = mutate.judge([], {"clip: gone => away": "it was so"}, every_key=set())
    assert not well
    assert "no such mutant: clip: gone => away" in text


def test_a_sample_is_the_same_for_the_same_seed():
    every = [Mutant(Path("a.py"), i, f"f: {i} => {i + 1}", "", "", b"") for i in range(100)]
    one = mutate.choose(every, 10, seed=3, match="")
    assert one == mutate.choose(every, 10, seed=3, match="")
    assert one != mutate.choose(every, 10, seed=4, match="")
    assert [m.line for m in one] == sorted(m.line for m in one)
    assert mutate.choose(every, 0, seed=3, match=": 7 ") == [every[7]]


def test_a_kind_of_change_is_chosen(tmp_path):
    write(tmp_path, "law.py", LAW)
    found = mutants_of(tmp_path, Path("law.py"))
    kinds = {kind: {m.after for m in mutate.choose(found, 0, 0, kind=kind)} for kind in KINDS}
    assert kinds["sign"] == {"return x + low", "x += 10", "def clip(x: float, low=LIMIT) -> float:"}
    assert kinds["condition"] == {"if x > LIMIT or x < 100.0:"}
    assert len(kinds["comparison"]) == 4
    assert sum(len(k) for k in kinds.values()) == len(found)


@pytest.mark.parametrize(
    ("program", "told"),
    [("import sys; sys.exit(1)", "1"), ("import os; os.abort()", "-6"), ("while True: pass", "timeout")],
)
def test_how_a_fork_ended_is_told(program, told):
    child = os.posix_spawn(sys.executable, [sys.executable, "-c", program], os.environ, setpgroup=0)
    assert ended(child, limit_s=1.0 if told == "timeout" else 60.0) == told


HEADER = """\
#include <stdint.h>
#define SIZE 4
#define GAIN (1.0f / 2.0f)
static const float table[SIZE] = {1.0f, 2.0f, 3.0f, 4.0f};
static inline float law(float x, int n) {
    float y = GAIN * x - -table[n] + 1.0f; /* 1 < 2 */
    if (!(n < SIZE - 1)) y += x - 0.5f;
    return y;
}
"""
# mutant as shown, and law(3, 1), law(3, 3) with it: 1.5 + 2 + 1; 1.5 + 4 + 1 + 2.5
WITHOUT = "4.5 9"
EXPECTED = {
    "float y = GAIN * x + -table[n] + 1.0f; /* 1 < 2 */": "0.5 1",
    "float y = GAIN * x - table[n] + 1.0f; /* 1 < 2 */": "0.5 1",
    "float y = GAIN * x - -table[n] - 1.0f; /* 1 < 2 */": "2.5 7",
    "float y = GAIN * x - -table[n] + 2.0f; /* 1 < 2 */": "5.5 10",
    "if ((n < SIZE - 1)) y += x - 0.5f;": "7 6.5",
    "if (!(n >= SIZE - 1)) y += x - 0.5f;": "7 6.5",
    "if (!(n < SIZE + 1)) y += x - 0.5f;": "4.5 6.5",
    "if (!(n < SIZE - 2)) y += x - 0.5f;": "4.5 9",
    "if (!(n < SIZE - 1)) y -= x - 0.5f;": "4.5 4",
    "if (!(n < SIZE - 1)) y += x + 0.5f;": "4.5 10",
    "if (!(n < SIZE - 1)) y += x - 1.5f;": "4.5 8",
    "#define GAIN (2.0f / 2.0f)": "6 10.5",
    "#define GAIN (1.0f / 3.0f)": "4 8.5",
}


@pytest.mark.skipif(shutil.which("cc") is None, reason="left out: mutants of C need the Debian package gcc")
def test_every_mutant_of_c_is_in_one_program(tmp_path):
    write(tmp_path, "law.h", HEADER)
    found = native_mutants(tmp_path, Path("law.h"), [Path("law.h")])
    # SIZE and the table must be known to the compiler: no mutant there
    assert {m.after for m, _ in found} == set(EXPECTED)
    write(tmp_path, "fl_mutant.h", PRELUDE)
    (tmp_path / "schema.h").write_bytes(schema(HEADER.encode(), enumerate((c for _, c in found), 1)))
    main = '#include <stdio.h>\nint main(void) { printf("%g %g", law(3, 1), law(3, 3)); }\n'
    write(tmp_path, "main.c", '#include "schema.h"\n' + main)
    command = ["cc", "-include", "fl_mutant.h", "main.c", "-o", "main"]
    subprocess.run(command, cwd=tmp_path, check=True)

    def printed(**environment):
        run = subprocess.run([tmp_path / "main"], env={**os.environ, **environment}, capture_output=True)
        return run.stdout.decode()

    assert printed() == WITHOUT
    assert {m.after: printed(FL_MUTANT=str(i)) for i, (m, _) in enumerate(found, 1)} == EXPECTED
