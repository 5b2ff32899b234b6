"""What is written beside the event loop: in order, to its end, and what fails reaches the caller."""

import asyncio
import threading
from contextlib import contextmanager

import pytest

import fiberloom as fl
from fiberloom.errors import InputError
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.safety.writing import Writer, beside, entered
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.store.run import Run
from fiberloom.targets import random_targets
from fiberloom.twin import NoiseCamera, Twin, draw_units
from fiberloom.twin.transport import TwinTransport

PLANE = fl.FocalPlane.of("sdssv", n=7)


def test_all_is_written_in_order_and_the_caller_hears_of_what_failed():
    done = []

    def fails(text):
        raise InputError(text)

    async def scenario():
        writer = Writer()
        writer.later(done.append, 1)
        writer.later(fails, "the disk is full")
        writer.later(fails, "and again")
        writer.later(done.append, 2)
        with pytest.raises(InputError, match="the disk is full"):
            await writer.written()
        await writer.written()  # told once
        assert await writer.now(lambda: done.append(3) or "last") == "last"
        await writer.close()

    asyncio.run(scenario())
    assert done == [1, 2, 3]


@pytest.mark.parametrize("how", ["writer", "beside"])
def test_a_cancelled_caller_waits_until_it_is_written(how):
    begun, go_on, done = threading.Event(), threading.Event(), []

    def slowly():
        begun.set()
        go_on.wait()
        done.append("written")

    async def scenario():
        writer = Writer()
        task = asyncio.ensure_future(writer.now(slowly) if how == "writer" else beside(slowly))
        await asyncio.to_thread(begun.wait)
        task.cancel()
        await asyncio.sleep(0.01)
        waits = not task.done()
        go_on.set()
        assert waits
        with pytest.raises(asyncio.CancelledError):
            await task
        await writer.close()

    asyncio.run(scenario())
    assert done == ["written"]


def test_what_was_begun_while_the_caller_was_cancelled_is_ended():
    begun, go_on, said = threading.Event(), threading.Event(), []

    @contextmanager
    def made():
        begun.set()
        go_on.wait()
        try:
            yield "run"
        except asyncio.CancelledError:
            said.append("cancelled")
            raise
        finally:
            said.append("ended")

    async def within():
        async with entered(made):
            said.append("within")

    async def scenario():
        task = asyncio.ensure_future(within())
        await asyncio.to_thread(begun.wait)
        task.cancel()
        await asyncio.sleep(0)
        go_on.set()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(scenario())
    assert said == ["cancelled", "ended"]


def field_of(tmp_path):
    """An opened field with a book, of a twin."""
    twin = Twin(PLANE, draw_units(PLANE, 0), seed=0)
    field = fl.Field.open(PLANE, TwinTransport(twin), NoiseCamera(twin, 0.669, 1))
    field.book = ArrayBook(Store.open(tmp_path / "arrays.sqlite"), "cannet://10.1.10.31:19228")
    return field


def observed(field, tmp_path):
    targets = random_targets(PLANE, 8 * len(PLANE), 0)
    return field.run.observe(targets, corrections=1, out=tmp_path / "field")


def test_no_transaction_of_a_store_is_made_in_the_event_loop(tmp_path, monkeypatch):
    field, where = field_of(tmp_path), set()
    transaction = Store.transaction

    def told(store):
        where.add(threading.get_ident())
        return transaction(store)

    monkeypatch.setattr(Store, "transaction", told)
    observed(field, tmp_path)
    assert where
    assert threading.get_ident() not in where


def test_nothing_moves_before_all_is_written(tmp_path, monkeypatch):
    """Also where the disk is slow."""
    field, waiting = field_of(tmp_path), []
    record_event, send = Run.record_event, FieldMotion._execute

    def slowly(run, *words, **how):
        threading.Event().wait(0.1)
        return record_event(run, *words, **how)

    async def executed(motion, planned):
        motion.recorder.event("remark", "slowly")
        run_trajectories = motion.client.run_trajectories

        async def begun(*arguments, **how):
            waiting.append(len(motion.writer._waiting))
            return await run_trajectories(*arguments, **how)

        monkeypatch.setattr(motion.client, "run_trajectories", begun)
        return await send(motion, planned)

    monkeypatch.setattr(Run, "record_event", slowly)
    monkeypatch.setattr(FieldMotion, "_execute", executed)
    observed(field, tmp_path)
    assert waiting
    assert not any(waiting)


def test_what_was_measured_is_written_when_it_is_stopped_meanwhile(tmp_path, monkeypatch):
    field, record_move = field_of(tmp_path), Run.record_move

    async def scenario():
        task, loop = asyncio.current_task(), asyncio.get_running_loop()

        def stopped(run, number, *words, **how):
            if number == 1:
                loop.call_soon_threadsafe(task.cancel)
                threading.Event().wait(0.1)
            return record_move(run, number, *words, **how)

        monkeypatch.setattr(Run, "record_move", stopped)
        targets = random_targets(PLANE, 8 * len(PLANE), 0)
        await field.observe(targets, corrections=1, out=tmp_path / "field")

    with pytest.raises(asyncio.CancelledError):
        asyncio.run(scenario())
    with Store.open(tmp_path / "field" / "store.sqlite") as store:
        (run,) = store.runs()
        kinds = store.measurements(run.id)["kind"].tolist()
    assert run.status == "interrupted"
    assert kinds.count("blind") == len(PLANE)
    assert (field.book.state().state, field.book.state().owned) == ("stopped", False)


def test_a_disk_that_is_full_ends_the_observation_before_the_next_move(tmp_path, monkeypatch):
    field, moved = field_of(tmp_path), []
    execute = FieldMotion._execute

    async def executed(motion, planned):
        moved.append(planned)
        return await execute(motion, planned)

    def full(run, number, *words, **how):
        if number:
            raise InputError("store: the disk is full")

    monkeypatch.setattr(FieldMotion, "_execute", executed)
    monkeypatch.setattr(Run, "record_move", full)
    with pytest.raises(InputError, match="the disk is full"):
        observed(field, tmp_path)
    assert len(moved) == 1
