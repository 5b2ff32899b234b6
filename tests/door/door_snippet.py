"""The block of the README that shows the door, small. As a program: runs it on an installed fiberloom.

`python tests/door/door_snippet.py` is what a wheel has to pass wherever it is built ([tool.cibuildwheel]).
"""

import os
import re
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def printed():
    """The block of README.md that begins with the import."""
    blocks = re.findall(
        r"```python\n(import fiberloom as fl\n.*?)```", (ROOT / "README.md").read_text(), re.S
    )
    assert len(blocks) == 1
    return blocks[0]


def small(text):
    """The same with seven positioners and without images: what is tested is the text, not the sky."""
    return text.replace("n=50", "n=7").replace("seed=0)  ", 'seed=0, camera="noise")  ')


def as_script(text):
    """The same where no event loop runs."""
    return re.sub(r"await field\.", "field.run.", text)


def judge(names):
    """What the block must have left behind."""
    import fiberloom as fl

    assert isinstance(names["seen"], fl.Observation)
    assert len(names["seen"].moves) == 3
    assert names["seen"].summary()["n_within_requirement"] == 7
    assert names["field"].maps is not None


def main():
    """Runs the block in a folder of its own; fails where fiberloom is not the installed one."""
    import fiberloom

    place = Path(fiberloom.__file__).resolve()
    assert place.is_relative_to(Path(sys.prefix).resolve()), f"{place} is not installed in {sys.prefix}"
    names = {"__name__": "door"}
    with tempfile.TemporaryDirectory() as folder:
        os.environ.update(FIBERLOOM_CACHE=folder, MPLBACKEND="Agg")
        os.chdir(folder)
        Path("targets.csv").write_bytes((ROOT / "examples" / "targets_sdssv.csv").read_bytes())
        exec(compile(as_script(small(printed())), "README", "exec"), names)
        judge(names)
        os.chdir(ROOT)
    print(f"fiberloom {fiberloom.__version__} on Python {sys.version.split()[0]}: the door opens, {place}")


if __name__ == "__main__":
    main()
