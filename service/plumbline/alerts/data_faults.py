"""Data alerts that need no threshold: a displacement that a witness contradicts, a reference station that moves.

They live as other alerts do (on- and off-delay in event time, so that an epoch's outlier raises nothing and a witness
that wavers does not make them flap), and say why in words.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final, NamedTuple

from plumbline.alerts.lifecycle import Judgement, ThresholdState, step
from plumbline.alerts.quantities import CONTRADICTED
from plumbline.alerts.rules import AlertsState
from plumbline.records import AlertEvent, Severity, Threshold

ON_DELAY_S: Final = 3.0
OFF_DELAY_S: Final = 60.0
_PREFIX: Final = "data-"


class Fault(NamedTuple):
    """What speaks against a station's data at an epoch."""

    since_gps_ns: int
    size_m: float
    reason: str


def evaluate_faults(
    state: AlertsState,
    station: str,
    kinds: tuple[str, ...],
    faults: Mapping[str, Fault],
    t_gps_ns: int,
    t_receive_ns: int,
) -> tuple[AlertsState, list[AlertEvent]]:
    """Judge an epoch of a station: ``faults`` by kind, one of ``kinds``; every kind has an alert of its own."""
    phases, events = dict(state.faults), list[AlertEvent]()
    for kind in kinds:
        fault, phase = faults.get(kind), phases.get(kind, ThresholdState())
        if fault is None and kind not in phases:
            continue
        if t_gps_ns <= phase.t_decided_gps_ns:
            continue
        phase, happened = step(phase, _threshold(station, kind), _judged(station, fault, t_gps_ns, t_receive_ns))
        phases[kind] = phase
        events += happened
    return replace(state, faults=phases), events


def _threshold(station: str, kind: str) -> Threshold:
    return Threshold(
        threshold_id=_PREFIX + kind,
        station=station,
        quantity=CONTRADICTED,
        level=0.0,
        severity=Severity.WARNING,
        on_delay_s=ON_DELAY_S,
        off_delay_s=OFF_DELAY_S,
    )


def _judged(station: str, fault: Fault | None, t_gps_ns: int, t_receive_ns: int) -> Judgement:
    text = f"data of {station} are good again: nothing contradicts them any more"
    if fault is not None:
        text = f"data of {station}, not the structure: {fault.reason}"
    return Judgement(
        t_first_gps_ns=t_gps_ns,
        t_last_gps_ns=t_gps_ns,
        t_cross_gps_ns=fault.since_gps_ns if fault is not None else t_gps_ns,
        exceeds=fault is not None,
        clears=fault is None,
        value=fault.size_m if fault is not None else 0.0,
        t_receive_ns=t_receive_ns,
        text=text,
    )
