"""Rows for people: what a field of stars and all together have found."""

from __future__ import annotations

from typing import Any

import numpy as np

from fiberloom.calibration.fibres.estimate import FieldOffsets
from fiberloom.calibration.fibres.offsets import FibreOffsets
from fiberloom.units import UM_PER_MM


def field_row(name: str, found: FieldOffsets) -> dict[str, Any]:
    """Of one field: rms of offsets and of their standard errors, two-dimensional, um."""
    ok = found.ok
    wide = np.einsum("nii->n", found.covariance_with_modes_um2()[ok])
    return {
        "field": name,
        "stars": len(ok),
        "found": int(ok.sum()),
        "offset_rms_um": float(np.sqrt((found.offset_um[ok] ** 2).sum(axis=1).mean())),
        "formal_um": float(np.sqrt(wide.mean())),
    }


def combined_row(name: str, offsets: FibreOffsets, fibre: str = "") -> dict[str, Any]:
    """Of all fields, of one `fibre` or all: as `field_row`, um."""
    ok = offsets.ok & ((offsets.fibre == fibre) | (not fibre))
    wide = np.einsum("nii->n", offsets.covariance_mm2[ok])
    n = max(int(ok.sum()), 1)
    return {
        "field": name,
        "stars": len(offsets) if not fibre else int((offsets.fibre == fibre).sum()),
        "found": int(ok.sum()),
        "offset_rms_um": UM_PER_MM * float(np.sqrt((offsets.offset_mm[ok] ** 2).sum() / n)),
        "formal_um": UM_PER_MM * float(np.sqrt(wide.sum() / n)),
    }
