"""Is it the structure or the receiver? Oracle: simulated stations of which it is known what moves.

The rovers' integers are right within an epoch, so that 3 cm are seen at once; positions by themselves take a quarter of
an hour before that.
"""

import random
import re
from functools import cache

import pytest

from plumbline.records import AlertState, Motion, Solution

from .witnesses import Piece, Seen, jump, pieces, plan, run, settings

ACTIVE, CLEARED = AlertState.ACTIVE, AlertState.CLEARED
JUMP_S, END_S = 100, 190
A, B = settings("a", neighbours=["b"]), settings("b", neighbours=["a"])


@cache
def pair(kind: str) -> list[Piece]:
    """A base and two rovers, of which one receiver jumps, or both move."""
    moves = jump(JUMP_S) if kind == "both" else None
    a = plan("a", moves, jump(JUMP_S) if kind == "one" else None)
    return pieces([(plan("base"), 0), (a, 0), (plan("b", moves), 0)], END_S)


def test_what_one_receiver_shows_alone_is_a_data_alert_and_no_motion() -> None:
    seen = run(A, pair("one"), [B])
    assert [(name, state) for name, state, _ in seen.alerts] == [("data-neighbour", ACTIVE)]
    assert JUMP_S < seen.alerts[0][2] < JUMP_S + 6
    assert re.search(r"only this antenna shows (2[7-9]|3[0-3]) mm: b does not", seen.texts[0])
    for kind in (Solution, Motion):
        assert seen.flagged(kind) >= set(range(JUMP_S + 4, END_S - 5))
        assert min(seen.flagged(kind)) > JUMP_S


def test_its_neighbour_is_not_blamed() -> None:
    seen = run(B, pair("one"), [A])
    assert not seen.alerts
    assert not seen.flagged(Solution)


def test_what_both_show_is_a_motion() -> None:
    seen = run(A, pair("both"), [B])
    assert [(name, state) for name, state, _ in seen.alerts] == [("level", ACTIVE)]
    assert JUMP_S < seen.alerts[0][2] < JUMP_S + 2
    assert not seen.flagged(Solution)


def test_without_a_witness_a_jump_is_a_motion() -> None:
    assert [name for name, _, _ in run(settings("a"), pair("one")).alerts] == ["level"]


@pytest.mark.parametrize(("kind", "seed"), [("one", 1), ("both", 2)])
def test_rows_follow_from_the_bytes_alone(kind: str, seed: int) -> None:
    """Not from when the worker let time pass, nor from a take-over in between."""
    stream, chance = pair(kind), random.Random(seed)
    once = run(A, stream, [B])
    at = chance.randrange(int(0.5 * len(stream)), int(0.7 * len(stream)))
    again = run(A, stream, [B], ticks=chance, restart_at=at)
    assert again.rows == once.rows
    assert len(once.rows) > 300


@pytest.mark.slow
def test_a_jump_of_the_base_is_told_to_the_rover() -> None:
    begin = 1300
    stream = pieces([(plan("base", shows=jump(begin + JUMP_S)), 0), (plan("a"), begin)], begin + 160)
    seen = run(settings("a"), stream)
    assert [(name, state) for name, state, _ in seen.alerts] == [("data-reference", ACTIVE)]
    assert "the reference station base moved" in seen.texts[0]
    assert not [second for second in seen.flagged(Motion) if second < begin + JUMP_S]


def felt(kind: str, seconds: int, at: int) -> Seen:
    a = plan("a", jump(at) if kind == "both" else None, jump(at) if kind == "one" else None, felt=True)
    return run(settings("a", "ppp-accel"), pieces([(a, 0)], seconds))


@pytest.mark.slow
def test_a_jump_that_the_accelerometer_did_not_feel_is_a_data_alert() -> None:
    seen = felt("one", 1150, 1050)
    assert [(name, state) for name, state, _ in seen.alerts] == [("data-accelerometer", ACTIVE)]
    assert "felt nothing" in seen.texts[0]
    assert min(seen.flagged(Solution)) >= 1050


@pytest.mark.slow
def test_a_motion_that_the_accelerometer_felt_is_one() -> None:
    seen = felt("both", 1150, 1050)
    assert "data-accelerometer" not in [name for name, _, _ in seen.alerts]
    assert not seen.flagged(Solution)
