"""Epochs without a precise position: a single-point one, or the status that says what lacks."""

from dataclasses import replace

import numpy as np

from plumbline.positioning.gather import Inputs, pairs_of, point_of
from plumbline.positioning.reasons import missing_systems, too_few
from plumbline.positioning.satellites import Cause, SatelliteSource, SatelliteStates
from plumbline.positioning.solutions import letters_of, no_position, point_solution
from plumbline.positioning.state import POSITION, PppState, Records
from plumbline.positioning.tracking import sines_from, track
from plumbline.records import Solution, Status

MIN_SATELLITES = 4  # and one more for every system beyond the first
_WEAK = "satellites with corrections too few or badly placed"


def enough(pairs: Records) -> bool:
    """Whether pairs can give a position and a clock for each of their systems."""
    return bool(pairs.size >= MIN_SATELLITES - 1 + len(set(pairs["system"].tolist())))


def fall_back(state: PppState, inputs: Inputs, source: SatelliteSource) -> tuple[PppState, Solution]:
    """The epoch without the filter; where it has begun, its arcs are kept up so that its ambiguities survive."""
    epoch = inputs.epoch
    pairs = pairs_of(epoch, source, state.arcs, precise=False, systems=inputs.settings.systems)
    states = source.broadcast(epoch.t_gps_ns, epoch.t_receive_ns, pairs["satellite"].copy(), pairs["range_m"].copy())
    solution = _point(state, inputs, pairs, states)
    if state.t_gps_ns is None:
        return replace(state, t_last_epoch_ns=epoch.t_gps_ns), solution
    sine = np.full(inputs.pairs.size, np.nan)
    if np.array_equal(pairs["satellite"], inputs.pairs["satellite"]):
        sine = sines_from(state.x[POSITION], states.position_ecef_m)
    return track(state, inputs.pairs, sine, epoch.t_gps_ns, inputs.max_gap_ns).state, solution


def instead(state: PppState, inputs: Inputs, source: SatelliteSource, precise: Solution) -> Solution:
    """A single point in place of a precise position that is worse: few satellites with corrections, badly placed."""
    inputs = replace(inputs, missing="; ".join(text for text in (_WEAK, inputs.missing) if text))
    epoch = inputs.epoch
    pairs = pairs_of(epoch, source, state.arcs, precise=False, systems=inputs.settings.systems)
    states = source.broadcast(epoch.t_gps_ns, epoch.t_receive_ns, pairs["satellite"].copy(), pairs["range_m"].copy())
    point = _point(state, inputs, pairs, states)
    if point.covariance_enu_m2 is None or precise.covariance_enu_m2 is None:
        return precise
    return point if np.trace(point.covariance_enu_m2) < np.trace(precise.covariance_enu_m2) else precise


def _point(state: PppState, inputs: Inputs, pairs: Records, states: SatelliteStates) -> Solution:
    """A single-point position, or the status that says what lacks."""
    epoch, facts = inputs.epoch, inputs.facts
    usable = int(np.count_nonzero(inputs.states.cause == Cause.USABLE))
    why = inputs.missing or too_few(usable, MIN_SATELLITES, "")
    point = point_of(pairs, states, state.x[POSITION] if state.t_gps_ns is not None else None)
    if point is not None:
        reference = facts.reference_position_ecef_m or state.reference_position_ecef_m
        return point_solution(epoch, facts, reference, point, letters_of(pairs["system"][point.used]), why)
    n = int(np.count_nonzero(states.cause == Cause.USABLE))
    if n == 0:
        status = Status.NO_EPHEMERIS if (states.cause == Cause.NO_EPHEMERIS).any() else Status.NO_CORRECTIONS
        return no_position(epoch, facts, status, missing_systems(inputs.settings.systems, pairs, states) or why)
    if n < MIN_SATELLITES:
        return no_position(epoch, facts, Status.TOO_FEW_SATELLITES, too_few(n, MIN_SATELLITES, why), n)
    return no_position(epoch, facts, Status.REJECTED, "the codes contradict each other; " + why, n)
