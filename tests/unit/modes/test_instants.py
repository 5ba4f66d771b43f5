"""Epochs of several antennas as instants.

Oracle: by hand: who is waited for, until when; and that the instants do not depend on how often time is told.
"""

import numpy as np
import pytest

from plumbline.modes.instants import Instants
from plumbline.records import Epoch

MS = 1_000_000
S = 1000 * MS
T0 = 1_384_000_000 * S
WAIT = 300 * MS


def epoch(t_ms: int, received_ms: int) -> Epoch:
    nothing = np.zeros(0)
    ids = np.zeros(0, np.int16)
    flags = np.zeros(0, np.bool_)
    return Epoch(
        T0 + t_ms * MS, T0 + received_ms * MS, ids, ids, nothing, nothing, nothing, nothing, nothing, flags,
        np.zeros(0, np.int8),
    )  # fmt: skip


Arrivals = list[tuple[int, int, int]]  # received ms, antenna, epoch ms


def run(arrivals: Arrivals, n: int, tick_ms: int | None = None, end_ms: int = 10_000) -> list[tuple[int, str, int]]:
    """(epoch ms, which antennas, complete ms) of each instant that leaves."""
    instants, left = Instants(n), []

    def take(now_ms: int) -> None:
        while (instant := instants.due(T0 + now_ms * MS, WAIT)) is not None:
            instants.leave(instant)
            seen = "".join("-" if e is None else str(k + 1) for k, e in enumerate(instant.epochs))
            left.append(((instant.t_gps_ns - T0) // MS, seen, (instant.complete_ns - T0) // MS))

    last_ms = 0
    for received_ms, antenna, t_ms in sorted(arrivals):
        for now_ms in range(last_ms, received_ms, tick_ms) if tick_ms else ():
            take(now_ms)
        take(received_ms)
        instants.add(epoch(t_ms, received_ms), antenna)
        take(received_ms)
        last_ms = received_ms
    take(end_ms)
    return left


def steady(n: int, epochs: int, delays_ms: list[int]) -> Arrivals:
    return [(100 * k + delays_ms[a], a, 100 * k) for k in range(epochs) for a in range(n)]


def test_an_instant_leaves_when_the_last_antenna_is_in() -> None:
    left = run(steady(3, 10, [20, 35, 28]), 3)
    assert left[3:] == [(100 * k, "123", 100 * k + 35) for k in range(3, 10)]


def test_an_antenna_that_is_late_is_waited_for_and_then_done_without() -> None:
    held_until = {500: 700, 600: 701, 700: 730, 1200: 1650, 1300: 1651, 1400: 1652}  # as by a slow link, in order
    arrivals = [(max(r, held_until.get(t, 0) if a else 0), a, t) for r, a, t in steady(2, 20, [20, 30])]
    left = run(arrivals, 2)
    assert [entry for entry in left if 500 <= entry[0] < 800] == [(500, "12", 700), (600, "12", 701), (700, "12", 730)]
    assert (1200, "1-", 1220 + 300) in left


def test_an_antenna_of_a_lower_rate_or_gone_silent_is_not_waited_for() -> None:
    arrivals = [(100 * k + 20, 0, 100 * k) for k in range(40)]
    arrivals += [(1000 * k + 25, 1, 1000 * k) for k in range(3)]  # ends after 2 s; silent from its third interval on
    left = {t: (seen, complete) for t, seen, complete in run(arrivals, 2)}
    assert left[2000] == ("12", 2025)
    assert left[1500] == ("1-", 1520)  # not due at its rate
    assert left[3000][0] == "1-"


def test_the_first_antenna_may_fail_and_the_others_go_on() -> None:
    arrivals = [a for a in steady(3, 60, [20, 30, 25]) if not (a[1] == 0 and a[2] >= 1000)]
    left = run(arrivals, 3)
    assert [entry for entry in left if entry[0] >= 2000] == [(100 * k, "-23", 100 * k + 30) for k in range(20, 60)]


@pytest.mark.parametrize("tick_ms", [1, 7, 50, 333])
def test_how_often_time_is_told_does_not_matter(tick_ms: int) -> None:
    rng = np.random.default_rng(5)
    arrivals = [
        (100 * k + int(rng.gamma(2.0, 60.0)), a, 100 * k) for k in range(200) for a in range(3) if rng.random() < 0.9
    ]
    assert run(arrivals, 3, tick_ms, 10**6) == run(arrivals, 3, None, 10**6)
