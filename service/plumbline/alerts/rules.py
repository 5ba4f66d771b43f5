"""Thresholds against motion, solutions and silence (ISA-18.2), decided in event time.

What a false alarm would come from, and what stands against it:

- *a position that is not one yet*: displacement, velocity and rate are judged only where the block rests on a converged
  solution (``TRUSTED``). While a station converges, coasts without GNSS or refuses its solutions, a threshold on them
  keeps the phase it has: nothing is raised, and nothing is cleared either. An acceleration is the sensor's own and
  judged wherever the block has one: the fusion gives none until it knows the sensor's bias.
- *a displacement that is the receiver's*: where a witness contradicts it (``doubted``), a threshold keeps its phase.
- *noise*: a displacement counts only where it is ``SIGNIFICANCE`` sigmas from zero, so a level below what the station
  can see does not flap. Where the station is good (3 sigma below the level) the level is the level.
- *a block that is revised*: event time only moves on. A block that was judged is not judged again; one that could not
  be judged (bad status) is, when its revision can.
- *a sway*: the value of a block is its peak (see ``quantities``).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from plumbline.alerts.lifecycle import Judgement, ThresholdState, step
from plumbline.alerts.quantities import (
    DATA_GAP,
    HEALTH,
    QUANTITIES,
    RATE,
    RATE_WINDOW_S,
    block_values,
    needs_gnss,
    rate_value,
)
from plumbline.gps_time import NS_PER_S
from plumbline.records import AlertEvent, Motion, Solution, StationStatus, Status, Threshold

__all__ = ["QUANTITIES", "SIGNIFICANCE", "TRUSTED", "AlertsState", "evaluate"]

TRUSTED: Final = frozenset({Status.PPP_FLOAT, Status.PPP_FIXED, Status.RTK_FLOAT, Status.RTK_FIXED})
SIGNIFICANCE: Final = 3.0


@dataclass(frozen=True, slots=True)
class AlertsState:
    """A station's thresholds' phases, and what data health and rates need to be remembered."""

    thresholds: Mapping[str, ThresholdState] = field(default_factory=dict)
    t_epoch_gps_ns: int | None = None  # the last decoded epoch that a status spoke of …
    t_epoch_receive_ns: int | None = None  # … and when it first did
    t_position_receive_ns: int | None = None  # of the last solution with a position
    t_begin_receive_ns: int | None = None  # of the first record at all
    faults: Mapping[str, ThresholdState] = field(default_factory=dict)  # data alerts' phases, by kind
    means: tuple[tuple[int, float, float, float], ...] = ()  # block means of the last RATE_WINDOW_S: t, E, N, U


def evaluate(
    state: AlertsState,
    thresholds: Iterable[Threshold],
    record: Motion | Solution | StationStatus,
    doubted: bool = False,
) -> tuple[AlertsState, list[AlertEvent]]:
    """Judge one record of a station against that station's thresholds; those of others and the disabled are passed
    over.

    Motion judges motion; StationStatus, which comes about once a second whatever happens, judges silence; Solution is
    remembered. ``doubted``: the displacement of a motion is contradicted by a witness. A threshold that is removed,
    disabled or of an unknown quantity forgets its phase (the shell clears its alert). Thresholds are judged in the
    order of their ids.
    """
    own = sorted(
        (t for t in thresholds if t.station == record.station and t.enabled and t.quantity in QUANTITIES),
        key=lambda t: t.threshold_id,
    )
    known = {t.threshold_id for t in own}
    kept = {k: v for k, v in state.thresholds.items() if k in known}
    begin = record.t_receive_ns if state.t_begin_receive_ns is None else state.t_begin_receive_ns
    state = replace(state, thresholds=kept, t_begin_receive_ns=begin)
    if isinstance(record, Solution):
        return (replace(state, t_position_receive_ns=record.t_receive_ns) if record.status.has_position else state), []
    if isinstance(record, StationStatus):
        if record.last_epoch_gps_ns != state.t_epoch_gps_ns:
            state = replace(state, t_epoch_gps_ns=record.last_epoch_gps_ns, t_epoch_receive_ns=record.t_receive_ns)
        return _each(state, [t for t in own if t.quantity in HEALTH], record)
    if not doubted:
        state = _with_mean(state, record)
    motion = [t for t in own if t.quantity not in HEALTH and not (doubted and needs_gnss(t.quantity))]
    return _each(state, motion, record)


def _each(
    state: AlertsState, thresholds: list[Threshold], record: Motion | StationStatus
) -> tuple[AlertsState, list[AlertEvent]]:
    phases, events = dict(state.thresholds), []
    for threshold in thresholds:
        phase = phases.get(threshold.threshold_id, ThresholdState())
        if isinstance(record, Motion):
            judged = _judge_motion(state, threshold, phase, record)
        else:
            judged = _judge_health(state, threshold, record)
        if judged is not None:
            phases[threshold.threshold_id], happened = step(phase, threshold, judged)
            events += happened
    return replace(state, thresholds=phases), events


def _judge_motion(state: AlertsState, threshold: Threshold, phase: ThresholdState, motion: Motion) -> Judgement | None:
    """The block's judgement; None where it has been judged, or cannot be."""
    if motion.t_first_gps_ns <= phase.t_decided_gps_ns:
        return None
    if needs_gnss(threshold.quantity) and motion.status not in TRUSTED:
        return None
    if threshold.quantity.startswith(RATE):
        times = np.array([(mean[0] - motion.t_first_gps_ns) * 1e-9 for mean in state.means])
        value = rate_value(threshold.quantity, times, np.array([mean[1:] for mean in state.means]))
        values, sigma = np.array([value]), 0.0
    else:
        block = block_values(threshold.quantity, motion)
        values, sigma = block.values, block.sigma
    if np.isnan(values).all():
        return None
    level = max(threshold.level, SIGNIFICANCE * sigma)
    above = np.flatnonzero(values > level)
    peak = float(np.nanmax(values))
    first, interval = motion.t_first_gps_ns, motion.interval_ns
    return Judgement(
        t_first_gps_ns=first,
        t_last_gps_ns=first + interval * len(motion.displacement_enu_m) - 1,
        t_cross_gps_ns=first + interval * int(above[0]) if len(above) else first,
        exceeds=len(above) > 0,
        clears=peak <= threshold.level - threshold.dead_band,
        value=peak,
        t_receive_ns=motion.t_receive_ns,
    )


