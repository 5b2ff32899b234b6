"""
What must be fast: geometry, firmware, twin, planning. Angles in rad, lengths in mm.
"""

from fiberloom._core import (
    firmware as firmware,
    geometry as geometry,
    metrology as metrology,
    planning as planning,
    twin as twin
)
