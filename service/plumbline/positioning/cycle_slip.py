"""Arcs: which satellites' phases carry on from the epoch before, and which begin anew.

An ambiguity begins anew when the receiver says so (loss of lock, lock time, half-cycle flag), when the pair of signals
or the corrections' discontinuity counter changes, and when the data say so: the geometry-free phase leaves its own
extrapolation and stays away. For one epoch a phase that does is only doubted, and not used: when it comes back it was
an outlier, and the ambiguity is still good. Thresholds follow the interval between epochs, since at 30 s the ionosphere
moves centimetres and at 1 Hz millimetres. One cycle on both frequencies moves the geometry-free phase by 5 cm: what
hides there is left to the filter's own test (:mod:`plumbline.positioning.control`), as are the codes.
"""

from typing import Final

import numpy as np
from numba import njit

from plumbline.constants import LIGHT_MILLISECOND_M
from plumbline.positioning.state import ARC_DTYPE, Records
from plumbline.records import Floats, Ints

_PHASE_SIGMA_M: Final = 0.002  # of one phase at the zenith, for the geometry-free test
_IONOSPHERE_M_S: Final = 0.0007  # unforeseen geometry-free rate at the zenith: 0.4 TECU a minute
_IONOSPHERE_FIRST_M_S: Final = 0.002  # the same when no rate is known yet
_FACTOR: Final = 4.0  # thresholds in standard deviations
_RATE_TIME_CONSTANT_S: Final = 30.0
_LOWEST_SINE: Final = 0.1
_DOUBTED_LIMIT: Final = 3  # epochs in a row that agree neither with the arc nor with each other

#: Why an arc began: the satellite rose or was away for long; receiver or corrections say so; the geometry-free phase
#: stayed where it had jumped to; the filter refused the phase, alike, epoch after epoch.
BEGAN_NEW, BEGAN_TOLD, BEGAN_GEOMETRY_FREE, BEGAN_REFUSED = range(4)


@njit(cache=True)
def code_only_clock_jump_m(pairs: Records, arcs: Records, phase_jump_m: float) -> float:
    """Whole milliseconds (as metres) by which the codes, but not the phases, have jumped since the arcs' last epoch."""
    changes = np.zeros(pairs.size)
    n, arc = 0, 0
    for pair in pairs:
        while arc < arcs.size and arcs[arc].satellite < pair.satellite:
            arc += 1
        if arc < arcs.size and arcs[arc].satellite == pair.satellite and not np.isnan(pair.phase_m):
            changes[n] = arcs[arc].phase_minus_code_m - (pair.phase_m + phase_jump_m - pair.code_m)
            n += 1
    if n == 0:
        return 0.0
    return np.round(np.median(changes[:n]) / LIGHT_MILLISECOND_M) * LIGHT_MILLISECOND_M


@njit(cache=True)
def _told(pair, arc, dt_s: float) -> bool:  # type: ignore[no-untyped-def]
    """Whether receiver or corrections say that the ambiguity is another."""
    if pair.signal_1 != arc.signal_1 or pair.signal_2 != arc.signal_2:
        return True
    if pair.discontinuity_1 != arc.discontinuity_1 or pair.discontinuity_2 != arc.discontinuity_2:
        return True
    if pair.lost_lock or pair.half_cycle != arc.half_cycle:
        return True
    if np.isnan(pair.lock_time_s):
        return False
    # The indicator holds at least half the true lock time (DF402: powers of two).
    return bool(pair.lock_time_s < arc.lock_time_s - 1e-3 or 2.0 * pair.lock_time_s + 0.064 < dt_s)


@njit(cache=True)
def _jumped(pair, arc, from_m: float, from_ns: int, t_ns: int, sine: float) -> bool:  # type: ignore[no-untyped-def]
    """Whether the geometry-free phase has left its extrapolation from a value at a time."""
    dt_s = (t_ns - from_ns) * 1e-9
    known_rate = not np.isnan(arc.geometry_free_rate_m_s)
    rate = arc.geometry_free_rate_m_s if known_rate else 0.0
    drift = (_IONOSPHERE_M_S if known_rate else _IONOSPHERE_FIRST_M_S) * dt_s
    limit = (2.0 * _FACTOR * _PHASE_SIGMA_M + drift) / sine
    return bool(abs(pair.geometry_free_m - from_m - rate * dt_s) > limit)


@njit(cache=True)
def _slipped(arc, pair, t_ns: int, sine: float) -> bool:  # type: ignore[no-untyped-def]
    """Doubt a phase that has jumped, in place; whether it is where it was when it was doubted before: a slip."""
    if not _jumped(pair, arc, arc.geometry_free_m, arc.t_last_ns, t_ns, sine):
        arc.doubted = 0
        return False
    stays = arc.doubted > 0 and not _jumped(pair, arc, arc.geometry_free_doubted_m, arc.t_doubted_ns, t_ns, sine)
    arc.doubted += 1
    arc.geometry_free_doubted_m, arc.t_doubted_ns = pair.geometry_free_m, t_ns
    return bool(stays or arc.doubted >= _DOUBTED_LIMIT)


