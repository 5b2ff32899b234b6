"""What one night has taught the next one begins with: blind moves get better from night to night."""

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.drive.desi import PLANETARY
from fiberloom.drive.desi.maps.kept import kept_file, read_maps
from fiberloom.errors import InputError
from fiberloom.targets.generate import random_targets

N = 60
PLANE = fl.FocalPlane.of("desi", seed=0, n=N)


def night(number, calibration, **how):
    """A field of a process of its own: the blind move's true rms in um, and its source."""
    field = fl.Field.twin(PLANE, seed=0, camera="noise", calibration=calibration)
    seen = field.run.observe(random_targets(PLANE, 2 * N, seed=number), corrections=1, **how)
    return seen.summary()["moves"][0]["true_rms_um"], field


def test_blind_moves_profit_from_the_nights_before(tmp_path):
    file = tmp_path / "maps.npz"
    first, *_, last = [night(k, file, adapt=True)[0] for k in range(6)]
    assert last < 0.7 * first
    # without the file nothing is known
    assert night(5, None)[0] > 0.8 * first


def test_a_file_that_is_only_read_stays_as_it_is(tmp_path):
    file = tmp_path / "maps.npz"
    _, field = night(0, file, adapt=True)
    before = file.read_bytes()
    taught = field.source.hardware.drive.maps
    _, field = night(1, file)
    assert file.read_bytes() == before
    np.testing.assert_array_equal(read_maps(file, PLANE, PLANETARY).mean, taught.mean)
    assert not np.array_equal(field.source.hardware.drive.maps.mean, taught.mean)


def test_without_a_name_the_file_of_this_layout_and_seed_is_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("FIBERLOOM_CACHE", str(tmp_path))
    night(0, None, adapt=True)
    assert kept_file(PLANE, 0).is_file()
    assert kept_file(PLANE, 1) != kept_file(PLANE, 0)
    assert kept_file(PLANE.select(np.arange(N - 1)), 0) != kept_file(PLANE, 0)


def test_what_cannot_be_kept_is_told(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        night(0, tmp_path / "none.npz")
    with pytest.raises(InputError, match="--learnt: these motors keep"):
        night(0, None, adapt=True, learnt=str(tmp_path / "store.sqlite"))
