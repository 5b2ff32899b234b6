"""Images of cameras, as FITS holds them.

An uncompressed image of 16 bit integers with BZERO = 32768 (what every camera writes) or of 32 bit
floats is mapped into memory and its bytes are read as they lie in the file: no copy. Every other
kind (compressed, scaled, 8, 32 or 64 bits) goes through astropy into a float32 array, once.
"""

from __future__ import annotations

import datetime
import io
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from fiberloom.errors import InputError, one_line
from fiberloom.files import IMAGE_BYTES, PACKED, check_axes, read_bytes
from fiberloom.typing import Array
from fiberloom.wholefile import whole


@dataclass(frozen=True)
class CameraImage:
    """Pixels with what is known about them."""

    pixels: Array
    fits_bytes: bool = False
    """The pixels are the bytes of a FITS file: big-endian; uint16 with the sign bit as offset."""
    gain_e_adu: float = 1.0
    saturation_adu: float = np.inf
    exposure_s: float = 0.0
    time_s: float = 0.0
    header: Mapping[str, Any] = field(default_factory=dict)
    path: Path | None = None
    begun_utc_s: float | None = None
    """When the exposure began, in UTC seconds since 1970; None where the camera does not say."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, columns."""
        return self.pixels.shape

    def array(self) -> Array:
        """The pixels as numpy understands them: for plots. Copies where the bytes are FITS's."""
        if not self.fits_bytes:
            return self.pixels
        if self.pixels.dtype == np.uint16:
            return self.pixels.byteswap() ^ np.uint16(0x8000)
        return self.pixels.byteswap().view(np.float32)


GAIN_KEYS = ("GAIN", "EGAIN", "CCDGAIN")
SATURATION_KEYS = ("SATURATE", "SATLEVEL")


def read_image(
    path: str | Path,
    *,
    extension: int | str | None = None,
    gain_e_adu: float | None = None,
    saturation_adu: float | None = None,
) -> CameraImage:
    """The first image of the FITS file `path`, or the one of an `extension` (number or name).

    Gain and saturation come from `gain_e_adu` and `saturation_adu`, else from the header (GAIN,
    SATURATE), else 1 electron per unit, and the largest number that the pixels can hold. InputError
    where the file has no such image or is cut short.
    """
    from astropy.io import fits  # takes a third of a second: only where it is needed

    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        # one line says what is wrong: astropy's warnings would come beside it
        with (
            warnings.catch_warnings(action="ignore"),
            _opened(path) as file,
            fits.open(file, memmap=False) as hdus,
        ):
            hdu = _image_hdu(hdus, extension, path)
            _check_size(path, hdu)
            _check_whole(path, hdu)
            pixels, fits_bytes = _mapped(path, hdu), True
            if pixels is None:
                pixels, fits_bytes = _converted(hdu), False
            header = dict(hdu.header)
    except InputError:
        raise
    except Exception as error:  # astropy raises many kinds for a broken file
        raise InputError(f"{path}: cannot be read as FITS: {one_line(error)}") from None
    return CameraImage(
        pixels,
        fits_bytes,
        _first(gain_e_adu, header, GAIN_KEYS, 1.0, path),
        _first(saturation_adu, header, SATURATION_KEYS, _ceiling(pixels), path),
        _first(None, header, ("EXPTIME", "EXPOSURE"), 0.0, path),
        header=header,
        path=path,
        begun_utc_s=_begun_utc_s(header),
    )


def _opened(path: Path) -> BinaryIO:
    """The file, unpacked in memory where it is packed."""
    packed = path.suffix.lower() in PACKED
    file: BinaryIO = io.BytesIO(read_bytes(path, IMAGE_BYTES)) if packed else path.open("rb")
    try:
        check_axes(path, file)
    except BaseException:
        file.close()
        raise
    return file


def _check_size(path: Path, hdu: Any) -> None:
    rows, columns = hdu.shape
    if rows * columns > IMAGE_BYTES // 8:
        raise InputError(f"{path}: an image of {columns} x {rows} px is larger than any; the file is damaged")


_BEGUN_KEYS = ("DATE-BEG", "DATE-OBS")
_UNIX_MJD, _DAY_S = 40587.0, 86400.0


def _begun_utc_s(header: Mapping[str, Any]) -> float | None:
    """When the exposure began, as FITS files say it: with a date and a time of day, or as an MJD."""
    for key in _BEGUN_KEYS:
        text = header.get(key)
        if isinstance(text, str) and "T" in text and (at := utc_s_of(text)) is not None:
            return at
    for key in ("MJD-BEG", "MJD-OBS"):
        if isinstance(number := header.get(key), float):
            return (number - _UNIX_MJD) * _DAY_S
    return None


def utc_text(utc_s: float) -> str:
    """A time as FITS writes it, to the millisecond; `utc_s`: UTC in s since 1970."""
    at = datetime.datetime.fromtimestamp(utc_s, datetime.UTC)
    return at.replace(tzinfo=None).isoformat(timespec="milliseconds")


