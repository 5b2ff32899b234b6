"""LAMOST on the twin: a blind move without a table, and a correction that weighs a noisy camera."""

import fiberloom as fl
from fiberloom.drive.lamost import RadioPacket, coordinator_of, decoded, encoded
from fiberloom.targets.generate import random_targets

PLANE = fl.FocalPlane.of("lamost", seed=0, n=80)
TARGETS = random_targets(PLANE, 220, seed=1)


def observed(folder, faults="", **options):
    """Summary of a field, and its source."""
    field = fl.Field.twin(PLANE, seed=0, camera="noise", faults=faults)
    return field.run.observe(TARGETS, out=folder, **options).summary(), field.source


def test_one_weighed_correction_brings_all_within_40_um(tmp_path):
    summary, _ = observed(tmp_path / "run")
    blind, corrected = (move["healthy"] for move in summary["moves"])
    assert 35.0 < blind["rms_um"] < 60.0  # gears without a table: 46 um
    # the mean of two images of 20 um is 14 um; weighed with the blind move, and half steps, it is less
    assert corrected["rms_um"] < 16.0
    assert summary["n_within_requirement"] >= 0.99 * summary["n_assigned"]
    assert summary["contacts_true"] == 0


def test_a_plain_correction_is_worse(tmp_path):
    weighed, _ = observed(tmp_path / "a", images=1)
    plain, _ = observed(tmp_path / "b", images=1, correction="plain")
    assert plain["moves"][-1]["true_rms_um"] > 1.05 * weighed["moves"][-1]["true_rms_um"]


def test_broken_units_are_flagged_and_the_rest_goes_on(tmp_path):
    summary, source = observed(tmp_path / "run", "slipping=1,dead=1,swapped=1,dark=1")
    flagged = {number for numbers in summary["faults"].values() for number in numbers}
    assert {fault.positioner_id for fault in source.faults} <= flagged
    assert summary["n_within_requirement"] >= 0.97 * (summary["n_assigned"] - len(flagged))
    assert summary["contacts_true"] == 0


def test_packets_by_hand():
    assert encoded(RadioPacket(3, 0x0145, b"\x02")).hex() == "0503014502b0"
    assert decoded(bytes.fromhex("0503014502b0")) == RadioPacket(3, 0x0145, b"\x02")
    assert [coordinator_of(unit) for unit in (0, 1, 200, 201, 4000)] == [0, 1, 1, 2, 20]
