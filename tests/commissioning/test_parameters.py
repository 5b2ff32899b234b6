"""Writing parameters over a bus that loses and falsifies frames: all of them, or the old ones."""

import asyncio
import re

import numpy as np
import pytest

from fiberloom.bus import Client, Command
from fiberloom.bus import parameters as bus_parameters
from fiberloom.bus.identifier import decode
from fiberloom.bus.parameters import PARAMETERS, PARAMETERS_DTYPE, read_parameters, write_parameters
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import Twin, TwinTransport, draw_units

PLANE = generate(load_instrument("sdssv"), seed=0, n_positioners=3)
IDS = [int(i) for i in PLANE.positioner_id]


class Meddling(TwinTransport):
    """Loses requests and answers that a rule picks, and changes answers."""

    def __init__(self, twin):
        super().__init__(twin)
        self.lose_request = lambda identifier: False
        self.lose_answer = lambda identifier: False
        self.falsify = lambda identifier, data: data

    async def send(self, frames):
        await super().send([f for f in frames if not self.lose_request(decode(f[0]))])

    async def receive(self, timeout_s):
        kept = [f for f in await super().receive(timeout_s) if not self.lose_answer(decode(f.id))]
        return [f._replace(data=self.falsify(decode(f.id), f.data)) for f in kept]


class Once:
    """True for the n-th identifier of a command, or for all from there on."""

    def __init__(self, command, number=None, nth=1, forever=False):
        self.command, self.number, self.nth, self.forever, self.seen = command, number, nth, forever, 0

    def __call__(self, identifier):
        if identifier.command != self.command or self.number not in (None, identifier.positioner):
            return False
        self.seen += 1
        return self.seen == self.nth or (self.forever and self.seen > self.nth)


class Bench:
    def __init__(self):
        self.units = draw_units(PLANE, 0, firmware="nominal")
        self.twin = Twin(PLANE, self.units, seed=0, neighbours=False, threads=1)
        self.bus = Meddling(self.twin)
        self.client = Client(self.bus)
        self.true = draw_units(PLANE, 0, firmware="true").firmware
        asyncio.run(self.client.discover())

    @property
    def wanted(self):
        return dict(zip(IDS, self.true, strict=True))

    def write(self, wanted=None):
        return asyncio.run(write_parameters(self.client, wanted or self.wanted))

    def held(self, number=IDS[0], power_cut=True):
        """What a positioner works with; after a power cut, what it has kept."""
        if power_cut:
            self.twin.power_cycle(number)
        self.bus.lose_request = self.bus.lose_answer = lambda identifier: False
        self.bus.falsify = lambda identifier, data: data
        state = asyncio.run(read_parameters(self.client, [number]))[number]
        assert not state.reason
        return state.values.tobytes()

    def factory(self, number=IDS[0]):
        return self.units.firmware[IDS.index(number)].tobytes()


@pytest.fixture
def bench():
    return Bench()


def test_what_is_read_is_what_the_firmware_was_given(bench):
    for row, state in enumerate(asyncio.run(read_parameters(bench.client)).values()):
        assert state.values.dtype == PARAMETERS_DTYPE
        assert state.values.tobytes() == bench.units.firmware[row].tobytes()


def test_written_read_back_saved_and_there_after_a_power_cut(bench):
    done = bench.write()
    assert all(w.ok and w.in_force == "new" for w in done.values())
    for number in IDS:
        assert bench.held(number) == bench.wanted[number].tobytes() != bench.factory(number)


def test_not_saved_is_gone_after_a_power_cut(bench):
    bench.bus.lose_request = Once(Command.SAVE_INTERNAL_CALIBRATION, forever=True)
    done = bench.write()
    for number in IDS:
        assert "timed out to SAVE_INTERNAL_CALIBRATION; the old parameters are in force again" in (
            done[number].reason
        )
        assert bench.held(number, power_cut=False) == bench.factory(number)
        assert bench.held(number) == bench.factory(number)


