"""The cut-outs of the last image, kept beside the store: they are there when a service begins anew."""

from __future__ import annotations

import logging
import zipfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fiberloom.errors import InputError, one_line
from fiberloom.files import check_zip, read_bytes
from fiberloom.metrology.transform import FieldTransform, Similarity
from fiberloom.service.stamps import Stamps
from fiberloom.store.parts import RunPart, pack, unpack
from fiberloom.typing import Floats
from fiberloom.wholefile import whole

FILE = "last-image.npz"
MOST_BYTES = 64 * 2**20
"""Of 5000 cut-outs: 11 MB before they are packed."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class KeptImage:
    """What is shown of an image of N positioners."""

    stamps: Stamps
    goal_mm: Floats
    """(N, 2) where the metrology fibres were to be; NaN: without a target."""
    utc: float
    """When it was reduced, s since 1970."""

    def packed(self, layout: str) -> bytes:
        """As bytes; `layout`: digest of the one that it is of."""
        found, turned = self.stamps.transform, self.stamps.transform.similarity
        head = {
            "layout": layout,
            "utc": self.utc,
            "time_s": self.stamps.time_s,
            "similarity": [turned.a.real, turned.a.imag, turned.b.real, turned.b.imag],
            "flipped": turned.flipped,
            "radius_mm": found.radius_mm,
            "terms": [int(term) for term in found.terms],
        }
        arrays = {name: getattr(self.stamps, name) for name in _STAMPS}
        return pack(head, arrays | {name: getattr(found, name) for name in _FIT} | {"goal_mm": self.goal_mm})

    @classmethod
    def of(cls, part: RunPart) -> KeptImage:
        """Of the bytes that were packed."""
        head, arrays = part.head, part.arrays
        a_re, a_im, b_re, b_im = head["similarity"]
        turned = Similarity(complex(a_re, a_im), complex(b_re, b_im), bool(head["flipped"]))
        fit = FieldTransform(
            turned, head["radius_mm"], tuple(head["terms"]), **{name: arrays[name] for name in _FIT}
        )
        cut: dict[str, Any] = {name: arrays[name] for name in _STAMPS}
        return cls(Stamps(**cut, transform=fit, time_s=head["time_s"]), arrays["goal_mm"], head["utc"])


_STAMPS = ("pixels", "corner_px", "spot_px")
_FIT = ("coefficients_mm", "covariance_mm2", "noise_mm2")


class LastImage:
    """A file with the last image of one layout; written beside the motion, the last one counts."""

    def __init__(self, folder: Path, layout: str) -> None:
        """`folder`: of the store; `layout`: digest of the positioners that the image is of."""
        self.file, self.layout = folder / FILE, layout
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="fiberloom-image")

    def later(self, image: KeptImage) -> None:
        """Hands an image over to be kept; where it cannot be written, the log says so."""
        self._thread.submit(self._keep, image)

    def _keep(self, image: KeptImage) -> None:
        try:
            with whole(self.file, folders=True) as place:
                place.write_bytes(image.packed(self.layout))
        except (InputError, OSError) as error:
            _log.warning("%s: the last image is not kept: %s", self.file, one_line(error))

    def read(self) -> KeptImage | None:
        """The image; None: there is none, it is of another layout, or it cannot be read."""
        if not self.file.exists():
            return None
        try:
            check_zip(self.file, MOST_BYTES)
            part = unpack(read_bytes(self.file, MOST_BYTES))
            return KeptImage.of(part) if part.head["layout"] == self.layout else None
        except (InputError, ValueError, KeyError, TypeError, OSError, zipfile.BadZipFile) as error:
            _log.warning("%s: cannot be read: %s", self.file, one_line(error))
            return None

    def close(self) -> None:
        """What was handed over is written."""
        self._thread.shutdown()
