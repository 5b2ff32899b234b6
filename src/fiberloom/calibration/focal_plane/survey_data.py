"""What a survey of the focal plane has measured."""

from __future__ import annotations

from dataclasses import dataclass

from fiberloom.typing import Floats


@dataclass(frozen=True)
class SurveyData:
    """What was measured: S configurations of N positioners."""

    theta_deg: Floats
    """(N, S, 2) output angles, by the maps, at which the motors came to rest."""
    xy_mm: Floats
    """(N, S, 2) metrology fibres; NaN where not seen, or where the positioner is not to be trusted."""
    expected_sigma: Floats
    """(N, 6) standard errors that the design promises, mm and rad."""
    at_C: float | None = None
    """Temperature of the positioners, deg C; None: they do not tell it."""