def test_a_save_that_may_have_been_done_is_undone(bench):
    """Its answers are lost, and it is not known whether the new ones are in the storage: they are."""
    lost = Once(Command.SAVE_INTERNAL_CALIBRATION, nth=1, forever=True)
    bench.bus.lose_answer = lambda identifier: lost(identifier) and lost.seen <= 4 * len(IDS)
    done = bench.write()
    assert "timed out to SAVE_INTERNAL_CALIBRATION" in done[IDS[0]].reason
    assert bench.held() == bench.factory()


@pytest.mark.parametrize(
    "command",
    [
        Command.SET_PARAMETER_BETA,
        Command.COMMIT_PARAMETERS,
        Command.GET_PARAMETER_BETA,
        Command.SAVE_INTERNAL_CALIBRATION,
    ],
)
def test_a_power_cut_at_any_step_leaves_the_old_ones(bench, command):
    first = Once(command, IDS[0], nth=60 if command == Command.GET_PARAMETER_BETA else 1)

    def cut(identifier):
        if first(identifier):
            bench.twin.power_cycle(IDS[0])
        return False

    bench.bus.lose_request = cut
    done = bench.write()
    assert [done[i].ok for i in IDS] == [False, True, True]
    assert done[IDS[0]].in_force == "old"
    assert bench.held(power_cut=False) == bench.factory()
    assert bench.held() == bench.factory()


@pytest.mark.parametrize("lose", ["lose_request", "lose_answer"])
@pytest.mark.parametrize("nth", [1, 5])
def test_one_lost_frame_is_sent_again(bench, lose, nth):
    setattr(bench.bus, lose, Once(Command.SET_PARAMETER_ALPHA, IDS[0], nth))
    assert all(w.ok for w in bench.write().values())
    assert bench.held() == bench.wanted[IDS[0]].tobytes()


def test_frames_lost_in_the_middle_for_good_leave_the_old_ones_and_the_others_new(bench):
    bench.bus.lose_request = Once(Command.SET_PARAMETER_BETA, IDS[0], nth=4, forever=True)
    done = bench.write()
    assert "timed out to SET_PARAMETER of" in done[IDS[0]].reason
    assert done[IDS[0]].in_force == "old"
    assert [done[i].ok for i in IDS] == [False, True, True]
    assert bench.held() == bench.factory()
    assert bench.held(IDS[1]) == bench.wanted[IDS[1]].tobytes()


def test_a_frame_lost_unnoticed_is_noticed_at_the_commit(bench):
    """Acknowledged by somebody else's answer, so to speak: the copy is not what was meant."""
    spoil = Once(Command.SET_PARAMETER_ALPHA, IDS[0])

    class Spoiling(Meddling):
        async def send(self, frames):
            spoiled = [(f[0], f[1][:-1] + b"\x3f") if spoil(decode(f[0])) else f for f in frames]
            await super().send(spoiled)

    bench.bus.__class__ = Spoiling
    done = bench.write()
    assert not done[IDS[0]].ok
    assert bench.held() == bench.factory()


def test_a_lost_answer_to_the_commit_is_asked_after(bench):
    bench.bus.lose_answer = Once(Command.COMMIT_PARAMETERS, IDS[0])
    assert bench.write()[IDS[0]].ok
    assert bench.held() == bench.wanted[IDS[0]].tobytes()


def test_what_is_read_back_differently_is_told_and_the_old_ones_restored(bench):
    # all were read before; the fourth of the second reading
    counted = Once(Command.GET_PARAMETER_ALPHA, IDS[0], nth=len(PARAMETERS) + 4, forever=True)

    def falsify(identifier, data):
        return data[:1] + b"\0\0\x80\x3f" if counted(identifier) else data

    bench.bus.falsify = falsify
    done = bench.write()
    assert "reading back" in done[IDS[0]].reason
    assert "the old parameters are in force again" in done[IDS[0]].reason
    assert done[IDS[0]].in_force == "old"
    assert bench.held(power_cut=False) == bench.factory()
    assert bench.held() == bench.factory()


