"""Target lists: what the fibres should look at."""

from typing import TYPE_CHECKING

from fiberloom.lazy import on_use

if TYPE_CHECKING:
    from fiberloom.targets.generate import random_targets
    from fiberloom.targets.read import read_targets, write_targets
    from fiberloom.targets.target_list import TargetList

__all__ = ["TargetList", "random_targets", "read_targets", "write_targets"]

__getattr__ = on_use(__name__)
