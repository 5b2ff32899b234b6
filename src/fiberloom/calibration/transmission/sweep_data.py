"""What a sweep has measured."""

from __future__ import annotations

from dataclasses import dataclass

from fiberloom.typing import Floats


@dataclass(frozen=True)
class SweepData:
    """What the camera saw: first index the axis that turned, then 0 for down and 1 for up."""

    wire_deg: Floats
    """(2 axes, K) commanded positions, rising."""
    xy_mm: Floats
    """(2 axes, 2 directions, K, N, 2); NaN where not seen."""
    trouble: list[str]
    """(N,) why a positioner left the sweep; empty for those that stayed."""
