"""Where the camera sees the fibres: image, spots, which positioner, focal-plane mm."""

from typing import TYPE_CHECKING

from fiberloom.lazy import on_use

if TYPE_CHECKING:
    from fiberloom.metrology.acquisition import CameraGeometry
    from fiberloom.metrology.camera import Camera, Measurement, SeveralImages
    from fiberloom.metrology.images import CameraImage, read_image, write_image
    from fiberloom.metrology.matching import Match, MatchSettings, MatchStatus, match_spots
    from fiberloom.metrology.science import science_positions
    from fiberloom.metrology.spots import (
        Flag,
        Found,
        Profile,
        Spots,
        SpotSettings,
        find_expected,
        find_spots,
        read_spots,
        write_spots,
    )
    from fiberloom.metrology.transform import (
        Distortion,
        FieldTransform,
        PlaceErrors,
        Similarity,
        TransformFit,
        fit_transform,
    )
    from fiberloom.metrology.turbulence import Turbulence, remove_turbulence

__all__ = [
    "Camera",
    "CameraGeometry",
    "CameraImage",
    "Distortion",
    "FieldTransform",
    "Flag",
    "Found",
    "Match",
    "MatchSettings",
    "MatchStatus",
    "Measurement",
    "PlaceErrors",
    "Profile",
    "SeveralImages",
    "Similarity",
    "SpotSettings",
    "Spots",
    "TransformFit",
    "Turbulence",
    "find_expected",
    "find_spots",
    "fit_transform",
    "match_spots",
    "read_image",
    "read_spots",
    "remove_turbulence",
    "science_positions",
    "write_image",
    "write_spots",
]

__getattr__ = on_use(__name__)
