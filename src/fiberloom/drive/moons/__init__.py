"""MOONS: waveforms of steps, gateways on TCP, both elbows."""

from fiberloom.drive.moons.link import MoonsLink
from fiberloom.drive.moons.maker import WaveformMaker
from fiberloom.drive.moons.waveform import broken_rule, check_waveform, waveform

__all__ = ["MoonsLink", "WaveformMaker", "broken_rule", "check_waveform", "waveform"]
