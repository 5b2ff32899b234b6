"""The paper's figures and numbers on the twin, ours beside theirs.

Each figure is one module with `run(settings) -> FigureOutcome`. Experiments go through the same firmware,
bus, camera and calibration code as an operator's; nothing here is imported by the rest.
"""

from fiberloom.studies.paper import numbers
from fiberloom.studies.paper.outcome import Drawing, FigureOutcome, Settings
from fiberloom.studies.paper.quantity import Bound, Kind, Quantity, quantity
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
    "numbers",
    "quantity",
    "reproduce",
]