@pytest.mark.parametrize("command", [Command.BEGIN_PARAMETERS, Command.SAVE_INTERNAL_CALIBRATION])
def test_an_interrupted_write_puts_back_what_has_changed(bench, command):
    """Nothing where nothing has: the frame that was interrupted is the last one."""
    sent = []

    def interrupt(identifier):
        sent.append(identifier.command)
        if identifier.command == command:
            raise KeyboardInterrupt
        return False

    bench.bus.lose_request = interrupt
    with pytest.raises(KeyboardInterrupt):
        bench.write()
    assert (sent[-1] == command) == (command == Command.BEGIN_PARAMETERS)
    assert bench.held(power_cut=False) == bench.factory()


@pytest.mark.parametrize("meddle", ["lose_answer", "falsify"])
def test_one_that_cannot_be_read_is_not_written(bench, meddle):
    """Its answers are lost, or are those to another question."""
    first = Once(Command.GET_PARAMETER_ALPHA, IDS[0], nth=3, forever=meddle == "lose_answer")
    if meddle == "falsify":
        bench.bus.falsify = lambda identifier, data: b"\x07" + data[1:] if first(identifier) else data
    else:
        bench.bus.lose_answer = first
    done = bench.write()
    assert done[IDS[0]].reason == "a parameter was not answered; check the bus and repeat"
    assert [done[i].in_force for i in IDS] == ["old", "new", "new"]
    assert bench.held() == bench.factory()


def test_what_started_anew_before_it_was_read_back_is_named(bench):
    """A power cut right after the commit: all it says fits together, but it is the old."""
    after = Once(Command.GET_PARAMETER_TABLE, IDS[0], nth=2)

    def cut(identifier):
        if after(identifier):
            bench.twin.power_cycle(IDS[0])
        return False

    bench.bus.lose_request = cut
    done = bench.write()
    assert re.search(r"reading back: alpha \w+ is .*, .* was written; the old", done[IDS[0]].reason)
    assert [done[i].in_force for i in IDS] == ["old", "new", "new"]
    assert bench.held() == bench.factory()


class Refusing(Meddling):
    """Answers a request with a code that says why not."""

    refused = None

    async def receive(self, timeout_s):
        frames = await super().receive(timeout_s)
        return [f._replace(id=f.id | 2) if self.refused(decode(f.id)) else f for f in frames]


def test_a_save_that_is_refused_leaves_the_old_ones_in_force(bench):
    """Nothing was saved, so nothing more is: the storage wears."""
    bench.bus.__class__ = Refusing
    saves = Once(Command.SAVE_INTERNAL_CALIBRATION, IDS[0])
    bench.bus.lose_request = lambda identifier: saves(identifier) and False
    bench.bus.refused = Once(Command.SAVE_INTERNAL_CALIBRATION, IDS[0])
    done = bench.write()
    assert saves.seen == 1
    assert "refused" in done[IDS[0]].reason
    assert "to SAVE_INTERNAL_CALIBRATION; the old parameters are in force again" in done[IDS[0]].reason
    assert [done[i].in_force for i in IDS] == ["old", "new", "new"]
    bench.bus.refused = lambda identifier: False
    assert bench.held(power_cut=False) == bench.factory()


@pytest.mark.parametrize("meddle", ["lose_answer", "falsify"])
def test_a_save_that_is_not_reported_is_undone(bench, meddle):
    """The status after the save is lost, or does not tell of it."""
    status = Once(Command.GET_STATUS, IDS[0], forever=True)
    setattr(bench.bus, meddle, status)
    if meddle == "falsify":
        bench.bus.falsify = lambda identifier, data: bytes(8) if status(identifier) else data
    done = bench.write()
    assert done[IDS[0]].reason.startswith(
        "it does not report what was saved; the old parameters are in force"
    )
    assert bench.held() == bench.factory()


def test_where_the_commit_never_came_the_checksum_says_that_the_old_ones_are_in_force(bench):
    bench.bus.lose_request = Once(Command.COMMIT_PARAMETERS, IDS[0], forever=True)
    done = bench.write()
    assert done[IDS[0]].reason.endswith("; the old parameters are in force")
    assert [done[i].in_force for i in IDS] == ["old", "new", "new"]
    assert bench.held(power_cut=False) == bench.factory()


