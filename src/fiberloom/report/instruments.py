"""One line about an instrument."""

from __future__ import annotations

from typing import Any

from fiberloom.instruments import Instrument


def overview(i: Instrument) -> dict[str, Any]:
    """What tells instruments apart: numbers, arms and pitch in mm, motor, requirement in um."""
    return {
        "name": i.name,
        "positioners": i.layout.n_positioners,
        "arms_mm": f"{i.positioner.l_alpha_mm:g} / {i.positioner.points[i.seen_point].x_mm:g}",
        "pitch_mm": i.layout.pitch_mm,
        "motor": i.alpha.kind,
        "requirement_um": i.operation.requirement_um,
        "images": "yes" if i.camera else "no",
    }
