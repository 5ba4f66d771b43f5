"""Arcs: what breaks them, at 1 Hz and at 30 s, and what must not."""

import numpy as np
import pytest

from plumbline.constants import LIGHT_MILLISECOND_M, SPEED_OF_LIGHT_M_S
from plumbline.positioning.cycle_slip import (
    BEGAN_GEOMETRY_FREE,
    BEGAN_NEW,
    BEGAN_TOLD,
    code_only_clock_jump_m,
    update_arcs,
)
from plumbline.positioning.preprocess import PAIR_DTYPE
from plumbline.positioning.state import no_arcs

F1, F2 = 1575.42e6, 1227.60e6
GAP_NS = 600 * 10**9


def _pair(t_s, cycles=(0.0, 0.0), ionosphere_m_s=0.0, **changes):
    """One satellite's pair at a time; the slant delay grows evenly."""
    pair = np.zeros(1, PAIR_DTYPE)
    pair["satellite"], pair["signal_1"], pair["signal_2"], pair["lock_time_s"] = 4, 1, 9, np.nan
    pair["frequency_1_hz"], pair["frequency_2_hz"] = F1, F2
    l1, l2 = (n * SPEED_OF_LIGHT_M_S / f for n, f in zip(cycles, (F1, F2), strict=True))
    delay = ionosphere_m_s * t_s
    pair["geometry_free_m"] = l1 - l2 + delay * ((F1 / F2) ** 2 - 1.0)
    pair["wide_lane_cycles"] = cycles[0] - cycles[1]
    pair["phase_m"], pair["code_m"] = 100.0, 0.0
    for name, value in changes.items():
        pair[name] = value
    return pair


def _follow(interval_s, sine=0.9, before=20, **change):
    """Whether the arc carries on where ``change`` happens and in the epoch after, in which slipped cycles stay."""
    arcs, ionosphere_m_s = no_arcs(), 0.0004
    for k in range(before):
        t_s = k * interval_s
        arcs, _, _ = update_arcs(arcs, _pair(t_s, ionosphere_m_s=ionosphere_m_s), np.array([sine]), _ns(t_s), GAP_NS)
    t_s = before * interval_s
    pair = _pair(t_s, **{"ionosphere_m_s": ionosphere_m_s, **change})
    arcs, first, arc_of_pair = update_arcs(arcs, pair, np.array([sine]), _ns(t_s), GAP_NS)
    assert arc_of_pair[0] == 0
    pair = _pair(t_s + interval_s, ionosphere_m_s=ionosphere_m_s, cycles=change.get("cycles", (0.0, 0.0)))
    if first[0] != 0:
        return False
    return update_arcs(arcs, pair, np.array([sine]), _ns(t_s + interval_s), GAP_NS)[1][0] == 0


def _ns(t_s):
    return 10**18 + round(t_s * 1e9)


@pytest.mark.parametrize("interval_s", [0.1, 1.0, 30.0])
def test_a_quiet_arc_carries_on(interval_s):
    """Oracle: no slip was put in; the ionosphere's even drift is followed."""
    assert _follow(interval_s)
    assert _follow(interval_s, sine=0.15)


@pytest.mark.parametrize("interval_s", [1.0, 30.0])
@pytest.mark.parametrize("cycles", [(1.0, 0.0), (0.0, 1.0), (9.0, 8.0), (5.0, 3.0)])
def test_slips_are_seen(interval_s, cycles):
    """Oracle: the cycles put in. What hides from geometry-free (9 and 7) moves the position's phase by decimetres."""
    assert not _follow(interval_s, cycles=cycles)


def test_a_common_cycle_is_seen_at_one_hertz():
    """Oracle: one cycle on both frequencies moves geometry-free by 5.4 cm and Melbourne-Wübbena not at all."""
    assert not _follow(1.0, cycles=(1.0, 1.0))


@pytest.mark.parametrize(
    "change",
    [
        {"lost_lock": True},
        {"half_cycle": 1},
        {"signal_2": 10},
        {"discontinuity_1": 1},
        {"lock_time_s": 0.0},
    ],
)
def test_what_receiver_and_corrections_say_is_believed(change):
    """Oracle: the flag put in; a lock time of zero cannot belong to an arc seen a second ago."""
    assert not _follow(1.0, **change)


def test_a_shrinking_lock_time_is_a_slip():
    """Oracle: DF402's meaning."""
    arcs, _, _ = update_arcs(no_arcs(), _pair(0.0, lock_time_s=64.0), np.ones(1), _ns(0.0), GAP_NS)
    for lock_s, carries_on in ((64.0, True), (128.0, True), (32.0, False)):
        _, previous, _ = update_arcs(arcs, _pair(1.0, lock_time_s=lock_s), np.ones(1), _ns(1.0), GAP_NS)
        assert bool(previous[0] == 0) is carries_on


def test_a_gap_is_bridged_up_to_its_limit():
    """Oracle: max_gap_ns; arcs not observed are kept meanwhile."""
    arcs, _, _ = update_arcs(no_arcs(), _pair(0.0), np.ones(1), _ns(0.0), GAP_NS)
    nothing = np.zeros(0, PAIR_DTYPE)
    for t_s, kept in ((300.0, 1), (601.0, 0)):
        meanwhile, previous, _ = update_arcs(arcs, nothing, np.zeros(0), _ns(t_s), GAP_NS)
        assert meanwhile.size == previous.size == kept
    assert update_arcs(arcs, _pair(600.0), np.ones(1), _ns(600.0), GAP_NS)[1][0] == 0
    assert update_arcs(arcs, _pair(601.0), np.ones(1), _ns(601.0), GAP_NS)[1][0] == -1


def test_whole_milliseconds_of_the_codes_alone_are_recognised():
    """Oracle: the jump put in; a movement of some metres is none."""
    arcs, _, _ = update_arcs(no_arcs(), _pair(0.0), np.ones(1), _ns(0.0), GAP_NS)
    for jump_m in (0.0, LIGHT_MILLISECOND_M, -2.0 * LIGHT_MILLISECOND_M):
        assert code_only_clock_jump_m(_pair(1.0, code_m=jump_m + 5.0), arcs, 0.0) == pytest.approx(jump_m)


@pytest.mark.parametrize("interval_s", [1.0, 30.0])
def test_a_phase_that_comes_back_was_an_outlier_and_keeps_its_ambiguity(interval_s):
    """Oracle: two cycles put in for one epoch; it is doubted, and not used, then."""
    arcs = no_arcs()
    for k in range(12):
        cycles = (2.0, 0.0) if k == 8 else (0.0, 0.0)
        pair = _pair(k * interval_s, cycles=cycles)
        arcs, previous, _ = update_arcs(arcs, pair, np.array([0.9]), _ns(k * interval_s), GAP_NS)
        assert bool(previous[0] == 0) is (k > 0)
        assert bool(arcs["doubted"][0] > 0) is (k == 8)


def test_a_slip_says_why_the_arc_began():
    """Oracle: the causes put in."""
    arcs = no_arcs()
    for k in range(12):
        pair = _pair(float(k), cycles=(2.0, 0.0) if k >= 8 else (0.0, 0.0), lost_lock=k == 11)
        arcs, previous, _ = update_arcs(arcs, pair, np.array([0.9]), _ns(float(k)), GAP_NS)
        if previous[0] < 0:
            assert (k, int(arcs["began"][0])) in {(0, BEGAN_NEW), (9, BEGAN_GEOMETRY_FREE), (11, BEGAN_TOLD)}
