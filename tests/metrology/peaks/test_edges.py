"""Spots that the edge cuts off, in every type of pixels; profiles that make no sense away from the middle."""

import numpy as np
import pytest
from scenes import light

from fiberloom._core import metrology
from fiberloom.metrology import Flag

CAMERA = metrology.Settings(1.0, 6e4, 6.0, 0.0)
WIDTH, HEIGHT = 330, 290
SKY = [100.0, 0.0, 0.0]
DETECTOR = [1.0, 5.0, 300.0, 1e9]
X, Y, VAR_X, VAR_Y = 0, 1, 2, 4
TYPES = {
    "u16": (lambda adu: adu, False),
    "f32": (lambda adu: adu.astype(np.float32), False),
    "f64": (lambda adu: adu.astype(np.float64), False),
    "u16 of FITS": (lambda adu: (adu ^ np.uint16(0x8000)).byteswap(), True),
    "f32 of FITS": (lambda adu: adu.astype(np.float32).view(np.uint32).byteswap(), True),
}


def exposed(xy, fwhm_px, peak=2e4, seed=5):
    """A frame of equal round spots."""
    s = (fwhm_px / 2.3548200450309493) ** 2
    spots = np.column_stack([xy, np.tile([2 * np.pi * s * peak, s, 0.0, s, 0.0], (len(xy), 1))])
    return metrology.expose(light(spots, "gaussian", (HEIGHT, WIDTH)), SKY, DETECTOR, seed)


def grid(step_px, edge_px):
    x, y = np.meshgrid(
        np.arange(edge_px, WIDTH - edge_px, step_px), np.arange(edge_px, HEIGHT - edge_px, step_px)
    )
    return np.column_stack([x.ravel(), y.ravel()]) + 0.3


def nearest(table, xy):
    """Rows of the table nearest to places, and how far they are off in px."""
    away = np.hypot(*(table[0][None, :, :2] - np.asarray(xy)[:, None]).transpose(2, 0, 1))
    return away.argmin(axis=1), away.min(axis=1)


def at_edges(off_px):
    """Places by every edge and in every corner, that far inside the outermost pixel."""
    right, low = WIDTH - 1 - off_px, HEIGHT - 1 - off_px
    middle = [[off_px, 140.2], [right, 141.4], [160.3, off_px], [161.2, low]]
    return np.array([*middle, [off_px, off_px], [right, off_px], [off_px, low], [right, low]])


@pytest.mark.parametrize("fwhm_px", [4.0, 12.0])
@pytest.mark.parametrize("name", TYPES)
def test_half_cut_spots_are_marked_and_lie_where_they_are(name, fwhm_px):
    convert, fits = TYPES[name]
    cut, whole = at_edges(1.4), grid(14 * fwhm_px / 3, 6 * fwhm_px)
    frame = exposed(np.vstack([cut, whole]), fwhm_px)
    table = metrology.find_spots(convert(frame), fits, CAMERA, np.zeros(0))
    rows, off = nearest(table, cut)
    assert len(set(rows)) == len(cut)
    assert (table[1][rows] & int(Flag.TRUNCATED)).all()
    errors = np.sqrt(table[0][rows, VAR_X] + table[0][rows, VAR_Y])
    assert (off < 5 * errors).all()
    inner, inner_off = nearest(table, whole)
    assert inner_off.max() < 0.05
    # a quarter of a spot tells less than all of it
    assert errors[4:].min() > np.sqrt(table[0][inner, VAR_X] + table[0][inner, VAR_Y]).max()
    assert not (table[1][inner] & int(Flag.TRUNCATED)).any()


def profile_with(shape, flat_top=0.0):
    """A profile of a Gaussian whose second moments are polynomials: (3, 15), half sizes 100 px."""
    moments = np.zeros((3, 15))
    for (component, term), value in shape.items():
        moments[component, term] = value
    return np.concatenate([[0, 1, 0, 0, 0, 0], moments.ravel(), [flat_top, 100.0, 100.0, 0.01, 50]])


ROUND = {(0, 0): 4.0, (2, 0): 4.0}
CONSTANT, ALONG_X = 0, 1


@pytest.mark.parametrize(
    "change",
    [
        {(0, ALONG_X): -5.0},  # S_xx = 4 - 5 u: below zero at the right edge
        {(2, ALONG_X): -5.0},
        {(1, ALONG_X): 4.5},  # a covariance beyond the product of the widths
    ],
)
def test_a_profile_that_makes_no_sense_at_an_edge_is_that_of_the_middle_there(change):
    profile = profile_with(ROUND | change)
    places = np.array([[100.0, 100.0], [199.0, 100.0], [150.0, 100.0]])
    (fwhm,) = metrology.fwhm(profile, places)
    middle = 2.3548200450309493 * 2.0
    np.testing.assert_allclose(fwhm[:2], middle, rtol=1e-6)
    # half way there it still makes sense, and is followed: the root of the area of the ellipse
    xx, xy, yy = (ROUND.get((k, 0), 0.0) + 0.5 * change.get((k, ALONG_X), 0.0) for k in range(3))
    assert fwhm[2] == pytest.approx(2.3548200450309493 * (xx * yy - xy**2) ** 0.25, rel=1e-6)


def test_the_width_of_a_flat_top():
    profile = profile_with(ROUND, flat_top=1.0)
    # exp(-q^2 / 4) falls to one half at q = 2 sqrt(ln 2), at the radius sqrt(q) times 2 px
    (fwhm,) = metrology.fwhm(profile, np.array([[20.0, 30.0]]))
    assert fwhm[0] == pytest.approx(2 * 2.0 * np.sqrt(2 * np.sqrt(np.log(2))), rel=1e-6)
