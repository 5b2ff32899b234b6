"""Two configurations of a small array, as files."""

import pytest

from fiberloom.instruments import generate, load_instrument
from fiberloom.planning import random_pair, write_configuration


@pytest.fixture(scope="module")
def plane():
    return generate(load_instrument("sdssv"), 0, n_positioners=7)


@pytest.fixture(scope="module")
def ends(plane, tmp_path_factory):
    """A folder with start.csv and goal.csv."""
    folder = tmp_path_factory.mktemp("ends")
    for name, angles_deg in zip(("start.csv", "goal.csv"), random_pair(plane, 0), strict=True):
        write_configuration(folder / name, plane.positioner_id, angles_deg)
    return folder