def _judge_health(state: AlertsState, threshold: Threshold, status: StationStatus) -> Judgement:
    """Silence is measured on the receive clock, which is the event's clock here: a recording's own times may be years
    old.
    """
    heard_ns = state.t_epoch_receive_ns if threshold.quantity == DATA_GAP else state.t_position_receive_ns
    since_ns = heard_ns if heard_ns is not None else (state.t_begin_receive_ns or status.t_receive_ns)
    value = max(status.t_receive_ns - since_ns, 0) / NS_PER_S
    exceeds = value > threshold.level
    crossed = since_ns + round(threshold.level * NS_PER_S)
    return Judgement(
        t_first_gps_ns=status.t_receive_ns,
        t_last_gps_ns=status.t_receive_ns,
        t_cross_gps_ns=crossed if exceeds else status.t_receive_ns,
        exceeds=exceeds,
        clears=value <= threshold.level - threshold.dead_band,
        value=value,
        t_receive_ns=status.t_receive_ns,
    )


def _with_mean(state: AlertsState, motion: Motion) -> AlertsState:
    """Remember the block's mean displacement; a revision replaces it."""
    if motion.status not in TRUSTED or np.isnan(motion.displacement_enu_m).any():
        return state
    east, north, up = (float(v) for v in motion.displacement_enu_m.mean(axis=0))
    by_time = {mean[0]: mean for mean in state.means}
    by_time[motion.t_first_gps_ns] = (motion.t_first_gps_ns, east, north, up)
    oldest = max(by_time) - round(RATE_WINDOW_S * NS_PER_S)
    return replace(state, means=tuple(by_time[t] for t in sorted(by_time) if t >= oldest))
