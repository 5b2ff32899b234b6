"""What an observation needs of the outside world; where it comes from is not its business."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from fiberloom.bus.transport import Transport
from fiberloom.instruments.pointing import Pointing
from fiberloom.metrology import Camera
from fiberloom.typing import Flags, Floats


class Truth(Protocol):
    """Where the fibres really are: only a twin knows, and only reports may ask."""

    def fibre_xy(self, fibre: str) -> Floats:
        """Position (N, 2) in mm of the named fibre of every positioner."""
        ...

    def fibre_xy_at(self, fibre: str, pointing: Pointing) -> Floats:
        """The same (N, 2), mm, were the telescope to point elsewhere and nothing else to move."""
        ...


class Telescope(Protocol):
    """Tilts and turns the focal plane."""

    def point(self, pointing: Pointing) -> None:
        """Points there; everything is at rest again when it returns."""
        ...


@dataclass(frozen=True)
class Hardware:
    """A bus with positioners on it and a camera that looks at them."""

    transport: Transport
    camera: Camera
    truth: Truth | None = None
    vouched: Flags | None = None
    """(N,) positioners whose datum was searched since power came on: believed where a fibre is dark."""
    telescope: Telescope | None = None
    """None: it is pointed from elsewhere."""
