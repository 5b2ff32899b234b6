"""Plans that a supply can feed: slower, or in waves; and the proof that they do. See docs/planning.md."""

from fiberloom.planning.supply.currents import Currents, currents, peak_current_A
from fiberloom.planning.supply.fed import LEAST_SHARE, plan_within_supply
from fiberloom.planning.supply.proof import SupplyVerification, verify_supply
from fiberloom.planning.supply.waves import PAUSE_S, plan_in_waves

__all__ = [
    "LEAST_SHARE",
    "PAUSE_S",
    "Currents",
    "SupplyVerification",
    "currents",
    "peak_current_A",
    "plan_in_waves",
    "plan_within_supply",
    "verify_supply",
]
