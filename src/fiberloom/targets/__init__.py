"""Target lists: what the fibres should look at."""

from .generate import random_targets
from .read import read_targets, write_targets
from .target_list import TargetList

__all__ = ["TargetList", "random_targets", "read_targets", "write_targets"]
