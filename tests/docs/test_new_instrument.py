"""The tutorial of a new instrument: its quick commands answer what the page says; all have an answer."""

from pathlib import Path

import pytest

from tools.pages import transcript

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "design" / "tutorial-new-instrument.md").read_text()
PIECES = {m["command"]: m for m in transcript.COMMAND.finditer(TEXT) if m["command"]}
QUICK = [c for c in PIECES if c.split()[2] == "gear"]


def test_every_command_has_its_answer():
    assert len(PIECES) == sum(line.startswith("    fiberloom ") for line in TEXT.splitlines())
    assert all(m["answer"].strip() for m in PIECES.values())
    assert {"check", "sweep", "budget", "report"} <= {c.split()[2] for c in PIECES}


@pytest.mark.parametrize("command", QUICK)
def test_quick_commands_answer_what_the_page_says(command, tmp_path):
    (tmp_path / "dense.toml").write_text((ROOT / "examples" / "dense.toml").read_text())
    answered = transcript.ask(command, tmp_path)
    assert transcript.Exchange(command, PIECES[command]["answer"], answered).same, answered
