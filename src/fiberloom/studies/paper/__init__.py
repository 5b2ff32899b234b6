"""The paper's figures and numbers on the twin, ours beside theirs.

Each figure is one module with `run(settings) -> FigureOutcome`. Experiments go through the same firmware,
bus, camera and calibration code as an operator's; nothing here is imported by the rest.
"""

from typing import TYPE_CHECKING

from fiberloom.lazy import on_use

if TYPE_CHECKING:
    from fiberloom.studies.paper.outcome import Drawing, FigureOutcome, Settings
    from fiberloom.studies.paper.quantity import Bound, Kind, Quantity
    from fiberloom.studies.paper.registry import FIGURES, Figure, chosen
    from fiberloom.studies.paper.runner import reproduce

__all__ = [
    "FIGURES",
    "Bound",
    "Drawing",
    "Figure",
    "FigureOutcome",
    "Kind",
    "Quantity",
    "Settings",
    "chosen",
    "reproduce",
]

__getattr__ = on_use(__name__)
