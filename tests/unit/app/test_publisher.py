"""A bus that is jammed. Oracle: a tick of a new generation stands between what is missing and all that comes later."""

import asyncio
import itertools
import threading

from plumbline.app.publisher import Publisher
from plumbline.bus import Outbox, keys
from plumbline.bus.messages import Tick, decode_tick


class Link:
    """A bus whose link takes nothing until it is opened."""

    def __init__(self) -> None:
        self.open = threading.Event()
        self.busy = threading.Event()
        self.sent: list[tuple[str, bytes]] = []

    def put(self, key: str, payload: bytes) -> None:
        self.busy.set()
        self.open.wait(10.0)
        self.sent.append((key, payload))


def test_what_is_missing_is_told_before_anything_later() -> None:
    link, clock = Link(), itertools.count(1).__next__
    outbox = Outbox(link, max_bytes=2500)
    publisher = Publisher(outbox, "x", clock, clock)
    first = publisher.generation
    publisher.put("raw/a", b"0")
    assert link.busy.wait(10.0)  # from now on messages pile up
    refused = [i for i in range(1, 9) if not _taken(publisher, i)]
    assert refused
    link.open.set()
    while not publisher.tick():
        pass
    publisher.put("raw/a", b"later")
    asyncio.run(outbox.close())
    told = [decode_tick(payload) if key == keys.of(keys.CLOCK, "x") else payload for key, payload in link.sent]
    assert told[-1] == b"later"
    (tick,) = (one for one in told if isinstance(one, Tick))
    assert told[-2] is tick
    assert tick.generation == publisher.generation > first
    assert len(told) == 1 + (8 - len(refused)) + 2
    assert publisher.counters["not_published"] == len(refused)


def _taken(publisher: Publisher, i: int) -> bool:
    before = publisher.counters["not_published"]
    publisher.put("raw/a", bytes([i]) * 1000)
    return publisher.counters["not_published"] == before
