"""Spots of DESI's own camera against DESI's own metrology (desimeter's test data, not in this tree)."""

import csv
import gzip

import numpy as np
import pytest

from fiberloom.metrology.acquisition import AcquisitionError, AcquisitionSettings, CameraGeometry, acquire
from fiberloom.metrology.transform import Distortion, fit_transform


@pytest.fixture(scope="module")
def folder(shared_desi):
    return shared_desi / "desimeter"


@pytest.fixture(scope="module")
def pinholes(folder):
    with gzip.open(folder / "fp-metrology.csv.gz", "rt") as file:
        rows = [r for r in csv.DictReader(file) if r["PINHOLE_ID"] not in ("", "0")]
    return {(int(r["LOCATION"]), int(r["PINHOLE_ID"])): (float(r["X_FP"]), float(r["Y_FP"])) for r in rows}


@pytest.fixture(scope="module")
def spots(folder):
    with open(folder / "test-spots.csv") as file:
        rows = list(csv.DictReader(file))
    px = np.array([(float(r["XPIX"]), float(r["YPIX"])) for r in rows])
    return px, [(int(r["LOCATION"]), int(r["PINHOLE_ID"])) for r in rows]


@pytest.fixture(scope="module")
def pairs(spots, pinholes):
    px, names = spots
    known = [k for k, name in enumerate(names) if name in pinholes]
    return px[known], np.array([pinholes[names[k]] for k in known])


def test_the_published_residual_is_reached(pairs):
    px, mm = pairs
    assert len(px) == 448
    fit = fit_transform(px, mm, Distortion(420.0), flipped=True)
    # desimeter with --zbfit: 22.6 um rms
    assert 22.0 < fit.rms_um < 23.0
    assert fit.leave_one_out_rms_um < 23.5


def test_more_terms_leave_less_and_not_by_chance(pairs):
    px, mm = pairs
    fit = fit_transform(px, mm, Distortion(420.0, range(33)), flipped=True)
    assert 14.5 < fit.rms_um < 15.5
    assert fit.leave_one_out_rms_um < 16.0


@pytest.mark.parametrize("turn", [0.0, 5.0, 73.0])
def test_fiducials_are_found_in_the_real_image_turned_by_any_angle(spots, pinholes, turn):
    px, names = spots
    seen = {name for name in names if name in pinholes}
    table = np.array([pinholes[name] for name in sorted(seen)])
    c, s = np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))
    turned = (px - 3000) @ np.array([[c, s], [-s, c]]) + 3000
    geometry = CameraGeometry(6000, 6000, 0.155, rotation_deg=180.0, flipped=True)
    settings = AcquisitionSettings(coarse_mm=6.0, radius_mm=420.0)
    found = acquire(turned, table, geometry, settings=settings)
    right = [names[k] == sorted(seen)[f] for f, k in zip(found.fiducial, found.spot, strict=True)]
    assert all(right)
    assert len(right) >= 440


def test_the_wrong_handedness_is_refused(spots, pinholes):
    px, names = spots
    table = np.array([pinholes[name] for name in sorted({n for n in names if n in pinholes})])
    geometry = CameraGeometry(6000, 6000, 0.155, flipped=False)
    with pytest.raises(AcquisitionError):
        acquire(px, table, geometry, settings=AcquisitionSettings(radius_mm=420.0))
