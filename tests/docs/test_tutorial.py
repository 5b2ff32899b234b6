"""docs/start/tutorial.md: its commands answer what the page says, but for times."""

import shutil
from pathlib import Path

import pytest

from tools.pages import transcript

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "start" / "tutorial.md").read_text()


@pytest.mark.slow
def test_the_tutorial_answers_what_it_says(tmp_path):
    found = transcript.run_page(TEXT, tmp_path)
    shutil.rmtree(tmp_path, ignore_errors=True)  # exposures are large
    told = [f"$ {e.command}\n{e.answered}\nbut the page:\n{e.said}" for e in found if not e.same]
    assert told == [], "\n".join(["`make tutorial` writes the page anew", *told])


def test_every_command_of_the_page_has_its_answer():
    pieces = [m for m in transcript.COMMAND.finditer(TEXT) if m["command"]]
    assert len(pieces) >= 13
    assert len(pieces) == sum(line.startswith("    fiberloom ") for line in TEXT.splitlines())
    assert all(m["answer"].strip() for m in pieces)
    assert len({m["command"].split()[1] for m in pieces}) >= 10


def test_the_check_can_fail():
    page = "    fiberloom no-such\n\n```text\n37 of 37, everything took 3 s\n```\n"
    (piece,) = transcript.COMMAND.finditer(page)

    def exchange(answered):
        return transcript.Exchange(piece["command"], piece["answer"], answered)

    assert exchange("37 of 37,   everything took 41 s").same
    assert not exchange("36 of 37, everything took 3 s").same
    assert not exchange("37 of 37, everything took 3 s\nexit code 1").same
    assert transcript.with_answers(page, [exchange("new\n")]) == page.replace(
        "37 of 37, everything took 3 s", "new"
    )
    answer = transcript.ask("fiberloom no-such", ROOT)
    assert answer.startswith("fiberloom: No such command")
    assert answer.endswith("exit code 2\n")
