"""fiberloom: the control stack for alpha-beta optical fibre positioners.

From a target list to fibres on target, on hardware or on the twin:

>>> import fiberloom as fl
>>> plane = fl.FocalPlane.of("sdssv", seed=0, n=7)
>>> field = fl.Field.twin(plane, seed=0)
>>> maps = field.run.calibrate()
>>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=2)
>>> seen
Observation('sdssv', 7 positioners, 7 with a target, 3 moves, 7 within 5 um)

`field.run` is for scripts; where an event loop runs, as in Jupyter, write ``await field.calibrate()`` and
``await field.observe(...)``.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from fiberloom.version import __version__

if TYPE_CHECKING:
    from fiberloom.assignment.assign import assign
    from fiberloom.calibration.transmission.maps import TransmissionMaps
    from fiberloom.errors import InputError
    from fiberloom.field import Field
    from fiberloom.instruments import FocalPlane, Instrument
    from fiberloom.metrology.centroids import centroid
    from fiberloom.metrology.spots import Spots
    from fiberloom.operation.results import Observation
    from fiberloom.planning import Plan, plan, verify
    from fiberloom.targets import TargetList, read_targets

__all__ = [
    "Field",
    "FocalPlane",
    "InputError",
    "Instrument",
    "Observation",
    "Plan",
    "Spots",
    "TargetList",
    "TransmissionMaps",
    "__version__",
    "assign",
    "centroid",
    "plan",
    "read_targets",
    "verify",
]

# numpy, scipy and astropy take a second to import: a name brings what it needs when it is first used
_PLACES = {
    "Field": "field",
    "FocalPlane": "instruments",
    "InputError": "errors",
    "Instrument": "instruments",
    "Observation": "operation.results",
    "Plan": "planning",
    "Spots": "metrology.spots",
    "TargetList": "targets",
    "TransmissionMaps": "calibration.transmission.maps",
    "assign": "assignment.assign",
    "centroid": "metrology.centroids",
    "plan": "planning",
    "read_targets": "targets",
    "verify": "planning",
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'fiberloom' has no attribute '{name}'")
    value = getattr(importlib.import_module(f"fiberloom.{_PLACES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
