"""MEGARA over TCP: robots at the four ports of a CAN@net device, observed by its frames."""

import asyncio

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.bus.transport import Frame
from fiberloom.connect import open_hardware
from fiberloom.drive.megara.frames import MegaraCommand, MegaraFrame, goal_frames
from fiberloom.errors import InputError
from fiberloom.metrology.camera import NoCamera
from fiberloom.twin.steppers.array import StepperArray
from fiberloom.twin.steppers.megara import MegaraBus, bus_of
from fiberloom.twin.steppers.served import RobotUnits
from support.served_steppers import SEED, hang_up_in_mid_move, loses_nothing, observed_at_once

N = 7
PLANE = fl.FocalPlane.of("megara", seed=SEED, n=N)


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    """Fields over TCP by name."""
    with observed_at_once(
        PLANE,
        tmp_path_factory.mktemp("fields"),
        whole={},
        dropped={"meanwhile": hang_up_in_mid_move},
        without_power={"faults": "busoff=1@75"},
        unseen={"camera": NoCamera(N)},
    ) as field:
        yield field


def test_a_whole_field_is_observed_over_tcp(field):
    over_tcp = field("whole")
    seen, off_um, server = over_tcp.seen, over_tcp.off_um, over_tcp.server
    assigned = seen.assignment.target >= 0
    assert over_tcp.named == {}
    assert assigned.sum() >= N - 1
    assert np.sqrt(np.mean(off_um[assigned] ** 2)) < 15.0  # switches are met in another order than within
    assert off_um[assigned].max() < 102.0
    assert server.report()["contacts"] == 0
    assert server.report()["clients"] == 1


def test_a_connection_that_drops_in_mid_move_loses_nothing(field):
    over_tcp = field("dropped")
    loses_nothing(over_tcp, clients=2, within_um=102.0)
    assert over_tcp.server.report()["contacts"] == 0


def test_a_bus_without_power_is_named_and_the_others_arrive(field):
    over_tcp = field("without_power")
    silent = {fault.positioner_id for fault in over_tcp.source.schedule}
    assert len({bus_of(number) for number in silent}) == 1
    assert set(over_tcp.named["disconnected"]) == silent
    others = (over_tcp.seen.assignment.target >= 0) & ~np.isin(PLANE.positioner_id, list(silent))
    assert others.sum() >= 4
    assert over_tcp.off_um[others].max() < 102.0


def test_a_robot_hears_its_own_port_alone():
    units = RobotUnits(MegaraBus(StepperArray(PLANE, seed=0)))
    one = int(PLANE.positioner_id[3])
    asked = MegaraFrame.of(one, 0, MegaraCommand.IDENTIFY)
    heard = {port: units.hear(port, Frame(*asked)) for port in (1, 2, 3, 4)}
    assert [port for port, replies in heard.items() if replies] == [units.port_of[one]]
    every = MegaraFrame.of(0, 0, MegaraCommand.IDENTIFY)
    numbers = [number for port in (1, 2, 3, 4) for number, _ in units.hear(port, Frame(*every))]
    assert sorted(numbers) == PLANE.positioner_id.tolist()


def touched(hear):
    """Contacts of goals that nothing has planned, all started at once by frames that are heard one by one."""
    plane = fl.FocalPlane.of("megara", seed=0, n=40)
    bus = MegaraBus(StepperArray(plane, seed=0))
    say, rng = hear(bus), np.random.default_rng(4)
    for rotor in (2, 1):
        say(MegaraFrame.of(0, rotor, MegaraCommand.HOME))
        bus.run(100.0)
    steps = bus.array.units.steps
    ends_deg = np.column_stack([rng.uniform(-150.0, 150.0, 40), rng.uniform(-90.0, -20.0, 40)])
    goals = np.rint((ends_deg - steps.home_deg) / steps.step_deg * steps.sign).astype(int)
    for frame in goal_frames(
        dict(zip(plane.positioner_id.tolist(), map(tuple, goals.tolist()), strict=True))
    ):
        say(frame)
    say(MegaraFrame.of(0, 0, MegaraCommand.START))
    return sorted((one.positioner_id, one.other or 0) for one in bus.array.touches())


def test_those_that_start_at_once_touch_no_more_where_each_port_is_told_by_itself():
    def over_ports(bus):
        units = RobotUnits(bus)
        return lambda frame: [units.hear(port, Frame(*frame)) for port in (1, 2, 3, 4)]

    at_once = touched(lambda bus: lambda frame: bus.send([frame]))
    assert at_once
    assert touched(over_ports) == at_once


def test_none_is_a_camera_of_blind_instruments_alone():
    with pytest.raises(InputError, match="calibrate steppers"):
        asyncio.run(open_hardware(PLANE, "cannet://127.0.0.1", "none").open())
    with pytest.raises(InputError, match="corrected by its camera"):
        open_hardware(fl.FocalPlane.of("lamost", n=3), "radio://127.0.0.1", "none")


def test_without_a_camera_nothing_counts_as_on_target(field):
    over_tcp = field("unseen")
    summary = over_tcp.seen.summary()
    assert over_tcp.named == {}
    assert over_tcp.off_um[over_tcp.seen.assignment.target >= 0].max() < 102.0
    assert summary["n_within_requirement"] == 0
    assert "where fibres are is not known" in summary["notes"][0]