@njit(cache=True)
def _carry_on(arc, pair, t_ns: int, phase_minus_code_m: float) -> None:  # type: ignore[no-untyped-def]
    """Bring an arc's record to this epoch, unless its phase is doubted."""
    arc.lock_time_s = pair.lock_time_s
    if arc.doubted > 0:
        return
    dt_s = (t_ns - arc.t_last_ns) * 1e-9
    rate = (pair.geometry_free_m - arc.geometry_free_m) / dt_s
    gain = dt_s / (dt_s + _RATE_TIME_CONSTANT_S)
    if np.isnan(arc.geometry_free_rate_m_s):
        arc.geometry_free_rate_m_s = rate * gain if dt_s < _RATE_TIME_CONSTANT_S else rate
    elif dt_s < _RATE_TIME_CONSTANT_S:
        arc.geometry_free_rate_m_s += gain * (rate - arc.geometry_free_rate_m_s)
    else:
        arc.geometry_free_rate_m_s = rate
    arc.geometry_free_m = pair.geometry_free_m
    arc.phase_minus_code_m = phase_minus_code_m
    arc.t_last_ns = t_ns


@njit(cache=True)
def _begin(arc, pair, t_ns: int, phase_minus_code_m: float) -> None:  # type: ignore[no-untyped-def]
    """Begin an arc with this epoch."""
    arc.satellite, arc.signal_1, arc.signal_2 = pair.satellite, pair.signal_1, pair.signal_2
    arc.discontinuity_1, arc.discontinuity_2 = pair.discontinuity_1, pair.discontinuity_2
    arc.half_cycle, arc.estimated = pair.half_cycle, False
    arc.t_first_ns, arc.t_last_ns = t_ns, t_ns
    arc.lock_time_s = pair.lock_time_s
    arc.geometry_free_m, arc.geometry_free_rate_m_s = pair.geometry_free_m, np.nan
    arc.phase_minus_code_m = phase_minus_code_m
    arc.wind_up_cycles = np.nan
    arc.code_count, arc.doubted, arc.refused = 0, 0, 0


@njit(cache=True)
def _merge(arcs, pairs, sine, t_ns, max_gap_ns, out, previous, arc_of_pair):  # type: ignore[no-untyped-def]
    """Merge old arcs and this epoch's pairs, both ordered by satellite, into ``out``; returns how many there are."""
    made, old = 0, 0
    for i in range(pairs.size + 1):
        until = pairs[i].satellite if i < pairs.size else 32_767
        while old < arcs.size and arcs[old].satellite < until:  # not observed now: kept for a while
            if t_ns - arcs[old].t_last_ns <= max_gap_ns:
                out[made] = arcs[old]
                previous[made] = old
                made += 1
            old += 1
        if i == pairs.size:
            break
        pair = pairs[i]
        arc_of_pair[i] = -1
        same = old < arcs.size and arcs[old].satellite == pair.satellite
        if np.isnan(pair.phase_m):
            continue
        phase_minus_code_m = pair.phase_m - pair.code_m
        dt_s = (t_ns - arcs[old].t_last_ns) * 1e-9 if same else 0.0
        sine_i = max(sine[i], _LOWEST_SINE)
        keep = same and 0.0 < dt_s <= max_gap_ns * 1e-9
        began = BEGAN_NEW
        if keep:
            out[made] = arcs[old]
            if _told(pair, arcs[old], dt_s):
                began = BEGAN_TOLD
            elif _slipped(out[made], pair, t_ns, sine_i):
                began = BEGAN_GEOMETRY_FREE
        if keep and began == BEGAN_NEW:
            previous[made] = old
            _carry_on(out[made], pair, t_ns, phase_minus_code_m)
        else:
            _begin(out[made], pair, t_ns, phase_minus_code_m)
            out[made].began = began
            previous[made] = -1
        arc_of_pair[i] = made
        made += 1
        old += 1 if same else 0
    return made


def update_arcs(
    arcs: Records, pairs: Records, sine_elevation: Floats, t_gps_ns: int, max_gap_ns: int
) -> tuple[Records, Ints, Ints]:
    """Arcs after this epoch.

    ``sine_elevation`` (n,) of the pairs (NaN: not known, taken as low). Returns the new arcs (k,), for each the index
    of the old arc whose ambiguity it carries on (−1: a new ambiguity), and for each pair the index of its arc (−1: no
    phase).
    """
    room = arcs.size + pairs.size
    out, previous = np.zeros(room, ARC_DTYPE), np.empty(room, np.int64)
    arc_of_pair = np.empty(pairs.size, np.int64)
    sine = np.where(np.isnan(sine_elevation), _LOWEST_SINE, sine_elevation)
    made = _merge(arcs, pairs, sine, t_gps_ns, max_gap_ns, out, previous, arc_of_pair)
    return out[:made], previous[:made], arc_of_pair
