"""A place for a store: an SQLite file, and a PostgreSQL database."""

import pytest
from databases import emptied, postgres


@pytest.fixture(scope="session")
def postgres_url():
    with postgres() as url:
        yield url


@pytest.fixture(params=["sqlite", "postgresql"])
def place(request, tmp_path):
    """Path or URL of a store that is not there yet."""
    if request.param == "sqlite":
        return str(tmp_path / "s.sqlite")
    return emptied(request.getfixturevalue("postgres_url"))
