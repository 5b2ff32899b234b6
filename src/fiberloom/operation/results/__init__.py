"""The results of an observation: summary.json, fibres.ecsv, trajectories.json, figures."""

from fiberloom.operation.results.observation import Observation
from fiberloom.operation.results.observed import NOT_COUNTED, metrology_goals_mm
from fiberloom.operation.results.summary import TRULY_OFF

__all__ = ["NOT_COUNTED", "TRULY_OFF", "Observation", "metrology_goals_mm"]
