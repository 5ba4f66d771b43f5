"""What an ingest publishes, in order. What a jammed bus refuses is in the archive, and that is said before all else."""

from collections import Counter
from collections.abc import Callable

from plumbline.bus import Outbox, keys
from plumbline.bus.messages import Tick, encode_fields


class Publisher:
    """Messages and clock ticks of one archive's ingest through an outbox.

    A refused message begins a new generation. Nothing is published any more until a tick has told it: a later chunk
    alone would vouch for all that was received before.
    """

    def __init__(self, outbox: Outbox, archive: str, now_ns: Callable[[], int], complete_ns: Callable[[], int]) -> None:
        self._outbox = outbox
        self._archive = archive
        self._now_ns = now_ns
        self._complete_ns = complete_ns
        self._untold = False
        self.generation = now_ns()
        self.counters: Counter[str] = Counter()

    def put(self, key: str, payload: bytes) -> None:
        """Publish, if the bus takes it."""
        if self._untold and not self.tick():
            self.counters["not_published"] += 1
        elif not self._outbox.put(key, payload):
            self.counters["not_published"] += 1
            self._untold, self.generation = True, self._now_ns()

    def tick(self) -> bool:
        """Tell the time up to which all that was received has been published, or is said to be missing."""
        message = Tick(self._archive, self.generation, self._complete_ns())
        told = self._outbox.put(keys.of(keys.CLOCK, self._archive), encode_fields(message))
        self._untold = self._untold and not told
        return told
