"""Is a FITS file complete? Its own headers say, so that a file in the writing is not taken for an image.

A file is a sequence of units: a header of 2880-byte blocks up to the card END, then data of

    |BITPIX| / 8 * GCOUNT * (PCOUNT + NAXIS1 * NAXIS2 * ...)   bytes (FITS 4.0, Eq. 2)

filled up to a block.
"""

from __future__ import annotations

import gzip
import os
import zlib
from pathlib import Path
from typing import BinaryIO

BLOCK_BYTES, CARD_BYTES = 2880, 80
_HEADER_BLOCKS = 1000
"""A longer header is none."""
_UNITS = 10_000


class FitsIncomplete(Exception):
    """More may come: in words, what is missing."""


class FitsForeign(Exception):
    """No FITS file, whatever comes."""


def check_complete(path: Path) -> None:
    """Raises FitsIncomplete or FitsForeign; OSError where the file cannot be read."""
    if path.suffix == ".gz":
        _check_packed(path)
        return
    with path.open("rb") as file:
        _check_units(file, os.fstat(file.fileno()).st_size)


def _check_packed(path: Path) -> None:
    """Unpacks: the sum at the end says whether it is whole."""
    n = 0
    try:
        with gzip.open(path, "rb") as file:
            while piece := file.read(1 << 20):
                n += len(piece)
        with gzip.open(path, "rb") as file:
            _check_units(file, n)
    except EOFError:
        raise FitsIncomplete(f"packed and cut short after {n} bytes") from None
    except (gzip.BadGzipFile, zlib.error) as error:
        raise FitsForeign(f"no gzip file: {error}") from None


def _check_units(file: BinaryIO | gzip.GzipFile, size: int) -> None:
    at = 0
    for _ in range(_UNITS):
        start, data_bytes = _header(file, at, size)
        at = start + data_bytes + -data_bytes % BLOCK_BYTES
        if at > size:
            raise FitsIncomplete(f"{size} of {at} bytes")
        if at == size:
            return
        file.seek(at)
        if not file.read(CARD_BYTES).strip(b"\0 "):  # special records, filled with nothing
            return
    raise FitsForeign(f"more than {_UNITS} units")


def _header(file: BinaryIO | gzip.GzipFile, at: int, size: int) -> tuple[int, int]:
    """Where the data of the unit at `at` begin, and how many bytes they have."""
    cards: dict[str, str] = {}
    for block in range(_HEADER_BLOCKS):
        begin = at + block * BLOCK_BYTES
        file.seek(begin)
        data = file.read(BLOCK_BYTES)
        if block == 0:
            _check_first(data, first=at == 0)
        for place in range(0, len(data) - CARD_BYTES + 1, CARD_BYTES):
            card = data[place : place + CARD_BYTES]
            if card.rstrip() == b"END":
                return begin + BLOCK_BYTES, _data_bytes(cards)
            key, separator, value = card.decode("latin-1").partition("= ")
            if separator:
                cards.setdefault(key.strip(), value.split("/")[0].strip())
        if len(data) < BLOCK_BYTES:
            raise FitsIncomplete(f"{size} bytes, the header has not ended")
    raise FitsForeign("a header without an end")


def _check_first(data: bytes, first: bool) -> None:
    wanted = b"SIMPLE  =" if first else b"XTENSION="
    if len(data) >= len(wanted) and not data.startswith(wanted):
        raise FitsForeign(f"it begins with {data[:9]!r}, not with {wanted!r}")


def _data_bytes(cards: dict[str, str]) -> int:
    try:
        axes = int(cards["NAXIS"])
        sides = [int(cards[f"NAXIS{k}"]) for k in range(1, axes + 1)]
        bits = abs(int(cards["BITPIX"]))
        groups, parameters = int(cards.get("GCOUNT", "1")), int(cards.get("PCOUNT", "0"))
    except (KeyError, ValueError) as error:
        raise FitsForeign(f"a header without a number for {error}") from None
    if not 0 <= axes < 1000 or min([*sides, groups, parameters, bits], default=0) < 0:
        raise FitsForeign("a header with sides below 0")
    if not axes:
        return 0
    if axes > 1 and sides[0] == 0:  # random groups
        sides = sides[1:]
    n = 1
    for side in sides:
        n *= side
    return bits // 8 * groups * (parameters + n)
