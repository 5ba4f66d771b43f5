"""The live feed: every output once, numbered, fanned out to any number of subscribers in this process.

A subscriber has a bounded queue of references. When it is full the oldest entries go, and the subscriber is told which:
nobody waits for a slow reader. A ring of the latest entries lets a reader that lost its connection carry on.
"""

import asyncio
import secrets
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from plumbline.records import AlertEvent, Motion, Output, QualityReport, Solution, StationStatus

RING_CAPACITY: Final = 65_536
RING_BYTES: Final = 64 * 1024 * 1024
QUEUE_CAPACITY: Final = 2_048


class Channel(StrEnum):
    """What can be subscribed to."""

    SOLUTION = "solution"
    MOTION = "motion"
    STATUS = "status"
    ALERT = "alert"
    QUALITY = "quality"
    ATTITUDE = "attitude"


_CHANNEL_OF: Final = {
    Solution: Channel.SOLUTION,
    Motion: Channel.MOTION,
    StationStatus: Channel.STATUS,
    AlertEvent: Channel.ALERT,
    QualityReport: Channel.QUALITY,
}


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """One numbered output; equal only to itself, so that it can be a key."""

    sequence: int
    channel: Channel
    output: Output


@dataclass(frozen=True, slots=True)
class Missed:
    """What a subscriber did not get: ``count`` entries (None: unknown, too long ago) numbered ``first`` to ``last``."""

    first: int
    last: int
    count: int | None


@dataclass(frozen=True, slots=True)
class Interest:
    """Which entries a subscriber wants; None means all."""

    stations: frozenset[str] | None = None
    channels: frozenset[Channel] | None = None

    def wants(self, entry: Entry) -> bool:
        """Whether the entry is of interest."""
        return (self.stations is None or entry.output.station in self.stations) and (
            self.channels is None or entry.channel in self.channels
        )


class Subscription:
    """One subscriber's queue; made by :meth:`Feed.subscribe`."""

    def __init__(self, interest: Interest, capacity: int) -> None:
        self.interest = interest
        self._queue: deque[Entry] = deque()
        self._capacity = capacity
        self._missed: Missed | None = None
        self._ready = asyncio.Event()

    def offer(self, entry: Entry) -> bool:
        """Queue an entry of interest, at the cost of the oldest one when full; returns False when one was lost."""
        if not self.interest.wants(entry):
            return True
        kept = len(self._queue) < self._capacity
        if not kept:
            lost = self._queue.popleft()
            self.note_missed(Missed(lost.sequence, lost.sequence, 1))
        self._queue.append(entry)
        self._ready.set()
        return kept

    def note_missed(self, missed: Missed) -> None:
        """Add to what the subscriber is to be told before the next entry."""
        before = self._missed
        if before is not None:
            both_known = before.count is not None and missed.count is not None
            count = (before.count or 0) + (missed.count or 0) if both_known else None
            missed = Missed(before.first, missed.last, count)
        self._missed = missed
        self._ready.set()

    async def next(self) -> Missed | Entry:
        """The next thing to tell the subscriber, in order; waits for it."""
        while not self._queue and self._missed is None:
            self._ready.clear()
            await self._ready.wait()
        if self._missed is not None:
            missed, self._missed = self._missed, None
            return missed
        return self._queue.popleft()


def _size(entry: Entry) -> int:
    """About how many bytes an entry keeps: a block's four arrays, or a small record."""
    output = entry.output
    if isinstance(output, QualityReport):
        return 1000 + 20 * output.residual_m.nbytes
    return 1000 + (4 * output.displacement_enu_m.nbytes if isinstance(output, Motion) else 0)


class Feed:
    """Numbers outputs and hands them to subscribers. Use from one event loop.

    Sequence numbers grow by one and begin at the wall clock's microseconds, so that a restarted server's numbers are
    above all of its earlier ones; they stay below 2^53, exact in JSON.
    """

    def __init__(
        self,
        ring_capacity: int = RING_CAPACITY,
        ring_bytes: int = RING_BYTES,
        queue_capacity: int = QUEUE_CAPACITY,
        clock_us: Callable[[], int] = lambda: time.time_ns() // 1000,
    ) -> None:
        self.feed_id: Final = secrets.token_hex(8)
        self._ring: deque[Entry] = deque()
        self._ring_capacity = ring_capacity
        self._ring_bytes = ring_bytes
        self._bytes = 0
        self._queue_capacity = queue_capacity
        self._next = clock_us()
        self._subscriptions: set[Subscription] = set()
        self.published: Counter[str] = Counter()
        self.lost = 0  # entries that subscribers missed, all together

    @property
    def next_sequence(self) -> int:
        """The number that the next entry will get."""
        return self._next

    @property
    def oldest_sequence(self) -> int:
        """The first number that can still be replayed."""
        return self._ring[0].sequence if self._ring else self._next

    @property
    def n_subscribers(self) -> int:
        """How many subscriptions are open."""
        return len(self._subscriptions)

    def publish(self, output: Output) -> int:
        """Number an output and hand it to whoever wants it, at once and without waiting; returns its number.

        One with an attitude goes out a second time, on the channel of attitudes, with a number of its own.
        """
        number = self._publish_on(_CHANNEL_OF[type(output)], output)
        if isinstance(output, Solution | Motion) and output.attitude_rad is not None:
            self._publish_on(Channel.ATTITUDE, output)
        return number

    def _publish_on(self, channel: Channel, output: Output) -> int:
        entry = Entry(self._next, channel, output)
        self._next += 1
        self._keep(entry)
        self.published[entry.channel] += 1
        for subscription in self._subscriptions:
            self.lost += not subscription.offer(entry)
        return entry.sequence

    def _keep(self, entry: Entry) -> None:
        """Into the ring, the oldest out of it as far as its bounds ask."""
        self._ring.append(entry)
        self._bytes += _size(entry)
        while len(self._ring) > self._ring_capacity or (self._bytes > self._ring_bytes and len(self._ring) > 1):
            self._bytes -= _size(self._ring.popleft())

    def publish_all(self, outputs: Iterable[Output]) -> None:
        """Publish several outputs in order."""
        for output in outputs:
            self.publish(output)

    def subscribe(self, interest: Interest, resume_from: int | None = None) -> Subscription:
        """Begin a subscription with the next entry, or with ``resume_from`` as far as the ring still reaches back."""
        subscription = Subscription(interest, self._queue_capacity)
        if resume_from is not None:
            if resume_from < self.oldest_sequence:
                subscription.note_missed(Missed(resume_from, self.oldest_sequence - 1, None))
            for entry in self._from(resume_from):
                self.lost += not subscription.offer(entry)
        self._subscriptions.add(subscription)
        return subscription

    def unsubscribe(self, subscription: Subscription) -> None:
        """End a subscription."""
        self._subscriptions.discard(subscription)

    def _from(self, sequence: int) -> Iterator[Entry]:
        return (entry for entry in self._ring if entry.sequence >= sequence)
