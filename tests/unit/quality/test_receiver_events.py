"""Counting what epochs show. Oracle: epochs made by hand whose every event is known."""

from dataclasses import replace

import numpy as np

from plumbline.constants import LIGHT_MILLISECOND_M
from plumbline.gps_time import NS_PER_S
from plumbline.quality import receiver_events as events
from plumbline.quality.receiver_events import ReceiverWatch, satellite_counts
from plumbline.records import Epoch, Solution, Status
from plumbline.signals import System, satellite_id, signal_id

N = 6
T0 = 1_400_000_000 * NS_PER_S


def epoch(k: int) -> Epoch:
    """Six GLONASS satellites, ranges that change by up to 800 m/s."""
    return Epoch(
        t_gps_ns=T0 + k * NS_PER_S,
        t_receive_ns=T0 + k * NS_PER_S,
        satellite=np.array([satellite_id(System.GLONASS, i + 1) for i in range(N)], np.int16),
        signal=np.full(N, signal_id(System.GLONASS, "1C"), np.int16),
        pseudorange_m=2.2e7 + np.linspace(-800.0, 800.0, N) * k,
        carrier_phase_cycles=np.ones(N),
        doppler_hz=np.zeros(N),
        cn0_db_hz=np.full(N, 45.0),
        lock_time_s=np.full(N, float(k)),
        half_cycle_ambiguous=np.zeros(N, bool),
        glonass_channel=np.arange(N, dtype=np.int8),
    )


def counted(*epochs: Epoch) -> dict[str, int]:
    watch = ReceiverWatch()
    for one in epochs:
        watch.see(one)
    return dict(watch.counters)


def test_quiet_epochs_count_nothing() -> None:
    assert counted(*(epoch(k) for k in range(200))) == {}
    assert counted(epoch(0), epoch(30), epoch(60)) == {}


def test_each_event_is_counted_once() -> None:
    a, b, c = epoch(10), epoch(11), epoch(12)
    fell = replace(b, lock_time_s=np.where(np.arange(N) < 2, 0.0, b.lock_time_s))
    assert counted(a, fell) == {events.LOCK_LOST: 2}
    flagged = replace(b, loss_of_lock=np.arange(N) == 3)
    assert counted(a, flagged) == {events.LOCK_LOST: 1}
    half = replace(b, half_cycle_ambiguous=np.arange(N) == 5)
    assert counted(a, half) == {events.HALF_CYCLE: 1}
    for sign in (-1.0, 3.0):
        jumped = [replace(e, pseudorange_m=e.pseudorange_m + sign * LIGHT_MILLISECOND_M) for e in (b, c)]
        assert counted(a, *jumped) == {events.CLOCK_JUMP: 1}
    other = replace(b, glonass_channel=b.glonass_channel + np.int8(1))
    assert counted(a, other, c) == {events.CHANNEL_CHANGED: 2 * N}
    weak = replace(b, cn0_db_hz=b.cn0_db_hz - 10.0)
    assert counted(a, weak, c) == {events.WEAKER: 1}
    one_weak = replace(b, cn0_db_hz=np.where(np.arange(N) == 0, 20.0, b.cn0_db_hz))
    assert counted(a, one_weak, c) == {}


def test_satellites_marked_unhealthy_or_in_shadow_are_counted() -> None:
    seen = Solution("a", T0, T0, Status.PPP_FLOAT, "", extras={"unhealthy_satellites": 2.0, "eclipsed_satellites": 0.0})
    assert satellite_counts(seen) == {"satellite_unhealthy": 2}
