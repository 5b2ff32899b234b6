"""CAN frames in the SDSS-V positioner protocol: codec, transports, and the client."""

from fiberloom.bus.cannet import CanNetTransport
from fiberloom.bus.client import Client, Collision
from fiberloom.bus.links import Link
from fiberloom.bus.motion import Deviation, DeviationKind, Going, MotionWatch, Tolerance
from fiberloom.bus.outcome import Outcome, Result, Results
from fiberloom.bus.protocol import Command, Response, Status
from fiberloom.bus.trajectory import WireTrajectory
from fiberloom.bus.transport import Frame, PythonCanTransport, Transport, TransportLost

__all__ = [
    "CanNetTransport",
    "Client",
    "Collision",
    "Command",
    "Deviation",
    "DeviationKind",
    "Frame",
    "Going",
    "Link",
    "MotionWatch",
    "Outcome",
    "PythonCanTransport",
    "Response",
    "Result",
    "Results",
    "Status",
    "Tolerance",
    "Transport",
    "TransportLost",
    "WireTrajectory",
]
