"""A recorder for runs of which only the result counts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fiberloom.metrology import Measurement
from fiberloom.operation.loop import Move


class NoRecord:
    """Implements `operation.loop.Recorder`; the loop keeps its moves itself."""

    def start(self, here_deg: NDArray[np.float64], wire_deg: NDArray[np.float64], image: Measurement) -> None:
        """Not a move."""

    def move(self, move: Move) -> None:
        """Nothing to keep."""

    def event(self, kind: str, text: str, positioner_id: int | None = None) -> None:
        """Shows in the moves."""
