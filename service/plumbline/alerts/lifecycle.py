"""From exceeding to alert and back (ISA-18.2: on-delay, off-delay, dead band), in event time.

NORMAL ──exceeds──► RISING ──for on_delay──► ACTIVE ──below level − dead band──► FALLING ──for off_delay──► NORMAL
   ▲                   │                        ▲                                   │
   └─── no longer ─────┘                        └──────── above again ──────────────┘
"""

from dataclasses import dataclass, replace
from enum import StrEnum

from plumbline.alerts.quantities import in_words, name_in_words
from plumbline.records import AlertEvent, AlertState, Threshold


class Phase(StrEnum):
    """Where a threshold stands."""

    NORMAL = "normal"
    RISING = "rising"  # exceeded, the on-delay runs
    ACTIVE = "active"
    FALLING = "falling"  # no longer exceeded, the off-delay runs


@dataclass(frozen=True, slots=True)
class ThresholdState:
    """A threshold's phase; times are event times."""

    phase: Phase = Phase.NORMAL
    t_onset_gps_ns: int = 0  # of the present crossing, from RISING on
    t_fall_gps_ns: int = 0  # FALLING: since when it is no longer exceeded
    t_decided_gps_ns: int = -1  # the latest instant that has been judged


@dataclass(frozen=True, slots=True)
class Judgement:
    """A quantity over a stretch of event time: whether it exceeded, and from when within it."""

    t_first_gps_ns: int  # the stretch begins
    t_last_gps_ns: int  # … and ends, both inclusive
    t_cross_gps_ns: int  # first instant in it that exceeds; t_first_gps_ns if none
    exceeds: bool
    clears: bool  # below the level by the dead band, throughout
    value: float  # the peak
    t_receive_ns: int
    text: str = ""  # what an alert says instead of value and level


def step(state: ThresholdState, threshold: Threshold, judged: Judgement) -> tuple[ThresholdState, list[AlertEvent]]:
    """Move a threshold through one stretch of event time; the alert's id is the same whenever it is computed."""
    events: list[AlertEvent] = []
    if state.phase in (Phase.NORMAL, Phase.RISING):
        state, raised = _rise(state, threshold, judged)
        events += raised
    else:
        state, cleared = _fall(state, threshold, judged)
        events += cleared
    return replace(state, t_decided_gps_ns=judged.t_last_gps_ns), events


def _rise(state: ThresholdState, threshold: Threshold, judged: Judgement) -> tuple[ThresholdState, list[AlertEvent]]:
    if not judged.exceeds:
        return replace(state, phase=Phase.NORMAL), []
    onset = state.t_onset_gps_ns if state.phase is Phase.RISING else judged.t_cross_gps_ns
    due = onset + round(threshold.on_delay_s * 1e9)
    if due > judged.t_last_gps_ns:
        return replace(state, phase=Phase.RISING, t_onset_gps_ns=onset), []
    state = replace(state, phase=Phase.ACTIVE, t_onset_gps_ns=onset)
    return state, [_event(state, threshold, judged, AlertState.ACTIVE, max(due, onset))]


def _fall(state: ThresholdState, threshold: Threshold, judged: Judgement) -> tuple[ThresholdState, list[AlertEvent]]:
    if not judged.clears:
        return replace(state, phase=Phase.ACTIVE), []
    since = state.t_fall_gps_ns if state.phase is Phase.FALLING else judged.t_first_gps_ns
    due = since + round(threshold.off_delay_s * 1e9)
    if due > judged.t_last_gps_ns:
        return replace(state, phase=Phase.FALLING, t_fall_gps_ns=since), []
    event = _event(state, threshold, judged, AlertState.CLEARED, max(due, judged.t_first_gps_ns))
    return replace(state, phase=Phase.NORMAL), [event]


def alert_id(station: str, threshold_id: str, t_onset_gps_ns: int) -> str:
    """The name of a crossing: whenever the same data are judged, the same name."""
    return f"{station}:{threshold_id}:{t_onset_gps_ns}"


def _event(
    state: ThresholdState, threshold: Threshold, judged: Judgement, kind: AlertState, t_gps_ns: int
) -> AlertEvent:
    verb = "exceeds" if kind is AlertState.ACTIVE else "is back below"
    quantity = threshold.quantity
    words = (
        f"{name_in_words(quantity)} of {threshold.station}: {in_words(quantity, judged.value)} {verb} "
        f"{in_words(quantity, threshold.level)}"
    )
    return AlertEvent(
        alert_id=alert_id(threshold.station, threshold.threshold_id, state.t_onset_gps_ns),
        station=threshold.station,
        threshold_id=threshold.threshold_id,
        state=kind,
        severity=threshold.severity,
        t_gps_ns=t_gps_ns,
        t_onset_gps_ns=state.t_onset_gps_ns,
        t_receive_ns=judged.t_receive_ns,
        quantity=threshold.quantity,
        value=judged.value,
        level=threshold.level,
        text=judged.text or words,
    )
