"""`fiberloom calibrate transmission`, and the cache of its maps."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

from fiberloom.bus.client import Client
from fiberloom.calibration.sweep import Sweep, calibrate_transmission
from fiberloom.calibration.transmission import TransmissionMaps
from fiberloom.commands.outputs import marks, prepare_folder
from fiberloom.commands.terminal import Waiting, waiting
from fiberloom.instruments import FocalPlane
from fiberloom.twin import Units, build_hardware, draw_units

POINTS = 200
