"""When the correction loop ends: by the instrument's rule, or after a number of moves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fiberloom.instruments.model import Operation
from fiberloom.typing import Flags, Floats


@dataclass(frozen=True)
class StopRule:
    """Ends the correction loop by what the camera has measured; see `instruments.model.Operation`."""

    kind: Literal["fixed", "percentile", "positioner"] = "fixed"
    percentile: float = 100.0
    below_um: float = 0.0

    @classmethod
    def of(cls, operation: Operation) -> StopRule:
        """The rule of an instrument; its limit is the requirement unless it has one of its own."""
        below_um = operation.stop_below_um or operation.requirement_um
        return cls(operation.stop_rule, operation.stop_percentile, below_um)

    def arrived(self, error_um: Floats) -> Flags:
        """(N,) positioners that this rule does not move again; NaN (not seen): never."""
        return (self.kind == "positioner") & (error_um <= self.below_um)

    def satisfied(self, error_um: Floats) -> bool:
        """Whether the loop may end. `error_um` (n,): fibres with a target that are seen and healthy,
        without those that arrived."""
        if self.kind == "fixed":
            return False
        return error_um.size == 0 or float(np.percentile(error_um, self.percentile)) <= self.below_um

    def explain(self, error_um: Floats) -> str:
        """How these distances (n,) in um, as for `satisfied`, are to the limit; empty for a fixed rule."""
        if self.kind == "fixed":
            return ""
        if self.kind == "positioner":
            return f"{error_um.size} fibres are left outside {self.below_um:g} um"
        if error_um.size == 0:
            return "no fibre is left to correct"
        word = "within" if self.satisfied(error_um) else "above"
        figure_um = np.percentile(error_um, self.percentile)
        found = f"{self.percentile:g} % of the fibres are within {figure_um:.2f} um"
        return f"{found}, {word} the limit of {self.below_um:g} um"
