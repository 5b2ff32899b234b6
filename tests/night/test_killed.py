"""A night whose process is killed (-9) at a few instants ends as one that was never disturbed."""

import pytest
from benchmarks.night.killed import Scene, killed_night, write_queue

import fiberloom as fl
from fiberloom.calibration.transmission.cache import load_for
from fiberloom.twin import draw_units


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("killed")
    plane = fl.FocalPlane.of("sdssv", n=7)
    field = fl.Field.twin(plane, camera="noise")
    field.run.calibrate().save(folder / "maps.npz")
    assert len(load_for(plane, folder / "maps.npz")) == 7
    made = Scene(plane, draw_units(plane, 0), folder / "maps.npz", folder, exposure_s=60.0)
    write_queue(made, fields=2)
    return made


@pytest.mark.slow
def test_nothing_is_lost_doubled_or_touched(scene):
    account = killed_night(scene, kills=4, seed=2, turns=(1, 2, 1))
    assert account.kills == 4
    assert account.kills_exposing > 0
    assert account.exposures_done == account.exposures_asked == account.openings == 4
    assert (account.lost, account.doubled, account.not_still, account.off_target) == (0, 0, 0, 0)
    assert (account.images_lost, account.contacts, account.store_faults) == (0, 0, 0)
    assert account.status == "finished"
    assert account.ok
