"""ImageBytes, the form in which Alpaca cameras send pixels (ASCOM, AlpacaImageBytes.pdf).

Eleven little-endian int32: version 1, error number, client's and server's transaction, start of the data,
element type of the image, element type as sent, rank, dimensions 1 to 3. Then the pixels as an array [x][y]:
y varies fastest, so that images of rows are transposed both ways. With an error, the data are its text.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np

from fiberloom.metrology.sources.errors import CameraRefused, ImageBroken
from fiberloom.typing import Array

CONTENT_TYPE = "application/imagebytes"
_HEADER = struct.Struct("<11i")
HEADER_BYTES = _HEADER.size
VERSION = 1
INT32, DOUBLE, UINT16 = 2, 3, 8
ELEMENTS = {
    1: "<i2", INT32: "<i4", DOUBLE: "<f8", 4: "<f4", 5: "<u8", 6: "u1", 7: "<i8", UINT16: "<u2", 9: "<u4",
}  # fmt: skip
"""Types of elements by their number."""


class ImageBytesHeader(NamedTuple):
    """The eleven numbers."""

    version: int = VERSION
    error: int = 0
    client: int = 0
    server: int = 0
    start: int = HEADER_BYTES
    image_element: int = INT32
    sent_element: int = UINT16
    rank: int = 2
    width: int = 0
    height: int = 0
    planes: int = 0


def pack(pixels: Array, client: int = 0, server: int = 0) -> tuple[bytes, memoryview]:
    """Header and data of an image (rows, columns): uint16 as it is, all else as doubles.

    `client` and `server`: numbers of the transaction, counts.
    """
    sixteen = pixels.dtype == np.uint16
    element = UINT16 if sixteen else DOUBLE
    columns = np.ascontiguousarray(pixels.T, dtype=ELEMENTS[element])
    header = ImageBytesHeader(
        client=client,
        server=server,
        image_element=INT32 if sixteen else DOUBLE,
        sent_element=element,
        width=columns.shape[0],
        height=columns.shape[1],
    )
    return _HEADER.pack(*header), columns.data.cast("B")


def unpack(data: bytes | bytearray | memoryview, camera: str = "camera") -> Array:
    """The image (rows, columns) of such bytes: uint16 where the numbers fit, else float32 or float64.

    Raises ImageBroken where the bytes are no whole image, CameraRefused where they are an error.
    """
    view = memoryview(data)
    if len(view) < HEADER_BYTES:
        raise ImageBroken(f"{camera}: an image of {len(view)} bytes, which is cut short: take another one")
    header = ImageBytesHeader(*_HEADER.unpack_from(view))
    if header.version != VERSION or not HEADER_BYTES <= header.start <= len(view):
        raise ImageBroken(f"{camera}: bytes that are no ImageBytes of version {VERSION}")
    if header.error:
        text = bytes(view[header.start :]).decode(errors="replace")
        raise CameraRefused(f"{camera}: error 0x{header.error & 0xFFFFFFFF:X} in place of an image: {text}")
    kind = ELEMENTS.get(header.sent_element)
    if header.rank != 2 or kind is None or header.width <= 0 or header.height <= 0:
        raise ImageBroken(
            f"{camera}: rank {header.rank}, {header.width} x {header.height}, elements of type "
            f"{header.sent_element}: no image in grey of two dimensions; set the camera to monochrome"
        )
    needed = header.width * header.height * np.dtype(kind).itemsize
    there = len(view) - header.start
    if there != needed:
        raise ImageBroken(
            f"{camera}: {there} of {needed} bytes of the image: cut short, or not what its header says; "
            "take another one"
        )
    columns = np.frombuffer(view, kind, header.width * header.height, header.start)
    return plain_pixels(columns.reshape(header.width, header.height).T)


def plain_pixels(pixels: Array) -> Array:
    """Numbers as images hold them: uint16 where they fit, else float32 or float64; contiguous rows."""
    kind = pixels.dtype
    if kind == np.uint16 or kind == np.uint8:
        return np.ascontiguousarray(pixels, dtype=np.uint16)
    if kind.kind == "f":
        return np.ascontiguousarray(pixels, dtype=np.float64 if kind.itemsize > 4 else np.float32)
    if pixels.size and pixels.min() >= 0 and pixels.max() <= np.iinfo(np.uint16).max:
        return np.ascontiguousarray(pixels, dtype=np.uint16)
    return np.ascontiguousarray(pixels, dtype=np.float64)
