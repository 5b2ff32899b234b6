"""An older store is upgraded when it is asked for, in one line of revisions; then it is like a new one."""

import resource
import sqlite3
from datetime import UTC, datetime

import numpy as np
import pytest
from sqlalchemy import create_engine, insert, inspect, select

from fiberloom.errors import InputError
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.store.schema import RUNS, SCHEMA, SCHEMA_VERSION, TABLES
from fiberloom.store.sums import as_utc
from fiberloom.store.upkeep.check import check_store
from fiberloom.store.upkeep.copy import copy_store
from fiberloom.store.upkeep.upgrade import upgrade, upgrade_tables

FIRST_ROW = {
    "utc_start": datetime(2026, 3, 1, 22, 15, tzinfo=UTC),
    **{"command_line": "observe", "instrument": "sdssv", "config_hash": "c0ffee", "seed": 4},
    **{"version": "0.0", "status": "finished", "note": "", "host": "h", "pid": 1, "process_start": ""},
}


def engine_of(place):
    return create_engine(place if "://" in place else f"sqlite:///{place}")


def older(place, version):
    """A store as that version has made it, with a run in it."""
    engine = engine_of(place)
    with engine.begin() as connection:
        TABLES.create_all(connection, tables=[SCHEMA])
        connection.execute(insert(SCHEMA), {"version": 0})
        upgrade_tables(connection, 0, version)
        connection.execute(insert(RUNS).values(FIRST_ROW))
    engine.dispose()
    return place


def tables(place):
    """What the database says of its tables: columns, keys, references, indexes."""
    engine = engine_of(place)
    seen = inspect(engine)
    told = {}
    for table in sorted(seen.get_table_names()):
        told[table] = {
            "columns": {c["name"]: (str(c["type"]), c["nullable"]) for c in seen.get_columns(table)},
            "key": seen.get_pk_constraint(table)["constrained_columns"],
            "references": sorted(
                (f["constrained_columns"], f["referred_table"]) for f in seen.get_foreign_keys(table)
            ),
            "indexes": sorted(
                (i["name"], i["column_names"], bool(i["unique"]))
                for i in seen.get_indexes(table)
                if not i.get("duplicates_constraint")
            ),
            "unique": sorted(u["column_names"] for u in seen.get_unique_constraints(table)),
        }
    engine.dispose()
    return told


@pytest.fixture
def new_tables(place):
    """Of a new store on the same kind of database."""
    with Store.open(place):
        pass
    told = tables(place)
    if "://" in place:
        from databases import emptied

        emptied(place)
    else:
        from pathlib import Path

        Path(place).unlink()
    return told


VERSIONS = [*[("sqlite", v) for v in range(1, SCHEMA_VERSION)], ("postgresql", 1), ("postgresql", 5)]


@pytest.mark.parametrize(("place", "version"), VERSIONS, indirect=["place"])
def test_an_upgraded_store_is_like_a_new_one_and_keeps_its_rows(place, new_tables, version):
    older(place, version)
    assert upgrade(place)[0] == version
    assert tables(place) == new_tables
    with Store.open(place) as store:
        (run,) = store.runs()
        assert (run.seed, run.utc_start) == (4, FIRST_ROW["utc_start"])
        with store.start_run(command_line="x", instrument="sdssv") as second:
            second.record_move(1, "blind", {"positioner_id": [1, 2]})
        assert [run.n_measurements for run in store.runs()] == [0, 2]
        assert check_store(store).without_sum == 1
    assert upgrade(place) == (SCHEMA_VERSION, None)


def test_an_older_store_is_not_written_before_it_is_upgraded(place):
    older(place, 5)
    with pytest.raises(InputError, match="of version 5, this program writes 6; bring it up to date"):
        Store.open(place)
    with pytest.raises(InputError, match="keeps a copy"):
        Store.open(place, create=False)


def test_a_copy_of_the_file_is_kept_and_not_written_over(tmp_path):
    path = tmp_path / "s.sqlite"
    older(str(path), 4)
    _, kept = upgrade(str(path))
    assert kept == tmp_path / "s.sqlite.v4"
    with sqlite3.connect(kept) as raw:
        assert raw.execute("SELECT version FROM fiberloom_schema").fetchall() == [(4,)]
    path.unlink()
    older(str(path), 4)
    with pytest.raises(InputError, match="is there already, from an earlier upgrade"):
        upgrade(str(path))


def test_a_copy_that_does_not_fit_on_the_disk_is_not_left_in_the_way(tmp_path):
    path = tmp_path / "s.sqlite"
    before = tables(older(str(path), 5))
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size // 2, limits[1]))
    try:
        with pytest.raises(InputError, match="cannot be upgraded, and is as it was"):
            upgrade(str(path))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [file.name for file in tmp_path.iterdir()] == ["s.sqlite"]
    assert tables(str(path)) == before
    _, kept = upgrade(str(path))
    assert tables(str(kept)) == before


