"""Which week a stream means. Oracle: the calendar of the recordings and closed forms at the end of a week."""

from plumbline.epochs.time_base import TimeBase
from plumbline.gps_time import NS_PER_S, WEEK_NS, gps_ns

HOUR_NS = 3600 * NS_PER_S
NOW = gps_ns(2446, 10_000)


def test_live_nothing_moves() -> None:
    base = TimeBase()
    assert not base.learn(NOW + 2 * HOUR_NS, NOW)
    assert base.known
    assert base.near(NOW) == NOW


def test_a_recording_is_put_into_its_own_week() -> None:
    base = TimeBase()
    recorded = gps_ns(2009, 604_218)
    base.observe(recorded)
    assert base.learn(recorded - HOUR_NS // 2, NOW)
    assert base.near(NOW) == recorded
    assert base.near(NOW + 5 * NS_PER_S) == recorded + 5 * NS_PER_S


def test_an_ephemeris_across_the_end_of_the_week_settles_nothing() -> None:
    """At 604,218 s an encoder that sends the week of transmission with a toe of 0 s says 'a week ago'."""
    base = TimeBase()
    recorded = gps_ns(2009, 604_218)
    base.observe(recorded)
    assert not base.learn(gps_ns(2009, 0), NOW)
    assert not base.known
    assert base.learn(recorded - HOUR_NS, NOW)
    assert base.near(NOW) == recorded


def test_without_anything_better_reference_times_decide() -> None:
    base = TimeBase()
    base.observe(gps_ns(0, 604_218))
    moved = [base.learn(gps_ns(2010, 0), NOW) for _ in range(40)]
    assert moved.count(True) == 1
    assert base.near(NOW) == gps_ns(2010, 0) - (WEEK_NS - 604_218 * NS_PER_S)
