"""Files that people and other programs wrote, read within bounds: text, packed files, TOML, JSON, FITS.

A file that is damaged, endless or nested without end is one InputError with its name, never a traceback,
and takes no more memory than a bound says.
"""

from __future__ import annotations

import bz2
import gzip
import json
import lzma
import os
import tomllib
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

from fiberloom.errors import InputError, one_line

MB = 1 << 20
TEXT_BYTES = 256 * MB
"""The largest table, list of targets or trajectories that is read. A field of 5000 positioners has 1 MB."""
IMAGE_BYTES = 4096 * MB
"""The largest image. One of 150 megapixels in 64 bits has 1200 MB."""
LAST_PORT = 65535
"""Of TCP, as addresses name it."""

_UNPACKERS: dict[str, Any] = {".gz": gzip.GzipFile, ".bz2": bz2.BZ2File, ".xz": lzma.LZMAFile}
PACKED = tuple(_UNPACKERS)
"""Suffixes of files that are unpacked while they are read."""
_PIECE = 4 * MB
_FITS_BLOCK, _FITS_CARD, _FITS_BLOCKS, _FITS_AXES = 2880, 80, 1000, 999


def read_bytes(path: Path, most: int = TEXT_BYTES) -> bytes:
    """The content of a file, unpacked by the suffix of its name.

    `most`: bytes; InputError for a longer one, one that is damaged, and one that cannot be read.
    """
    unpacker = _UNPACKERS.get(path.suffix.lower())
    pieces, n = [], 0
    try:
        with path.open("rb") if unpacker is None else unpacker(path) as file:
            while piece := file.read(_PIECE):
                pieces.append(piece)
                n += len(piece)
                if n > most:
                    packed = "" if unpacker is None else " when it is unpacked"
                    raise InputError(f"{path}: is larger than {most // MB} MB{packed}; what is it?")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (zlib.error, lzma.LZMAError, EOFError, gzip.BadGzipFile) as error:
        raise InputError(f"{path}: cannot be unpacked ({error}); copy it again") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    return b"".join(pieces)


def read_text(path: Path, most: int = TEXT_BYTES) -> str:
    """The text of a file in UTF-8, with or without a mark at its begin; bounds as `read_bytes`."""
    try:
        return read_bytes(path, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file (UTF-8; byte {error.start} is none)") from None


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """The tables of a TOML file; `where` names it in errors."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{where}: not valid TOML: nested too deeply") from None
    except ValueError as error:  # also numbers that are longer than Python reads
        raise InputError(f"{where}: not valid TOML: {one_line(error)}") from None


def parse_json(text: str, where: str) -> Any:
    """The value of a JSON text; `where` names it in errors."""
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        place = f"line {error.lineno}, column {error.colno}"
        raise InputError(f"{where}, {place}: not JSON ({error.msg})") from None
    except RecursionError:
        raise InputError(f"{where}: not JSON (nested too deeply)") from None
    except ValueError as error:  # numbers that are longer than Python reads
        raise InputError(f"{where}: not JSON ({one_line(error)})") from None


def check_zip(path: Path, most: int = TEXT_BYTES) -> None:
    """Raises InputError for a zip file (.npz) whose members are larger than `most` bytes together."""
    with zipfile.ZipFile(path) as file:
        n = sum(member.file_size for member in file.infolist())
    if n > most:
        raise InputError(f"{path}: is larger than {most // MB} MB when it is unpacked; what is it?")


def check_axes(path: Path, file: IO[bytes]) -> None:
    """Raises InputError for a FITS file with more axes than there are, on which readers spend hours.

    `path` names it; `file` is read from its begin, and is there again afterwards.
    """
    file.seek(0, os.SEEK_END)
    size, at = file.tell(), 0
    while at < size:
        at = _after_unit(path, file, at, size)
    file.seek(0)


def _after_unit(path: Path, file: IO[bytes], at: int, size: int) -> int:
    """Where the next header begins; the end where this one is none: others say what is wrong."""
    cards = _cards(file, at)
    try:
        axes, bits = int(cards[b"NAXIS"]), abs(int(cards[b"BITPIX"]))
        if not 0 <= axes <= _FITS_AXES:
            raise InputError(
                f"{path}: NAXIS = {axes}: FITS has at most {_FITS_AXES} axes; the file is damaged"
            )
        n = 1
        for k in range(1, axes + 1):
            n *= int(cards[b"NAXIS%d" % k])
        n = (n if axes else 0) + int(cards.get(b"PCOUNT", b"0"))
        data = bits // 8 * n * int(cards.get(b"GCOUNT", b"1"))
        begin = at + int(cards[b"END"])
    except InputError:
        raise
    except (KeyError, ValueError):
        return size
    return size if data < 0 else begin + data + -data % _FITS_BLOCK


def _cards(file: IO[bytes], at: int) -> dict[bytes, bytes]:
    """Keys and values of the header at a place of the file, and under END how long it is."""
    cards: dict[bytes, bytes] = {}
    file.seek(at)
    for block in range(1, _FITS_BLOCKS):
        data = file.read(_FITS_BLOCK)
        for k in range(0, len(data), _FITS_CARD):
            key, _, value = data[k : k + _FITS_CARD].partition(b"= ")
            if key.rstrip() == b"END":
                return cards | {b"END": b"%d" % (block * _FITS_BLOCK)}
            cards.setdefault(key.rstrip(), value.split(b"/")[0].strip())
        if len(data) < _FITS_BLOCK:
            break
    return cards


def shown(value: object, most: int = 60) -> str:
    """A value as in Python, for an error: not without end, whatever it is."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # a number of thousands of digits, a list in a list in a list
        return f"a {type(value).__name__} too large to show"
    return text if len(text) <= most else f"{text[:most]} ..."


def tcp_port(text: str, last: int = LAST_PORT) -> int | None:
    """The port that a text of ASCII digits names, 1 to `last`; None for any other text.

    >>> tcp_port("4700"), tcp_port("0"), tcp_port("²")
    (4700, None, None)
    """
    if not (text.isascii() and text.isdecimal() and len(text) <= len(str(LAST_PORT))):
        return None
    number = int(text)
    return number if 0 < number <= last else None


def host_and_port(text: str, what: str, default: int, last: int = LAST_PORT) -> tuple[str, int]:
    """Host and port of `text`, HOST or HOST:PORT; without a port the `default`, and at most `last`.

    InputError for anything else, in the name of `what` is there.

    >>> host_and_port("10.1.10.5", "radio", 4900)
    ('10.1.10.5', 4900)
    """
    host, _, told = text.partition(":")
    port = tcp_port(told, last) if told else default
    if not host or port is None:
        raise InputError(f"{what} '{text}': expected HOST or HOST:PORT with a port 1 to {last}")
    return host, port