def test_an_upgrade_that_fails_half_way_leaves_the_store_as_it_was(place):
    older(place, 3)
    engine = engine_of(place)
    with engine.begin() as connection:
        connection.exec_driver_sql("CREATE TABLE alarms (x INTEGER)")  # in the way of the last step
    engine.dispose()
    before = tables(place)
    with pytest.raises(InputError, match=r"cannot be upgraded, and is as it was: .*alarms"):
        upgrade(place)
    assert tables(place) == before


def test_what_cannot_be_upgraded(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        upgrade(str(tmp_path / "none.sqlite"))
    with sqlite3.connect(tmp_path / "other.sqlite") as raw:
        raw.execute("CREATE TABLE t (x)")
    with pytest.raises(InputError, match="has no tables of fiberloom"):
        upgrade(str(tmp_path / "other.sqlite"))
    with Store.open(tmp_path / "newer.sqlite"):
        pass
    with sqlite3.connect(tmp_path / "newer.sqlite") as raw:
        raw.execute("UPDATE fiberloom_schema SET version = 99")
    with pytest.raises(InputError, match="upgrade it with a newer fiberloom"):
        upgrade(str(tmp_path / "newer.sqlite"))


# the same on both databases


def filled(place):
    with Store.open(place) as store:
        with store.start_run(command_line="x", instrument="sdssv", seed=1) as run:
            run.record_move(1, "blind", {"positioner_id": [1, 2], "error_um": [np.nan, 2.5]}, time_s=3.0)
            run.record_event("flag", "text", positioner_id=2)
        ArrayBook(store, "cannet://h:1").exclude([4], "ann", "why")
    return place


def test_rows_come_back_as_they_were_written(place):
    filled(place)
    with Store.open(place, create=False) as store:
        np.testing.assert_array_equal(store.measurements(1)["error_um"], [np.nan, 2.5])
        assert store.events(1)["text"].tolist() == ["text"]
        assert abs((store.runs()[0].utc_start - datetime.now(UTC)).total_seconds()) < 60.0
        (excluded,) = ArrayBook(store, "cannet://h:1").exclusions()
        assert excluded.who == "ann"
        assert check_store(store).ok


def test_two_hosts_cannot_own_one_array(place):
    with Store.open(place) as first, Store.open(place) as second:
        ArrayBook(first, "cannet://h:1").take("night", "moving")
        with pytest.raises(InputError, match="in use by `night`"):
            ArrayBook(second, "cannet://h:1").take("observe", "moving")


def test_a_copy_holds_the_same_rows_and_goes_on(place, tmp_path):
    source = filled(str(tmp_path / "from.sqlite"))
    with Store.read(source) as old, Store.open(place) as new:
        counts = copy_store(old, new)
        assert counts["measurements"] == 2
        assert check_store(new).ok
        assert all_rows(old) == all_rows(new)
        with new.start_run(command_line="y", instrument="sdssv") as run:
            assert run.id == 2
        with pytest.raises(InputError, match="is not empty"):
            copy_store(old, new)


def test_a_store_that_knows_an_array_and_no_run_is_not_empty(tmp_path):
    with Store.open(tmp_path / "from.sqlite") as old, Store.open(tmp_path / "to.sqlite") as new:
        with old.start_run(command_line="x", instrument="sdssv"):
            pass
        ArrayBook(new, "cannet://h:1").exclude([4], "ann", "why")
        with pytest.raises(InputError, match="is not empty"):
            copy_store(old, new)
        assert new.runs() == []


def all_rows(store):
    """Of every table, times without the zone that only some databases tell."""
    with store.transaction() as connection:
        rows = {t.name: connection.execute(select(t)).all() for t in TABLES.sorted_tables}
    return {
        name: sorted([as_utc(v) if isinstance(v, datetime) else v for v in row] for row in found)
        for name, found in rows.items()
    }


def test_a_check_names_what_is_wrong(tmp_path):
    path = filled(str(tmp_path / "s.sqlite"))
    with sqlite3.connect(path) as raw:
        raw.execute("UPDATE events SET text = 'other'")
        raw.execute("DELETE FROM moves")
    with Store.read(path) as store:
        found = check_store(store)
    assert not found.ok
    told = " ".join(found.faults)
    assert "row 1 of the table events is not what was written" in told
    assert "rows of measurements belong to rows that are gone" in told


def test_the_commands(fl, tmp_path):
    path = older(str(tmp_path / "s.sqlite"), 5)
    code, out, _ = fl("store", "upgrade", path, "--json")
    assert (code, '"version_before": 5' in out, "s.sqlite.v5" in out) == (0, True, True)
    code, out, _ = fl("store", "check", path, "--json")
    assert (code, '"rows_without_sum": 1' in out) == (0, True)
    code, out, _ = fl("store", "copy", path, tmp_path / "new.sqlite", "--json")
    assert (code, '"rows": 1' in out) == (0, True)
    with sqlite3.connect(path) as raw:
        raw.execute("UPDATE runs SET seed = 5, row_sum = 1")
    code, out, _ = fl("store", "check", path)
    assert code == 1
    assert "row 1 of the table runs" in out
