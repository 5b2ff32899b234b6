"""Commands ask what kind of motors an instrument has, not what it is called."""

from pathlib import Path

import pytest

from fiberloom.operation.outside.opened import OpenedCobras, OpenedDesi
from fiberloom.operation.source import OpenedArray, OutsideArray
from fiberloom.twin.cobras.served import ServedCobras
from fiberloom.twin.server.told import counts_text

TARGETS = "target_id,x_mm,y_mm\na,1,2\n"


def test_a_file_of_one_s_own_has_the_faults_of_its_motors(fl, tmp_path):
    """A fault that needs gateways is refused by its motors, whatever the file is called."""
    targets, own = tmp_path / "t.csv", tmp_path / "own.toml"
    targets.write_text(TARGETS)
    own.write_text(fl("instruments", "sdssv", "--toml")[1])
    told = [
        fl("observe", targets, "--instrument", name, "--positioners", 3, "--faults", "cut=1")
        for name in ("sdssv", own)
    ]
    assert told[0] == told[1]
    assert told[0][0] == 2
    assert "cut" in told[0][2]


@pytest.mark.parametrize("instrument", ["desi", "pfs"])
@pytest.mark.parametrize("option", [("--first",), ("--bootloader",), ("--devices", 2)])
def test_what_is_sdssv_s_alone_is_refused(fl, instrument, option):
    words = ("twin", "--instrument", instrument, "--positioners", 57, "--listen", "127.0.0.1:14799")
    code, _, err = fl(*words, *option, "--stop-after", 0)
    assert code == 2
    assert err == f"fiberloom: {option[0]}: goes with SDSS-V's positioners; leave it out\n"


def test_each_server_tells_its_report_in_its_own_words():
    report = {"time_s": 2.04, "runs": 3, "contacts": {"cobras": 1, "fiducials": 0}, "looks": 4}
    assert ServedCobras.told(None, report) == (
        "2.0 s of twin time: 3 RUNs; arms touched 1 times each other and 0 times a fiducial"
    )
    assert counts_text({"time_s": 2.5, "frames_in": 7, "happened": ["x"]}) == "time_s 2.5, frames_in 7"


@pytest.mark.parametrize("kind", [OpenedArray, OpenedDesi, OpenedCobras])
def test_no_array_outside_knows_the_truth(kind):
    assert issubclass(kind, OutsideArray)
    assert kind.true_plane is OutsideArray.true_plane
    assert kind.maps_file(None, 200) is None


def test_a_desi_array_keeps_what_it_is_told_to_know_apart():
    ours, others = (OpenedDesi(None, None, object(), "a") for _ in range(2))
    ours.know(Path("night.npz"))
    ours.keep(Path("kept.npz"))
    assert (ours.known_file, ours.kept_file) == (Path("night.npz"), Path("kept.npz"))
    assert (others.known_file, others.kept_file) == (None, None)
    assert ours.named() == {"bus": "opened", "camera": "a"}


@pytest.mark.parametrize(("instrument", "at"), [("lamost", "radio"), ("moons", "gateways")])
def test_units_that_hang_at_no_can_bus_are_not_looked_for_there(fl, tmp_path, instrument, at):
    """No frame of SDSS-V goes to motors of another kind."""
    targets = tmp_path / "t.csv"
    targets.write_text(TARGETS)
    words = ("observe", targets, "--instrument", instrument, "--positioners", 3, "--bus", "socketcan:can0")
    code, _, err = fl(*words, "--camera", "folder:images?trigger=true")
    assert code == 2
    assert f"--bus socketcan:can0: units of {instrument} are behind {at}://HOST[:PORT]" in err
