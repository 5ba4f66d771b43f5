"""Decides when a station's motion or silence is alarming, and for how long; it tells nobody (that is the shell's
part).
"""

from plumbline.alerts.lifecycle import Phase, ThresholdState
from plumbline.alerts.rules import QUANTITIES, AlertsState, evaluate

__all__ = ["QUANTITIES", "AlertsState", "Phase", "ThresholdState", "evaluate"]
