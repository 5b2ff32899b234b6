"""Parts of a run as bytes: numbers and texts by name, and arrays, each bit of them."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fiberloom.typing import Array

_HEAD = "head"


@dataclass(frozen=True, eq=False)
class RunPart:
    """One of the things that result files are made of."""

    head: dict[str, Any]
    """Whatever JSON can hold."""
    arrays: dict[str, Array]


def pack(head: Mapping[str, Any], arrays: Mapping[str, Array] | None = None) -> bytes:
    """A part as a compressed archive of numpy; `head`: what JSON can hold; `arrays`: not of objects."""
    text = np.frombuffer(json.dumps(dict(head)).encode(), dtype=np.uint8)
    packed = io.BytesIO()
    np.savez_compressed(packed, allow_pickle=False, **{_HEAD: text}, **dict(arrays or {}))
    return packed.getvalue()


def unpack(data: bytes) -> RunPart:
    """The part of these bytes."""
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    return RunPart(json.loads(arrays.pop(_HEAD).tobytes()), arrays)
