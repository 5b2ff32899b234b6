"""The real array of Apache Point against the survey's own coordinates."""

import numpy as np
import pytest

from fiberloom.instruments import read_layout
from fiberloom.targets.yanny import read_yanny


@pytest.fixture(scope="module")
def real(shared_sdssv, sdssv):
    return read_layout(shared_sdssv / "apo_2024.04.01", sdssv)


@pytest.fixture(scope="module")
def fibermap(shared_sdssv):
    rows = read_yanny(shared_sdssv / "confSummary-test.par.gz").rows["FIBERMAP"]
    return [r for r in rows if r["valid"] == "1"]


def column(rows, *names):
    return np.array([[float(r[n]) for n in names] for r in rows])


@pytest.mark.parametrize(("fibre", "n"), [("metrology", 490), ("BOSS", 490), ("APOGEE", 291)])
def test_every_valid_fibre_is_where_the_survey_puts_it(real, fibermap, fibre, n):
    rows = [r for r in fibermap if r["fiberType"].lower() == fibre.lower()]
    index = real.index_of(column(rows, "positionerId")[:, 0])
    # the file has nominal APOGEE places for positioners without that fibre too
    has = real.carries(fibre)[index]
    assert has.sum() == n
    index, rows = index[has], [r for r, h in zip(rows, has, strict=True) if h]
    angles, xy = column(rows, "alpha", "beta"), column(rows, "xwok", "ywok")
    error = np.linalg.norm(real.forward(*angles.T, fibre, index) - xy, axis=1)
    # the file has angles as 4-byte floats: 1.5e-5 deg at 22 mm are 6 nm
    assert error.max() < 10e-6
    found = real.inverse(xy, fibre, index)
    assert found.reachable.all()
    # the same rounding, larger where the arm is nearly stretched
    np.testing.assert_allclose(found.alpha_deg, angles[:, 0], atol=5e-5)
    np.testing.assert_allclose(found.beta_deg, angles[:, 1], atol=5e-5)


def test_the_fibres_that_the_holes_promise(real):
    assert real.n == 500
    assert real.carries("APOGEE").sum() == 298
    assert len(real.fiducials) == 60
    assert len(real.guide_cameras) == 6
