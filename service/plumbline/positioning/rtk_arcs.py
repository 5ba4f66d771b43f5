"""Arcs of relative positioning: which ambiguities carry on from the epoch before, and which begin anew.

The receivers' own words come first (loss of lock, lock time, half cycles). Then the data's: between two epochs the
single differences of phase change by the antenna's motion and a clock a group alone, whatever the ambiguities; a row
whose change does not fit the motion that the others agree on has slipped. That sees a single cycle on any frequency,
also the same number on all, from two epochs with five or more satellites, at any interval; it holds the geometry-free
test within it, since all of a satellite's frequencies must fit the same motion.
"""

from typing import Final

import numpy as np
from numba import njit

from plumbline.positioning.rtk_filter import snoop
from plumbline.positioning.rtk_state import RTK_ARC_DTYPE, RtkState
from plumbline.positioning.state import Records
from plumbline.records import Floats, Ints

REFUSED_LIMIT: Final = 3  # epochs in a row after which a phase that does not fit begins a new ambiguity
_W_LIMIT: Final = 5.0
_LEAST_SIGMA_M: Final = 0.004  # of a change: multipath moves slowly, but moves
_WANDER_M_S: Final = 0.0005  # and further with time


@njit(cache=True)
def _told(row, arc, dt_s):  # type: ignore[no-untyped-def]
    """Whether a receiver says that the ambiguity is another."""
    if row.lost_lock or row.half_cycle != arc.half_cycle or arc.refused >= REFUSED_LIMIT:
        return True
    for now, before in ((row.lock_time_s, arc.lock_time_s), (row.base_lock_time_s, arc.base_lock_time_s)):
        # The indicator holds at least half the true lock time (DF402: powers of two).
        if not np.isnan(now) and (now < before - 1e-3 or 2.0 * now + 0.064 < dt_s):
            return True
    return False


@njit(cache=True)
def _candidates(rows, arcs, t_ns, t_last_ns, max_gap_ns, previous):  # type: ignore[no-untyped-def]
    """Fill, for each row, the old arc that it may carry on, −1 where none."""
    start = 0
    for i in range(rows.size):
        previous[i] = -1
        row = rows[i]
        while start < arcs.size and arcs[start].satellite < row.satellite:
            start += 1
        if row.phase_weight == 0.0:
            continue
        k = start
        while k < arcs.size and arcs[k].satellite == row.satellite:
            arc = arcs[k]
            if arc.signal == row.signal and arc.base_signal == row.base_signal and arc.t_last_ns == t_last_ns:
                dt_ns = t_ns - arc.t_last_ns
                if dt_ns <= max_gap_ns and not _told(row, arc, dt_ns * 1e-9):
                    previous[i] = k
            k += 1


@njit(cache=True)
def _drop_slips(rows, arcs, previous, dt_s, n_groups):  # type: ignore[no-untyped-def]
    """Mark rows whose change does not fit the others' as new; returns (b, covariance, slips, regular)."""
    n = rows.size
    v, w, line, group = np.zeros(n), np.zeros(n), np.zeros((n, 3)), np.zeros(n, np.int64)
    least = _LEAST_SIGMA_M**2 + (_WANDER_M_S * dt_s) ** 2
    for i in range(n):
        row = rows[i]
        group[i] = row.group
        for k in range(3):
            line[i, k] = row.line[k]
        if previous[i] >= 0:
            v[i] = row.phase_oc_m - arcs[previous[i]].residual_m
            w[i] = 1.0 / max(2.0 / row.phase_weight, least)
    b, covariance, use, _, _, redundancy, regular = snoop(line, v, w, group, n_groups, _W_LIMIT, n // 3)
    slips = 0
    if regular and redundancy > 0.5:
        for i in range(n):
            if previous[i] >= 0 and not use[i]:
                previous[i] = -1
                slips += 1
    return b, covariance, slips, regular and redundancy > 0.5


@njit(cache=True)
def _make(rows, arcs, previous, t_ns, out, carried):  # type: ignore[no-untyped-def]
    """Fill the new arcs, one for each row with a phase, and the rows' arc numbers; returns how many."""
    made = 0
    for i in range(rows.size):
        row = rows[i]
        row.arc = -1
        if row.phase_weight == 0.0:
            continue
        if previous[i] >= 0:
            out[made] = arcs[previous[i]]
            out[made].count += 1
        else:
            new = out[made]
            new.satellite, new.signal, new.base_signal = row.satellite, row.signal, row.base_signal
            new.half_cycle, new.t_first_ns, new.count = row.half_cycle, t_ns, 1
            new.held, new.value, new.refused = False, 0, 0
            new.offset_cycles = np.round((row.phase_oc_m - row.code_oc_m) / row.wavelength_m)
        out[made].integer = row.integer
        out[made].t_last_ns = t_ns
        out[made].lock_time_s, out[made].base_lock_time_s = row.lock_time_s, row.base_lock_time_s
        carried[made] = previous[i]
        row.arc = made
        made += 1
    return made


def update_arcs(
    state: RtkState, rows: Records, t_gps_ns: int, max_gap_ns: int, n_groups: int
) -> tuple[Records, Ints, int, tuple[Floats, Floats] | None]:
    """Arcs of this epoch, one for each row with a phase (``rows["arc"]`` is set in place).

    Returns the arcs, for each the old arc that it carries on (−1: a new ambiguity), how many slips the data showed, and
    the motion since the epoch before with its covariance (None where the phases do not tell it).
    """
    previous = np.empty(rows.size, np.int64)
    t_last_ns = -1 if state.t_gps_ns is None else state.t_gps_ns
    _candidates(rows, state.arcs, t_gps_ns, t_last_ns, max_gap_ns, previous)
    slips, motion = 0, None
    if (previous >= 0).any():
        b, covariance, slips, told = _drop_slips(rows, state.arcs, previous, (t_gps_ns - t_last_ns) * 1e-9, n_groups)
        motion = (b, covariance) if told else None
    out, carried = np.zeros(rows.size, RTK_ARC_DTYPE), np.empty(rows.size, np.int64)
    made = _make(rows, state.arcs, previous, t_gps_ns, out, carried)
    return out[:made], carried[:made], slips, motion


@njit(cache=True)
def keep_residuals(rows: Records, arcs: Records, moved_m: Floats) -> None:
    """Remember the phases' residuals at the position solved (approximate position + ``moved_m``), in place."""
    for row in rows:
        if row.arc >= 0:
            along = 0.0
            for k in range(3):
                along += row.line[k] * moved_m[k]
            arcs[row.arc].residual_m = row.phase_oc_m + along
