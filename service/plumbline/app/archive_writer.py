"""Received bytes into the archive, in their order; while the disk refuses them they wait, and time with them."""

import logging
from collections import Counter, deque
from collections.abc import Callable

from plumbline.archive import Archive
from plumbline.ingest import ReceiveClock
from plumbline.records import Chunk

log = logging.getLogger(__name__)

MAX_WAITING_BYTES = 128 << 20


class ArchiveWriter:
    """Stamps bytes, archives them and passes the chunks on, each only when it is in the archive.

    What the disk refuses waits, up to ``max_bytes``, and all later bytes wait behind it with their own receive times;
    until they are in, :meth:`complete_ns` stands still, so that nobody believes that nothing was received.
    """

    def __init__(
        self,
        archive: Archive,
        clock: ReceiveClock,
        publish: Callable[[Chunk], None],
        max_bytes: int = MAX_WAITING_BYTES,
    ) -> None:
        self._archive = archive
        self._clock = clock
        self._publish = publish
        self._max_bytes = max_bytes
        self._waiting: deque[tuple[str, int, bytes]] = deque()  # station, receive time, bytes
        self.waiting_bytes = 0
        self.failing = ""  # why the disk takes nothing at the moment
        self.counters: Counter[str] = Counter()

    def take(self, station: str, data: bytes) -> None:
        """A station's next bytes, received now."""
        t_receive_ns = self._clock.now()
        if not self._waiting and self._append(station, t_receive_ns, data):
            return
        if self.waiting_bytes + len(data) > self._max_bytes:
            if not self.counters["bytes_lost"]:
                log.critical("too much waits for the archive's disk: bytes of %s and others are lost", station)
            self.counters["bytes_lost"] += len(data)
            return
        self._waiting.append((station, t_receive_ns, data))
        self.waiting_bytes += len(data)

    def retry(self) -> None:
        """Archive what waits, as far as the disk takes it."""
        while self._waiting and self._append(*self._waiting[0]):
            self.waiting_bytes -= len(self._waiting.popleft()[2])

    def complete_ns(self) -> int:
        """GPS time up to which all that was received is archived and passed on."""
        return self._waiting[0][1] - 1 if self._waiting else self._clock.now()

    def _append(self, station: str, t_receive_ns: int, data: bytes) -> bool:
        try:
            chunk = self._archive.append(station, t_receive_ns, data)
        except OSError as error:
            if not self.failing:
                log.critical("the archive's disk refuses: what is received waits in memory: %s", error)
            self.failing = f"the archive's disk refuses: {error}"
            self.counters["archive_errors"] += 1
            return False
        if self.failing:
            log.warning("the archive's disk takes bytes again")
            self.failing = ""
        self.counters["chunks"] += 1
        self.counters["bytes"] += len(data)
        self._publish(chunk)
        return True
