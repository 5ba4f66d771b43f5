"""Availability. Oracle: counts of made-up days whose every epoch is known."""

import pytest

from plumbline.gps_time import NS_PER_S
from plumbline.quality.availability import SERVER_DOWN, SILENCE, availability, day_start_ns
from plumbline.records import Solution, Status

T0 = 1_400_000_000 * NS_PER_S


def solution(second: float, status: Status = Status.PPP_FLOAT, reason: str = "", latency_s: float = 0.5) -> Solution:
    t = T0 + round(second * NS_PER_S)
    return Solution("a", t, t + round(latency_s * NS_PER_S), status, reason)


def test_every_epoch_is_counted_once_and_every_loss_has_a_reason() -> None:
    day = [solution(s, Status.CONVERGING, "") for s in range(10)]
    day += [solution(s) for s in range(10, 40)]
    day += [solution(s, Status.NO_CORRECTIONS, "no corrections for GPS") for s in range(40, 50)]
    day += [solution(s, Status.PPP_FIXED, latency_s=2.0) for s in range(70, 100)]
    made = availability(day, T0, T0 + 120 * NS_PER_S)
    assert (made.expected, made.received, made.solved, made.converged, made.fixed) == (120, 80, 70, 60, 30)
    assert made.loss == {"ppp_converging": 10, "no corrections for GPS": 10, SILENCE: 40}
    assert sum(made.loss.values()) + made.converged == made.expected
    gaps = [((g.t_first_gps_ns - T0) // NS_PER_S, g.epochs, g.reason) for g in made.gaps]
    assert gaps == [(40, 10, "no corrections for GPS"), (50, 20, SILENCE), (100, 20, SILENCE)]
    assert made.latency_s[50] == pytest.approx(0.5)
    assert made.latency_s[99] == pytest.approx(2.0)


def test_the_interval_is_the_stations_own() -> None:
    made = availability([solution(30.0 * k) for k in range(10)], T0, T0 + 300 * NS_PER_S)
    assert (made.interval_s, made.expected, made.received, made.gaps) == (30.0, 10, 10, ())


def test_a_day_without_anything_is_one_gap() -> None:
    made = availability([], T0, T0 + 60 * NS_PER_S)
    assert (made.expected, made.received, made.loss) == (60, 0, {SILENCE: 60})
    assert [g.epochs for g in made.gaps] == [60]
    assert made.latency_s == {}


def test_epochs_missed_while_the_server_was_down_say_so() -> None:
    came = [solution(s) for s in (*range(20), *range(60, 80))]
    down = [(T0 + 30 * NS_PER_S, T0 + 50 * NS_PER_S), (T0 + 1000 * NS_PER_S, T0 + 2000 * NS_PER_S)]
    made = availability(came, T0, T0 + 80 * NS_PER_S, down)
    gaps = [((g.t_first_gps_ns - T0) // NS_PER_S, g.epochs, g.reason) for g in made.gaps]
    assert gaps == [(20, 10, SILENCE), (30, 20, SERVER_DOWN), (50, 10, SILENCE)]
    assert made.loss == {SILENCE: 20, SERVER_DOWN: 20}
    assert sum(made.loss.values()) + made.converged == made.expected


def test_days_are_those_of_utc() -> None:
    start = day_start_ns(T0)
    assert start <= T0 < start + 86_400 * NS_PER_S
    assert (start // NS_PER_S - 18) % 86_400 == 0  # 2024: GPS is 18 s ahead, and its epoch was at midnight
    assert day_start_ns(start) == start
    assert day_start_ns(start - 1) == start - 86_400 * NS_PER_S
