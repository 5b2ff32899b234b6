"""What an observation needs of the outside world; where it comes from is not its business."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from fiberloom.bus.transport import Transport
from fiberloom.drive.port import Drive
from fiberloom.errors import InputError
from fiberloom.instruments.pointing import Pointing
from fiberloom.metrology import Camera
from fiberloom.typing import Flags, Floats

if TYPE_CHECKING:
    from fiberloom.sky.chain import Chain
    from fiberloom.sky.guiding import FieldOffset
    from fiberloom.sky.sky_targets import SkyTargets


class Truth(Protocol):
    """Where the fibres really are: only a twin knows, and only reports may ask."""

    def fibre_xy(self, fibre: str) -> Floats:
        """Position (N, 2) in mm of the named fibre of every positioner."""
        ...

    def fibre_xy_at(self, fibre: str, pointing: Pointing) -> Floats:
        """The same (N, 2), mm, were the telescope to point elsewhere and nothing else to move."""
        ...

    def contacts(self) -> int:
        """How often bodies have come into contact so far."""
        ...


class Telescope(Protocol):
    """Tilts and turns the focal plane."""

    def point(self, pointing: Pointing) -> None:
        """Points there; everything is at rest again when it returns."""
        ...


class Guider(Protocol):
    """Guide cameras or guide fibres: where stars are seen in the focal plane."""

    def stars(self, chain: Chain) -> SkyTargets | None:
        """Stars of its own catalogue that are on its cameras, in the field of the `chain`; None: it has none,
        and looks at those it is told."""
        ...

    def look(self, stars: SkyTargets, chain: Chain) -> Floats:
        """One image: where the `stars` (n) are seen, (n, 2) mm in the focal plane, NaN where one is not.

        `chain`: for which they are predicted.
        """
        ...

    def star_um(self, chain: Chain) -> float:
        """Error of one star in one image, um per axis."""
        ...

    def truth(self, chain: Chain) -> FieldOffset | None:
        """How the telescope points off in truth: only a twin knows."""
        ...


@dataclass(frozen=True)
class Hardware:
    """Positioners and a camera that looks at them."""

    transport: Transport | None
    """Of SDSS-V's positioners; None: a `drive` of another kind."""
    camera: Camera
    truth: Truth | None = None
    vouched: Flags | None = None
    """(N,) positioners whose datum was searched since power came on: believed where a fibre is dark."""
    telescope: Telescope | None = None
    """None: it is pointed from elsewhere."""
    drive: Drive | None = None
    """None: SDSS-V's positioners on the `transport`."""
    guider: Guider | None = None
    """None: nothing looks at guide stars."""

    @property
    def bus(self) -> Transport:
        """The transport of SDSS-V's frames. InputError where the positioners are of another kind."""
        if self.transport is None:
            raise InputError("these positioners do not take SDSS-V's commands; observe them")
        return self.transport
