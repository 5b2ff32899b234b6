"""A mark that changes with any number of an instrument or a layout."""

import hashlib
from collections.abc import Iterable
from typing import Any

import numpy as np

from fiberloom.typing import Array


def mark_of(text: str, arrays: Iterable[tuple[str, Any]]) -> str:
    """16 hex digits of a text and of arrays, in their order; what is no array is passed over."""
    digest = hashlib.sha256(text.encode())
    for name, values in arrays:
        if isinstance(values, np.ndarray):
            _feed(digest, name, values)
    return digest.hexdigest()[:16]


def _feed(digest: "hashlib._Hash", name: str, values: Array) -> None:
    # rounded to 1e-9 so that deg in a file and back is the same; adding 0.0 makes -0.0 to 0.0
    plain = np.ascontiguousarray(values.round(9) + 0.0 if values.dtype.kind == "f" else values)
    digest.update(name.encode())
    if plain.dtype.kind == "U":
        digest.update("\0".join(plain).encode())
    else:
        digest.update(plain.astype(plain.dtype.newbyteorder("<")).tobytes())
