"""The arrays of steppers by the protocol of their instrument."""

from __future__ import annotations

from fiberloom.drive.lamost import RadioTransport, coordinator_of
from fiberloom.drive.megara.link import MegaraLink
from fiberloom.drive.moons import MoonsLink, WaveformMaker
from fiberloom.drive.moons.frames import UnitPlace
from fiberloom.drive.steppers.bench import BenchSettings
from fiberloom.drive.steppers.drive import TRIAL_DEG
from fiberloom.drive.steppers.square import SquareMaker
from fiberloom.twin.desi.transport import DesiTransport
from fiberloom.twin.steppers.lamost import VirtualRadio
from fiberloom.twin.steppers.megara import MegaraBus, bus_of
from fiberloom.twin.steppers.moons import MoonsBus, VirtualGateways
from fiberloom.twin.steppers.source import ArrayKind

KINDS = {
    "megara": ArrayKind(
        bus=MegaraBus,
        link=lambda bus, faults: MegaraLink(DesiTransport(bus, faults)),
        maker=lambda instrument: SquareMaker.of(instrument, TRIAL_DEG),
        bench=BenchSettings(knots=25, sweeps=3),
        gateway_of=bus_of,
    ),
    "moons": ArrayKind(
        bus=MoonsBus,
        link=lambda bus, faults: MoonsLink(VirtualGateways(bus, faults)),
        maker=lambda instrument: WaveformMaker.of(instrument, TRIAL_DEG),
        bench=BenchSettings(knots=73, sweeps=3),
        gateway_of=lambda number: UnitPlace.of(number).gateway,
    ),
    "lamost": ArrayKind(
        bus=MegaraBus,
        link=lambda bus, faults: MegaraLink(RadioTransport(VirtualRadio(bus, faults))),
        maker=lambda instrument: SquareMaker.of(instrument, TRIAL_DEG),
        bench=BenchSettings(knots=1, sweeps=1),
        gateway_of=coordinator_of,
    ),
}
