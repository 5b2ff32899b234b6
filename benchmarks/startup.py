"""CPU seconds until the package is imported, help is printed and bad input is refused: median of five."""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

CLI = ["-m", "fiberloom.cli"]
CASES = {
    "import fiberloom": ["-c", "import fiberloom"],
    "fiberloom --help": [*CLI, "--help"],
    "fiberloom observe --help": [*CLI, "observe", "--help"],
    "refusal: no such file": [*CLI, "observe", "nowhere.csv"],
    "refusal: a column is missing": [*CLI, "observe", "bad.csv"],
    "refusal: unknown instrument": [*CLI, "observe", "good.csv", "--instrument", "sloan"],
    "refusal: unknown fault": [*CLI, "twin", "--faults", "frob=1"],
}
LIMIT_S = {"import fiberloom": 0.5}
"""One second for all others."""


def cpu_s(words: list[str], folder: Path) -> float:
    """User and system seconds of one run."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *words], cwd=folder, capture_output=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "good.csv").write_text("target_id,x_mm,y_mm\na,1,2\n")
        (folder / "bad.csv").write_text("target_id,x,y_mm\na,1,2\n")
        found = {
            case: statistics.median(cpu_s(words, folder) for _ in range(asked.repeats))
            for case, words in CASES.items()
        }
    for case, seconds in found.items():
        limit_s = LIMIT_S.get(case, 1.0)
        print(
            f"{case:<32}{seconds:6.2f} CPU s (at most {limit_s:g}){'' if seconds <= limit_s else '  MISSED'}"
        )
    if asked.out is not None:
        asked.out.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
