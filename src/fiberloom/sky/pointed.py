"""What a fit of guide stars says of the telescope."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fiberloom.sky.chain import Chain
from fiberloom.sky.drift import field_grid, guide_stars
from fiberloom.sky.guiding import FieldOffset, GuideFit, fit_guiding
from fiberloom.sky.sky_targets import SkyTargets
from fiberloom.typing import Floats
from fiberloom.units import ARCSEC_PER_DEG, PPM, UM_PER_MM

_STEP_DEG = 0.01