def utc_s_of(text: str) -> float | None:
    """UTC in s since 1970 of a time as FITS and Alpaca write it; None where it is no such text."""
    try:
        at = datetime.datetime.fromisoformat(text.strip().removesuffix("Z"))
    except ValueError:
        return None
    return (at if at.tzinfo else at.replace(tzinfo=datetime.UTC)).timestamp()


def _image_hdu(hdus: Any, extension: int | str | None, path: Path) -> Any:
    if extension is not None:
        try:
            hdu = hdus[extension]
        except (KeyError, IndexError):
            names = ", ".join(f"{i} {h.name}".strip() for i, h in enumerate(hdus))
            raise InputError(f"{path}: no extension {extension}; there are {names}") from None
        if getattr(hdu, "is_image", False) and len(hdu.shape) == 2:
            return hdu
        raise InputError(f"{path}: extension {extension} holds no image of two dimensions")
    for hdu in hdus:
        if getattr(hdu, "is_image", False) and len(hdu.shape) == 2:
            return hdu
    raise InputError(f"{path}: no image of two dimensions in any extension")


def _check_whole(path: Path, hdu: Any) -> None:
    """A copy that was interrupted is no image of a dark field."""
    if path.suffix.lower() in PACKED:
        return  # the unpacker complains
    needed, there = hdu._data_offset + hdu._data_size, path.stat().st_size
    if there < needed:
        raise InputError(f"{path}: is cut short: {there} of {needed} bytes; copy it again")


def trouble(image: CameraImage) -> str:
    """In words, why an image may show no spots."""
    pixels = image.array()
    good = np.isfinite(pixels) if pixels.dtype.kind == "f" else np.ones(1, dtype=bool)
    if not good.any():
        return "no pixel is a number"
    low, high = float(np.nanmin(pixels)), float(np.nanmax(pixels))
    if low == high:
        return f"every pixel is {low:g}: shutter closed, or all saturated, or not read out"
    saturated = int(np.count_nonzero(pixels >= image.saturation_adu))
    if saturated > 0.1 * pixels.size:
        return f"{100 * saturated / pixels.size:.0f} % of the pixels are saturated: is a light on?"
    if saturated:
        return f"{saturated} pixels are saturated: shorten the exposure"
    return "nothing exceeds the noise: is the back-illumination on?"


def _mapped(path: Path, hdu: Any) -> Array | None:
    """The bytes of an uncompressed image, if they are of a kind that is read in place."""
    header = hdu.header
    if type(hdu).__name__ == "CompImageHDU" or path.suffix.lower() in PACKED:
        return None
    scale, zero = hdu._orig_bscale, hdu._orig_bzero
    dtype: np.dtype[Any]
    if hdu._orig_bitpix == 16 and (scale, zero) == (1, 32768) and "BLANK" not in header:
        dtype = np.dtype(np.uint16)
    elif hdu._orig_bitpix == -32 and (scale, zero) == (1, 0):
        dtype = np.dtype(np.uint32)
    else:
        return None
    return np.memmap(path, dtype, "r", hdu._data_offset, tuple(hdu.shape))


def _converted(hdu: Any) -> Array:
    data = hdu.data
    if data.dtype.kind == "u" and data.dtype.itemsize == 2:
        return np.ascontiguousarray(data, dtype=np.uint16)
    return np.ascontiguousarray(data, dtype=np.float64 if data.dtype.itemsize > 4 else np.float32)


def _ceiling(pixels: Array) -> float:
    return 65535.0 if pixels.dtype == np.uint16 else np.inf


def _first(
    given: float | None, header: Mapping[str, Any], keys: tuple[str, ...], last: float, path: Path
) -> float:
    if given is not None:
        return given
    for key in keys:
        if key in header:
            try:
                return float(header[key])
            except (TypeError, ValueError):
                raise InputError(f"{path}: {key} = {header[key]!r} is not a number") from None
    return last


def write_image(image: CameraImage, path: str | Path, *, overwrite: bool = True) -> None:
    """An uncompressed FITS file with the image's header."""
    from astropy.io import fits

    hdu = fits.PrimaryHDU(image.array())
    for key, value in image.header.items():
        hdu.header[key] = value
    hdu.header["EXPTIME"] = (image.exposure_s, "[s]")
    if image.begun_utc_s is not None:
        hdu.header["DATE-OBS"] = (utc_text(image.begun_utc_s), "UTC, begin of the exposure")
    hdu.header["GAIN"] = (image.gain_e_adu, "[electron/adu]")
    if np.isfinite(image.saturation_adu):
        hdu.header["SATURATE"] = (image.saturation_adu, "[adu]")
    if not overwrite and Path(path).exists():
        raise InputError(f"{path}: exists already")
    with whole(path) as part:
        hdu.writeto(part)
