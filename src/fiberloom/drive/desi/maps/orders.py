"""Orders of a planetary gear's error, in cycles for a turn of the arm."""

import numpy as np

RING, SUN, PLANET = 46, 14, 16
RATIO = RING / SUN + 1.0
"""Of one stage; four make the gear."""
_STAGE = np.array([1.0, RING / PLANET, RATIO - 1.0])
ORDERS = np.concatenate([_STAGE, RATIO * _STAGE, [float(RING)]])
"""[D] Of the last stage: carrier, planet, sun; of the one before; teeth of the ring."""
