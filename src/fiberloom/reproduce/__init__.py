"""The paper's figures and numbers on the twin, ours beside theirs.

Each figure is one module with `run(settings) -> Outcome`. Experiments go through the same firmware,
bus, camera and calibration code as an operator's; nothing here is imported by the rest.
"""

from fiberloom.reproduce import numbers
from fiberloom.reproduce.outcome import Drawing, Outcome, Settings
from fiberloom.reproduce.quantity import Bound, Kind, Quantity, quantity
from fiberloom.reproduce.registry import FIGURES, Figure, chosen
from fiberloom.reproduce.runner import reproduce

__all__ = [
    "FIGURES",
    "Bound",
    "Drawing",
    "Figure",
    "Kind",
    "Outcome",
    "Quantity",
    "Settings",
    "chosen",
    "numbers",
    "quantity",
    "reproduce",
]
