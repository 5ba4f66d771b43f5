"""The live feed. Oracle: a list of everything that was published, and what must be left of it."""

import asyncio
from dataclasses import replace

import numpy as np

from plumbline.api.feed import Channel, Entry, Feed, Interest, Missed, Subscription
from plumbline.records import AlertEvent, AlertState, Motion, Severity, Solution, StationStatus, Status


def solution(i: int, station: str = "a") -> Solution:
    return Solution(station, i, i, Status.NO_OBSERVATIONS, str(i))


async def drain(subscription: object, n: int) -> list[Missed | Entry]:
    return [await asyncio.wait_for(subscription.next(), 1.0) for _ in range(n)]  # type: ignore[attr-defined]


async def test_every_subscriber_gets_what_it_wants_in_order() -> None:
    feed = Feed()
    everything, one = feed.subscribe(Interest()), feed.subscribe(Interest(frozenset({"b"}), None))
    status = feed.subscribe(Interest(None, frozenset({Channel.STATUS, Channel.ALERT})))
    outputs = [solution(i, "ab"[i % 2]) for i in range(6)]
    outputs.append(StationStatus("a", 9, "receiving", "", None, None, 0, {}))  # type: ignore[arg-type]
    event = AlertEvent("x", "a", "t", AlertState.ACTIVE, Severity.ALARM, 1, 1, 1, "displacement_up", 1.0, 0.5, "")
    outputs.append(event)  # type: ignore[arg-type]
    feed.publish_all(outputs)
    got = await drain(everything, 8)
    assert [entry.output for entry in got] == outputs  # type: ignore[union-attr]
    numbers = [entry.sequence for entry in got]  # type: ignore[union-attr]
    assert numbers == list(range(numbers[0], numbers[0] + 8))
    assert [entry.output for entry in await drain(one, 3)] == outputs[1:6:2]  # type: ignore[union-attr]
    assert [entry.output for entry in await drain(status, 2)] == outputs[6:]  # type: ignore[union-attr]
    assert feed.published == {"solution": 6, "status": 1, "alert": 1}


async def test_a_slow_subscriber_is_told_what_it_missed_and_nobody_else_notices() -> None:
    feed = Feed(queue_capacity=5)
    slow, quick = feed.subscribe(Interest(frozenset({"a"}))), feed.subscribe(Interest())
    first = feed.next_sequence
    seen = []
    for i in range(40):
        feed.publish(solution(i, "ab"[i % 2]))
        seen += await drain(quick, 1)
    assert [entry.output.t_gps_ns for entry in seen] == list(range(40))  # type: ignore[union-attr]
    missed, *rest = await drain(slow, 6)
    assert missed == Missed(first, first + 28, 15)  # of 20 at even places the last 5 are left
    assert [entry.output.t_gps_ns for entry in rest] == [30, 32, 34, 36, 38]  # type: ignore[union-attr]
    assert feed.lost == 15


async def test_resuming_continues_without_gap_or_repetition() -> None:
    feed = Feed()
    feed.publish_all([solution(i) for i in range(10)])
    middle = feed.next_sequence - 4
    subscription = feed.subscribe(Interest(), resume_from=middle)
    feed.publish(solution(10))
    got = await drain(subscription, 5)
    assert [entry.sequence for entry in got] == list(range(middle, middle + 5))  # type: ignore[union-attr]


async def test_resuming_from_before_the_ring_says_so() -> None:
    feed = Feed(ring_capacity=3)
    start = feed.next_sequence
    feed.publish_all([solution(i) for i in range(10)])
    missed, *rest = await drain(feed.subscribe(Interest(), resume_from=start + 2), 4)
    assert missed == Missed(start + 2, start + 6, None)
    assert [entry.sequence for entry in rest] == [start + 7, start + 8, start + 9]  # type: ignore[union-attr]


async def test_the_ring_is_bounded_in_bytes_too() -> None:
    feed = Feed(ring_bytes=50_000)
    zeros = np.zeros((100, 3))
    for i in range(20):
        feed.publish(Motion("a", i, i, 1, zeros, zeros, zeros, zeros, Status.PPP_FLOAT))
    assert feed.next_sequence - feed.oldest_sequence == 50_000 // (4 * 2400 + 1000)


async def test_a_later_feed_has_higher_numbers_and_an_ended_subscription_gets_nothing() -> None:
    before = Feed()
    before.publish(solution(0))
    await asyncio.sleep(0.002)
    assert Feed().next_sequence > before.next_sequence
    subscription = before.subscribe(Interest())
    before.unsubscribe(subscription)
    before.publish(solution(1))
    assert before.n_subscribers == 0
    try:
        await asyncio.wait_for(subscription.next(), 0.05)
    except TimeoutError:
        return
    raise AssertionError("an ended subscription was served")


def test_an_attitude_goes_out_on_its_own_channel_too() -> None:
    feed = Feed(clock_us=lambda: 100)
    angles = feed.subscribe(Interest(channels=frozenset({Channel.ATTITUDE})))
    everything = feed.subscribe(Interest())
    feed.publish(solution(1))
    feed.publish(replace(solution(2), attitude_rad=np.zeros(3), sigma_attitude_rad=np.zeros(3)))

    def drained(subscription: Subscription) -> list[tuple[int, str]]:
        return [(entry.sequence, entry.channel.value) for entry in subscription._queue]

    assert drained(angles) == [(102, "attitude")]
    assert drained(everything) == [(100, "solution"), (101, "solution"), (102, "attitude")]
