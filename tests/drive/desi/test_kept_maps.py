"""What was learnt comes back by positioner; files that are not of this basis are refused in one line."""

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.drive.desi import PLANETARY, SMOOTH, LearnedMaps
from fiberloom.drive.desi.maps.kept import read_maps, save_maps
from fiberloom.errors import InputError

PLANE = fl.FocalPlane.of("desi", seed=0, n=12)


@pytest.fixture
def taught(tmp_path):
    maps = LearnedMaps(PLANE, np.tile([10.0, 90.0], (12, 1)))
    rng = np.random.default_rng(0)
    for _ in range(5):
        maps.believed_deg = rng.uniform([-150, 20], [150, 160], (12, 2))
        off = rng.normal(0.0, 0.3, (12, 2))
        maps.see(PLANE.forward(*(maps.believed_deg + off).T), 0.003, np.ones(12, dtype=bool))
    save_maps(maps, tmp_path / "new" / "maps.npz")
    return maps, tmp_path / "new" / "maps.npz"


def test_maps_come_back(taught):
    maps, path = taught
    back = read_maps(path, PLANE, PLANETARY)
    for name in ("believed_deg", "mean", "covariance", "surprises"):
        np.testing.assert_array_equal(getattr(back, name), getattr(maps, name))


def test_units_are_found_by_number(taught):
    maps, path = taught
    other = PLANE.select([7, 3])
    back = read_maps(path, other, PLANETARY)
    np.testing.assert_array_equal(back.mean, maps.mean[[7, 3]])
    new = fl.FocalPlane.of("desi", seed=0, n=14)
    back = read_maps(path, new, PLANETARY)
    fresh = ~np.isin(new.positioner_id, PLANE.positioner_id)
    assert fresh.sum() >= 2
    assert not back.mean[fresh].any()


def test_another_basis_is_refused(taught):
    with pytest.raises(InputError, match="other waves"):
        read_maps(taught[1], PLANE, SMOOTH)


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04 half of a zip", b"hello"])
def test_other_files_are_refused(tmp_path, data):
    path = tmp_path / "maps.npz"
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"maps\.npz: no file of learnt maps"):
        read_maps(path, PLANE, PLANETARY)
    with pytest.raises(InputError, match="No such file"):
        read_maps(tmp_path / "none.npz", PLANE, PLANETARY)


def test_numbers_that_are_none_are_refused(taught):
    maps, path = taught
    maps.mean[0, 0] = np.nan
    save_maps(maps, path)
    with pytest.raises(InputError, match="not finite"):
        read_maps(path, PLANE, PLANETARY)
