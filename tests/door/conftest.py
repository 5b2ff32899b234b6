"""Where the examples of the public door run: a folder with a target list in it."""

import numpy as np
import pytest

N_TARGETS = 60


def target_rows():
    """A spiral of targets over what seven positioners reach, and more than that."""
    turn = 2.399963 * np.arange(N_TARGETS)
    x_mm, y_mm = 5.0 * np.sqrt(np.arange(N_TARGETS)) * np.stack([np.cos(turn), np.sin(turn)])
    return [f"t{k},{x:.3f},{y:.3f},{1 + k % 3}" for k, (x, y) in enumerate(zip(x_mm, y_mm, strict=True))]


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """The current folder, with targets.csv."""
    (tmp_path / "targets.csv").write_text("\n".join(["target_id,x_mm,y_mm,priority", *target_rows()]) + "\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path
