"""Spots of a survey's images, kept as they were seen, for a fit of camera and fiducials together."""

from __future__ import annotations

from typing import Any

import numpy as np

from fiberloom.calibration.focal_plane.survey_data import Looks
from fiberloom.instruments import FocalPlane
from fiberloom.metrology.pipeline import Reduction
from fiberloom.metrology.transform import Similarity
from fiberloom.typing import Flags, Floats


class LookBook:
    """Keeps the spots of the images at the end of each move. A camera without images has none."""

    def __init__(self, camera: Any, plane: FocalPlane) -> None:
        """`camera`: any; `plane`: its N positioners and F fiducials."""
        self._plane, self._since = plane, list[Reduction]()
        self._unturned: Similarity | None = None
        self._rows: list[tuple[int, Floats, Floats]] = []
        self._camera = camera if hasattr(camera, "watchers") else None
        if self._camera is not None:
            self._unturned = self._camera.settings.geometry.similarity()
            self._camera.watchers.append(self._since.append)

    def keep(self, configuration: int, images: int, trusted: Flags) -> None:
        """The last `images` are of this `configuration`; `trusted` (N,): arms are where their motors say."""
        for reduction in self._since[-images:]:
            spots_mm = self._to_mm(reduction.spots.xy_px)
            fiducial = np.full((len(self._plane.fiducials), 2), np.nan)
            fiducial[reduction.acquisition.fiducial] = spots_mm[reduction.acquisition.spot]
            fibre = np.full((len(self._plane), 2), np.nan)
            seen = reduction.seen & trusted
            fibre[seen] = spots_mm[reduction.spot_of_match[seen]]
            self._rows.append((configuration, fiducial, fibre))
        self._since.clear()

    def close(self) -> None:
        """Lets go of the camera."""
        if self._camera is not None:
            self._camera.watchers.remove(self._since.append)

    def looks(self) -> Looks | None:
        """What was kept."""
        if not self._rows:
            return None
        number, fiducial, fibre = zip(*self._rows, strict=True)
        return Looks(np.array(number, dtype=np.int64), np.stack(fiducial), np.stack(fibre))

    def _to_mm(self, xy_px: Floats) -> Floats:
        assert self._unturned is not None
        return self._unturned.to_mm(xy_px)