def test_where_neither_the_commit_nor_the_checksum_is_answered_nobody_knows(bench):
    bench.bus.lose_answer = Once(Command.COMMIT_PARAMETERS, IDS[0], forever=True)
    bench.bus.lose_request = Once(Command.GET_PARAMETER_TABLE, IDS[0], nth=2, forever=True)
    done = bench.write()
    assert [done[i].in_force for i in IDS] == ["unknown", "new", "new"]
    assert "which parameters are in force is not known: switch its power off and on" in done[IDS[0]].reason
    assert "the old" not in done[IDS[0]].reason
    # as it says
    assert bench.held() == bench.factory()


def test_where_the_old_ones_cannot_be_put_back_it_says_so(bench):
    """Neither the save nor the second beginning comes through: the new ones work until the power goes."""
    bench.bus.lose_request = lambda identifier: save(identifier) or begin(identifier)
    save = Once(Command.SAVE_INTERNAL_CALIBRATION, IDS[0], forever=True)
    begin = Once(Command.BEGIN_PARAMETERS, IDS[0], nth=2, forever=True)
    done = bench.write()
    told = done[IDS[0]].reason
    assert "putting the old ones back failed (timed out to BEGIN_PARAMETERS): switch its power off" in told
    assert [done[i].in_force for i in IDS] == ["unknown", "new", "new"]
    assert bench.held(power_cut=False) == bench.wanted[IDS[0]].tobytes()
    assert bench.held() == bench.factory()


def test_where_the_old_ones_are_in_force_but_may_not_be_saved_it_says_so(bench):
    """No answer to any save: what is in the storage is not known."""
    bench.bus.lose_answer = Once(Command.SAVE_INTERNAL_CALIBRATION, IDS[0], forever=True)
    done = bench.write()
    assert "after a power cut it may start with the new ones: repeat" in done[IDS[0]].reason
    assert done[IDS[0]].in_force == "old"
    assert bench.held(power_cut=False) == bench.factory()


def test_another_table_is_refused_before_anything_is_sent(bench, monkeypatch):
    bus_parameters.table_crc.cache_clear()
    lines = list(bus_parameters.PARAMETERS)
    narrower = lines[7].__class__(7, "inertia", lines[7].unit, 1e-12, 1.0, lines[7].default, "")
    assert lines[7].name == "inertia"
    monkeypatch.setattr(bus_parameters, "PARAMETERS", (*lines[:7], narrower, *lines[8:]))
    done = bench.write()
    monkeypatch.undo()
    bus_parameters.table_crc.cache_clear()
    assert "its parameter table is" in done[IDS[0]].reason
    assert "upgrade the firmware" in done[IDS[0]].reason
    assert bench.held() == bench.factory()


def test_a_firmware_without_the_commands_says_so(bench):
    class Old(Meddling):
        async def receive(self, timeout_s):
            frames = await super().receive(timeout_s)
            return [f._replace(id=f.id | 13) if decode(f.id).command == 230 else f for f in frames]

    bench.bus.__class__ = Old
    assert "no parameter commands" in bench.write()[IDS[0]].reason


def test_a_moving_positioner_keeps_its_parameters(bench):
    asyncio.run(bench.client.goto([IDS[0]], 200.0, 90.0))
    done = bench.write()
    assert "ALREADY_IN_MOTION" in done[IDS[0]].reason
    assert done[IDS[1]].ok


def test_a_value_out_of_range_is_refused_here_with_its_name(bench):
    wanted = bench.wanted
    wanted[IDS[1]] = wanted[IDS[1]].copy()
    wanted[IDS[1]]["hall_amplitude_b"][1] = 5000.0
    with pytest.raises(
        InputError, match=f"positioner {IDS[1]}, beta hall_amplitude_b = 5000 cnt.*100 to 2047"
    ):
        bench.write(wanted)
    assert bench.held() == bench.factory()


def test_only_what_differs_travels(bench):
    bench.write()
    sent = []
    bench.bus.lose_request = lambda identifier: sent.append(identifier.command)
    assert all(w.ok for w in bench.write().values())
    assert Command.SET_PARAMETER_ALPHA not in sent
    assert np.all([c != Command.SET_PARAMETER_BETA for c in sent])
