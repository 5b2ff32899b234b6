"""What a survey of the focal plane has measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from fiberloom.typing import Floats, Ints


@dataclass(frozen=True, eq=False)
class Looks:
    """Spots in the I images of a survey, in the frame of the camera: mm by its nominal scale, unturned."""

    configuration: Ints
    """(I,) of which configuration each image is."""
    fiducial_mm: Floats
    """(I, F, 2); NaN where not found."""
    fibre_mm: Floats
    """(I, N, 2); NaN where not seen, or where the positioner is not to be trusted."""

    @property
    def n_images(self) -> int:
        """I."""
        return len(self.configuration)


@dataclass(frozen=True)
class SurveyData:
    """What was measured: S configurations of N positioners."""

    theta_deg: Floats
    """(N, S, 2) output angles, by the maps, at which the motors came to rest."""
    xy_mm: Floats
    """(N, S, 2) metrology fibres; NaN where not seen, or where the positioner is not to be trusted."""
    expected_sigma: Floats
    """(N, 6) standard errors that the design promises, mm and rad."""
    looks: Looks | None = None
    """Spots of the images; None where the camera takes none, or they were not kept."""
    apart_mm: Mapping[str, Floats] = field(default_factory=dict)
    """By science fibre that was lit: (N, S, 2) from the metrology fibre to it; NaN where not seen."""
    at_C: float | None = None
    """Temperature of the positioners, deg C; None: they do not tell it."""
