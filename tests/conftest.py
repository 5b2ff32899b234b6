from pathlib import Path

import pytest

from fiberloom.instruments import generate, load_instrument


@pytest.fixture(scope="session")
def sdssv():
    return load_instrument("sdssv")


@pytest.fixture(scope="session")
def plane(sdssv):
    return generate(sdssv, seed=0)


@pytest.fixture(scope="session")
def patch(sdssv):
    return generate(sdssv, seed=0, n_positioners=37)


@pytest.fixture(scope="session")
def shared_sdssv():
    """The SDSS-V data beside the checkout (or beside the folder of its worktrees)."""
    root = Path(__file__).resolve().parents[1]
    for parent in (root.parent, root.parent.parent):
        folder = parent / "shared" / "data" / "sdssv"
        if folder.is_dir():
            return folder
    pytest.skip("no ../shared/data/sdssv beside the checkout: the real tables are not public")
