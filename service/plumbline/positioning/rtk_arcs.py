"""Arcs of relative positioning: which ambiguities carry on from the epoch before, and which begin anew.

The receivers' own words come first (loss of lock, lock time, half cycles). Then the data's: between two epochs the
single differences of phase change by the antenna's motion and a clock a group alone, whatever the ambiguities
(:mod:`plumbline.positioning.rtk_changes`). A phase whose change does not fit is left out; if it stays off by the same
amount it has slipped and its ambiguity begins anew, if it comes back it was an outlier and its ambiguity is still good.
"""

from typing import Final, NamedTuple

import numpy as np
from numba import njit

from plumbline.positioning.rtk_changes import ChangeTest, Verdicts, no_verdicts, test_codes, test_phases
from plumbline.positioning.rtk_state import RTK_ARC_DTYPE, RtkState
from plumbline.positioning.state import Records
from plumbline.records import Floats, Ints, Verdict

REFUSED_LIMIT: Final = 3  # epochs in a row after which a phase that does not fit begins a new ambiguity
_CODE_REFUSED_LIMIT: Final = 4  # and a code is believed at its new level
_ACCEPTED, _SLIP = int(Verdict.ACCEPTED), int(Verdict.SLIP)


class Tracked(NamedTuple):
    """An epoch's arcs, one for each row with a phase, and what the changes since the epoch before say."""

    arcs: Records  # (k,)
    previous: Ints  # (k,) the old arc that each carries on, −1: a new ambiguity
    phases: Verdicts
    codes: Verdicts
    motion: tuple[Floats, Floats] | None  # (3,) since the epoch before and its covariance, where the phases tell it
    moved: bool  # an antenna that was thought to stand has moved
    contradiction: bool  # the changes contradict each other altogether: all ambiguities begin anew


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
def _candidates(rows, arcs, t_ns, t_last_ns, max_gap_ns, previous, same):  # type: ignore[no-untyped-def]
    """Fill, for each row, the old arc that it may carry on, and the old arc of the same signals; −1 where none."""
    start = 0
    for i in range(rows.size):
        previous[i], same[i] = -1, -1
        row = rows[i]
        while start < arcs.size and arcs[start].satellite < row.satellite:
            start += 1
        k = start
        while k < arcs.size and arcs[k].satellite == row.satellite:
            arc = arcs[k]
            if arc.signal == row.signal and arc.base_signal == row.base_signal and arc.t_last_ns == t_last_ns:
                dt_ns = t_ns - arc.t_last_ns
                if dt_ns <= max_gap_ns:
                    same[i] = k
                    if row.phase_weight > 0.0 and not _told(row, arc, dt_ns * 1e-9):
                        previous[i] = k
            k += 1


@njit(cache=True)
def _make(rows, arcs, previous, same, off, off_m, t_ns, out, carried):  # type: ignore[no-untyped-def]
    """Fill the new arcs, one for each row with a phase, and the rows' arc numbers; returns how many."""
    made = 0
    for i in range(rows.size):
        row = rows[i]
        row.arc = -1
        if row.phase_weight == 0.0:
            continue
        new = out[made]
        if previous[i] >= 0:
            out[made] = arcs[previous[i]]
            new.count += 1
        else:
            new.satellite, new.signal, new.base_signal = row.satellite, row.signal, row.base_signal
            new.half_cycle, new.t_first_ns, new.count = row.half_cycle, t_ns, 1
            new.held, new.value, new.refused = False, 0, 0
            new.offset_cycles = np.round((row.phase_oc_m - row.code_oc_m) / row.wavelength_m)
            new.code_residual_m = np.nan
            if same[i] >= 0:
                old = arcs[same[i]]
                new.code_residual_m, new.code_square, new.code_count = (
                    old.code_residual_m, old.code_square, old.code_count
                )  # fmt: skip
                new.code_off, new.code_off_m = old.code_off, old.code_off_m
        new.off = new.off + 1 if off[i] and previous[i] >= 0 else 0
        new.off_m = off_m[i] if new.off > 0 else 0.0
        new.integer = row.integer
        new.t_last_ns = t_ns
        new.lock_time_s, new.base_lock_time_s = row.lock_time_s, row.base_lock_time_s
        carried[made] = previous[i]
        row.arc = made
        made += 1
    return made


def update_arcs(
    state: RtkState, rows: Records, t_gps_ns: int, max_gap_ns: int, n_groups: int, test: ChangeTest
) -> Tracked:  # fmt: skip
    """Arcs of this epoch, one for each row with a phase (``rows["arc"]`` is set in place)."""
    previous, same = np.empty(rows.size, np.int64), np.empty(rows.size, np.int64)
    t_last_ns = -1 if state.t_gps_ns is None else state.t_gps_ns
    _candidates(rows, state.arcs, t_gps_ns, t_last_ns, max_gap_ns, previous, same)
    phases, codes, motion, moved, agree = no_verdicts(rows.size), no_verdicts(rows.size), None, False, True
    if (same >= 0).any():
        dt_s = (t_gps_ns - t_last_ns) * 1e-9
        found, phases = test_phases(rows, state.arcs, previous, dt_s, n_groups, test, REFUSED_LIMIT)
        told = bool(found.regular and found.degrees_of_freedom >= 1.0)
        agree, moved = bool(found.explained or not told), bool(told and found.moved)
        motion = (found.b_m, found.covariance_m2) if told and agree else None
        previous[(phases.verdict == _SLIP) | (not agree)] = -1
        if motion is not None:
            codes = test_codes(rows, state.arcs, same, motion, n_groups, test, _CODE_REFUSED_LIMIT)
    out, carried = np.zeros(rows.size, RTK_ARC_DTYPE), np.empty(rows.size, np.int64)
    off = phases.verdict != _ACCEPTED
    made = _make(rows, state.arcs, previous, same, off, phases.error_m, t_gps_ns, out, carried)
    if not agree:
        phases = no_verdicts(rows.size)
    return Tracked(out[:made], carried[:made], phases, codes, motion, moved, not agree)


@njit(cache=True)
def keep_residuals(rows: Records, arcs: Records, moved_m: Floats, codes: Verdicts) -> None:
    """Remember phases and codes at the position solved (approximate position + ``moved_m``), in place.

    Of one that is off, what it would be without: its next change is again counted from where it should be.
    """
    for i in range(rows.size):
        row = rows[i]
        if row.arc < 0:
            continue
        arc, along = arcs[row.arc], 0.0
        for k in range(3):
            along += row.line[k] * moved_m[k]
        arc.residual_m = row.phase_oc_m + along - arc.off_m
        if codes.verdict[i] == _ACCEPTED or codes.verdict[i] == _SLIP:
            arc.code_off, arc.code_off_m = 0, 0.0
        else:
            arc.code_off, arc.code_off_m = arc.code_off + 1, codes.error_m[i]
        arc.code_residual_m = row.code_oc_m + along - arc.code_off_m
        if not np.isnan(codes.square[i]):
            arc.code_square, arc.code_count = codes.square[i], arc.code_count + 1
