"""MOONS on the twin: waveforms through its gateways, both elbows, no correction; faults are flagged."""

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.drive.moons.frames import (
    MoonsCommand,
    MoonsError,
    MoonsState,
    PacketReader,
    Segment,
    UnitPlace,
    command_frame,
    decode_answer,
    packed,
    segment_data,
)
from fiberloom.targets.generate import random_targets
from fiberloom.twin.steppers.array import StepperArray
from fiberloom.twin.steppers.moons import MoonsBus

PLANE = fl.FocalPlane.of("moons", seed=0, n=40)
TARGETS = random_targets(PLANE, 100, seed=1)


def observed(folder, faults=""):
    """Summary of a field, and its source."""
    field = fl.Field.twin(PLANE, seed=0, camera="noise", faults=faults)
    seen = field.run.observe(TARGETS, out=folder)
    return seen, field.source


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A field of healthy units."""
    return observed(tmp_path_factory.mktemp("whole") / "run")


def test_a_field_without_correction_meets_its_20_um_in_truth(whole):
    seen, source = whole
    summary = seen.summary()
    last = summary["moves"][-1]
    assert len(summary["moves"]) == 1
    assert summary["n_assigned"] == 40
    assert summary["n_within_requirement"] >= 39
    # half steps 3.5 um, switches 0.008 deg at up to 25 mm, arms 1.5 um: between 3 and 10 um
    assert 3.0 < last["true_rms_um"] < 10.0
    assert summary["contacts_true"] == source.bus.array.contacts() == 0


def test_both_elbows_are_used(whole):
    seen, _ = whole
    beta = seen.assignment.goal_deg[:, 1]
    assert 0.1 < np.mean(beta > 180.0) < 0.9


def test_waveforms_differ_from_square_moves_and_all_move_at_once(whole):
    """32 s are the longest waveform; one after the other the units would take minutes."""
    summary = whole[0].summary()
    assert 10.0 < summary["motion_s"] < 32.0


def test_broken_units_are_flagged_and_the_rest_goes_on(tmp_path):
    seen, source = observed(tmp_path / "run", "slipping=1,dead=1,swapped=1")
    summary = seen.summary()
    broken = {fault.positioner_id for fault in source.faults}
    assert broken <= set(summary["faults"]["dead"])
    left_out = sum(map(len, summary["faults"].values()))
    assert left_out <= 4 + 4  # neighbours of those that do not move may be blocked
    assert summary["n_within_requirement"] >= summary["n_assigned"] - left_out - 1
    assert summary["contacts_true"] == 0


def test_a_gateway_without_power_is_flagged_and_the_rest_goes_on(tmp_path):
    seen, source = observed(tmp_path / "run", "busoff=1@22")
    summary, silent = seen.summary(), {one.positioner_id for one in source.schedule}
    assert set(summary["faults"]["disconnected"]) == silent
    blocked = len(summary["faults"].get("blocked", []))
    assert summary["n_within_requirement"] >= summary["n_assigned"] - len(silent) - blocked - 1
    assert summary["contacts_true"] == 0


# the controller by itself


def bus_of(n=3):
    """A few units, at their datum."""
    plane = fl.FocalPlane.of("moons", seed=0, n=n)
    bus = MoonsBus(StepperArray(plane, seed=0, contacts=False))
    numbers = plane.positioner_id.tolist()
    for number in numbers:
        told(bus, number, MoonsCommand.FIND_DATUM)
    for _ in range(4):
        bus.run(1.0)
    return bus, numbers


def told(bus, number, command, data=b""):
    """The answer of a unit to a command, or None."""
    place = UnitPlace.of(number)
    out = bus.take(place.gateway, packed(command_frame(place, 1, command, data)))
    frames = [frame for _, stream in out for frame in PacketReader().feed(stream)]
    return decode_answer(frames[0]) if frames else None


def test_without_a_datum_no_waveform_is_taken():
    plane = fl.FocalPlane.of("moons", seed=0, n=1)
    bus, number = MoonsBus(StepperArray(plane, seed=0)), int(plane.positioner_id[0])
    answer = told(
        bus, number, MoonsCommand.CONFIG_MOTION, segment_data((62, 0), Segment.FIRST | Segment.LAST)
    )
    assert (answer.error, answer.state) == (MoonsError.NO_DATUM, MoonsState.UNINITIALISED)


def test_a_waveform_against_the_rules_is_not_taken():
    bus, numbers = bus_of()
    one = Segment.FIRST | Segment.LAST | Segment.REPLY
    answer = told(bus, numbers[0], MoonsCommand.CONFIG_MOTION, segment_data((100, 0), one))
    assert (answer.error, answer.state) == (MoonsError.WAVEFORM, MoonsState.RESTING)
    answer = told(bus, numbers[0], MoonsCommand.CONFIG_MOTION, segment_data((62, -62), one))
    assert (answer.error, answer.state) == (MoonsError.NONE, MoonsState.READY_FORWARD)


def test_counters_tell_the_end_and_an_abort_stops_on_the_way():
    bus, numbers = bus_of()
    for k in range(8):
        flags = (Segment.FIRST if k == 0 else Segment(0)) | (Segment.LAST if k == 7 else Segment(0))
        told(bus, numbers[0], MoonsCommand.CONFIG_MOTION, segment_data((62, 62), flags))
    told(bus, numbers[0], MoonsCommand.EXECUTE)
    bus.run(0.5)
    assert told(bus, numbers[0], MoonsCommand.PING).state is MoonsState.MOVING
    told(bus, numbers[0], MoonsCommand.ABORT)
    answer = told(bus, numbers[0], MoonsCommand.PING)
    assert answer.state is MoonsState.ABORTED
    assert answer.counters == (-10000 + 4 * 62, 4 * 62)
    told(bus, numbers[0], MoonsCommand.ENABLE_MOVE)
    assert told(bus, numbers[0], MoonsCommand.PING).state is MoonsState.RESTING
