"""The end of the correction loop: by the instrument's rule, or after a number of moves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fiberloom.instruments.model import Operation
from fiberloom.typing import Flags, Floats


@dataclass(frozen=True)
class StopRule:
    """Ends the correction loop by the measured errors; see `instruments.model.Operation`."""

    kind: Literal["fixed", "percentile", "positioner"] = "fixed"
    percentile: float = 100.0
    """Of the errors, above 0 to 100 %; for the kind of that name."""
    below_um: float = 0.0
    """Limit of the errors; without effect for the kind `fixed`."""

    @classmethod
    def of(cls, operation: Operation) -> StopRule:
        """The rule of an instrument; its limit is the requirement unless it has one of its own."""
        below_um = operation.stop_below_um or operation.requirement_um
        return cls(operation.stop_rule, operation.stop_percentile, below_um)

    def arrived(self, error_um: Floats) -> Flags:
        """(N,) positioners that this rule does not move again. `error_um` (N,); NaN, not seen: False."""
        return (self.kind == "positioner") & (error_um <= self.below_um)

    def satisfied(self, error_um: Floats) -> bool:
        """Whether the loop may end. `error_um` (n,): of the fibres with a target that are seen and
        healthy, without those that arrived."""
        if self.kind == "fixed":
            return False
        return error_um.size == 0 or float(np.percentile(error_um, self.percentile)) <= self.below_um

    def explain(self, error_um: Floats) -> str:
        """Compares the errors with the limit, in words; empty for a fixed rule. `error_um` (n,): as for
        `satisfied`."""
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
