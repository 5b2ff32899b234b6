"""The temperature of an array, as its positioners tell it over the bus (command 132)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.bus.outcome import Results
from fiberloom.bus.protocol import Command
from fiberloom.drive.sdssv.limits import temperature_C
from fiberloom.instruments.model import Care, Instrument

SPREAD_K = 3.0
"""Between the thermometers of one array, robust standard deviation: with more, half of them are wrong."""
FEWEST = 0.5
"""Of the positioners of the bus that must tell."""
_MEDIAN = 0.6745
"""Of the distance from the mean of a Gaussian, over its sigma."""


@dataclass(frozen=True)
class Felt:
    """A temperature, or why there is none."""

    at_C: float | None
    why: str = ""


def has_thermometer(instrument: Instrument) -> bool:
    """Whether the host knows the scale of what the positioners tell."""
    return bool(instrument.care.temperature_C_per_count)


async def felt(client: Client, instrument: Instrument) -> Felt:
    """Asks the positioners of a bus, which are known to the `client`; `instrument`: of the scale."""
    return judged(instrument, await client.command(Command.GET_RAW_TEMPERATURE))


def judged(instrument: Instrument, raw: Results) -> Felt:
    """The median of what positioners tell, if it can be a temperature: they agree, and arms can be so warm.

    `instrument`: of the scale, and of the range of its `[expansion]`; `raw`: answers to command 132.
    """
    care = instrument.care
    at_C = temperature_C(care, raw)
    told = [answer.values[0] for answer in raw.values() if answer.ok]
    if at_C is None or len(told) < FEWEST * len(raw):
        return Felt(None, f"{len(told)} of {len(raw)} positioners tell their temperature")
    spread_K = _spread_K(care, told)
    if spread_K > SPREAD_K:
        return Felt(None, f"the positioners' thermometers scatter by {spread_K:.0f} K")
    if instrument.expansion is not None:
        coldest_C, warmest_C = instrument.expansion.range_C
        if not coldest_C <= at_C <= warmest_C:
            return Felt(None, f"the positioners' thermometers say {at_C:.0f} deg C, which cannot be")
    return Felt(at_C)


def _spread_K(care: Care, counts: list[int]) -> float:
    """Robust standard deviation."""
    about = np.abs(np.array(counts) - np.median(counts))
    return abs(care.temperature_C_per_count or 0.0) * float(np.median(about)) / _MEDIAN
