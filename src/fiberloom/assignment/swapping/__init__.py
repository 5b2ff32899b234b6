"""Swapping: targets change hands among neighbours, as many of each priority as before."""

from fiberloom.assignment.swapping.swap import Swapped, SwapSettings, swap_targets

__all__ = ["SwapSettings", "Swapped", "swap_targets"]
