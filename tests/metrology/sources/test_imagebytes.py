"""ImageBytes: what is packed is unpacked; whatever comes, there is an image or a named error."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fiberloom.metrology.sources import imagebytes
from fiberloom.metrology.sources.errors import CameraError, CameraRefused, ImageBroken

SHAPES = hnp.array_shapes(min_dims=2, max_dims=2, max_side=9)
IMAGE = np.arange(12, dtype=np.uint16).reshape(3, 4)  # three rows of four


def packed(pixels=IMAGE):
    return b"".join(imagebytes.pack(pixels, 7, 8))


def with_number(place, number):
    """The packed image with one of its eleven numbers changed."""
    data = bytearray(packed())
    struct.pack_into("<i", data, 4 * place, number)
    return bytes(data)


@given(hnp.arrays(np.uint16, SHAPES) | hnp.arrays(np.float64, SHAPES, elements={"allow_nan": False}))
def test_what_is_packed_is_unpacked(pixels):
    back = imagebytes.unpack(packed(pixels))
    assert back.flags.c_contiguous
    assert back.dtype == pixels.dtype
    np.testing.assert_array_equal(back, pixels)


def test_the_header_and_the_order_of_the_standard():
    data = packed()
    assert struct.unpack_from("<11i", data) == (1, 0, 7, 8, 44, 2, 8, 2, 4, 3, 0)
    # array [x][y], y fastest: the first column from top to bottom comes first
    assert struct.unpack_from("<4H", data, 44) == (0, 4, 8, 1)


@pytest.mark.parametrize(("number", "kind"), imagebytes.ELEMENTS.items())
def test_every_type_of_element(number, kind):
    columns = np.arange(6).reshape(3, 2).astype(kind)
    data = struct.pack("<11i", 1, 0, 0, 0, 44, 2, number, 2, 3, 2, 0) + columns.tobytes()
    back = imagebytes.unpack(data)
    np.testing.assert_array_equal(back, [[0, 2, 4], [1, 3, 5]])
    assert back.dtype == (np.dtype(kind).newbyteorder("=") if kind in ("<f4", "<f8") else np.uint16)


def test_numbers_beyond_sixteen_bits_are_kept():
    columns = np.array([[-1, 70000]], dtype="<i4")
    data = struct.pack("<11i", 1, 0, 0, 0, 44, 2, 2, 2, 1, 2, 0) + columns.tobytes()
    np.testing.assert_array_equal(imagebytes.unpack(data), [[-1.0], [70000.0]])


def test_data_may_begin_later():
    data = bytearray(packed())
    data[44:44] = b"\xff" * 20
    struct.pack_into("<i", data, 16, 64)
    np.testing.assert_array_equal(imagebytes.unpack(data), IMAGE)


@pytest.mark.parametrize("n", [0, 1, 43, 44, 45, len(packed()) - 1])
def test_every_cut_is_named(n):
    with pytest.raises(ImageBroken, match=r"cam: .*(cut short)"):
        imagebytes.unpack(packed()[:n], "cam")


def test_bytes_behind_the_image_are_refused():
    with pytest.raises(ImageBroken, match="25 of 24 bytes"):
        imagebytes.unpack(packed() + b"x")


@pytest.mark.parametrize(
    ("place", "number"),
    [(0, 2), (4, 43), (4, -1), (4, 1 << 30), (6, 0), (6, 77), (7, 3), (8, 0), (8, -4), (9, 1 << 30), (9, 0)],
)
def test_headers_that_make_no_sense(place, number):
    with pytest.raises(ImageBroken):
        imagebytes.unpack(with_number(place, number))


def test_an_error_in_place_of_an_image():
    with pytest.raises(CameraRefused, match=r"cam: error 0x40B .*: no image is ready"):
        imagebytes.unpack(struct.pack("<11i", 1, 0x40B, 0, 0, 44, *[0] * 6) + b"no image is ready", "cam")


HEADERS = st.tuples(*[st.integers(-3, 12) | st.sampled_from([44, 48, -(2**31), 2**31 - 1])] * 11)


@given(HEADERS.map(lambda numbers: struct.pack("<11i", *numbers)), st.binary(max_size=200))
def test_whatever_comes_there_is_an_image_or_a_named_error(header, rest):
    try:
        pixels = imagebytes.unpack(header + rest)
    except CameraError:
        return
    assert pixels.ndim == 2
    assert pixels.size
