"""A FITS file is complete, or it is named what is missing: for every cut, and for any bytes."""

import gzip

import numpy as np
import pytest
from astropy.io import fits
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fiberloom.metrology.sources.fits import FitsForeign, FitsIncomplete, check_complete

BLOCK = 2880


def plain(path):
    fits.PrimaryHDU(np.arange(5000, dtype=np.uint16).reshape(50, 100)).writeto(path)


def two_units(path):
    image = fits.ImageHDU(np.ones((30, 40), np.float32))
    fits.HDUList([fits.PrimaryHDU(), image]).writeto(path)


def packed_tiles(path):
    fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(np.arange(4000.0).reshape(50, 80))]).writeto(path)


def table(path):
    fits.BinTableHDU.from_columns([fits.Column("a", "E", array=np.arange(7.0))]).writeto(path)


KINDS = pytest.mark.parametrize("write", [plain, two_units, packed_tiles, table])


@KINDS
def test_whole_files_pass_and_every_cut_is_incomplete(write, tmp_path):
    whole = tmp_path / "whole.fits"
    write(whole)
    check_complete(whole)
    data = whole.read_bytes()
    with fits.open(whole) as hdus:
        needed = len(data)
        ends = [h._data_offset + h._data_size for h in hdus]  # a file may end here
    cut = tmp_path / "cut.fits"
    sizes = {0, 1, 79, 80, 2879, 2880, 2881, needed - 1, *range(0, needed, 1237)} - set(ends)
    for size in sorted(s for s in sizes if s < needed):
        cut.write_bytes(data[:size])
        with pytest.raises(FitsIncomplete):
            check_complete(cut)


def test_gzip_is_unpacked(tmp_path):
    plain(tmp_path / "a.fits")
    data = gzip.compress((tmp_path / "a.fits").read_bytes())
    path = tmp_path / "a.fits.gz"
    path.write_bytes(data)
    check_complete(path)
    for size in (0, 5, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:size])
        with pytest.raises(FitsIncomplete):
            check_complete(path)
    path.write_bytes(b"no gzip at all")
    with pytest.raises(FitsForeign):
        check_complete(path)


@pytest.mark.parametrize(
    "data",
    [
        b"<html>" + b" " * 3000,
        b"SIMPLE  = T".ljust(80) + b"END".ljust(2800),
        b"SIMPLE  = T".ljust(80) + b"NAXIS   = -1".ljust(80) + b"BITPIX  = 8".ljust(80) + b"END".ljust(2640),
        b"SIMPLE  = T".ljust(80) + b"NAXIS   = x".ljust(80) + b"END".ljust(2720),
    ],
)
def test_what_is_no_fits(data, tmp_path):
    (tmp_path / "a.fits").write_bytes(data)
    with pytest.raises(FitsForeign):
        check_complete(tmp_path / "a.fits")


CARDS = st.sampled_from(
    b"NAXIS   = 2;NAXIS1  = 10;NAXIS2  =  99999999999;BITPIX  = 16;END;NAXIS   = 3;GCOUNT  = -4;PCOUNT  = 7;"
    b"NAXIS3  = 0;BITPIX  = -64;COMMENT x;".split(b";")
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.binary(max_size=200)
    | st.tuples(st.lists(CARDS, max_size=12), st.binary(max_size=100)).map(
        lambda t: b"".join(c.ljust(80) for c in [b"SIMPLE  =  T", *t[0]]) + t[1]
    )
)
def test_any_bytes_are_whole_incomplete_or_foreign(tmp_path, data):
    path = tmp_path / "any.fits"
    for size in (len(data), -(-len(data) // BLOCK) * BLOCK):
        path.write_bytes(data.ljust(size))
        try:
            check_complete(path)
        except (FitsIncomplete, FitsForeign):
            continue
