"""A worker's ephemeris and correction books: fed by correction streams, saved now and then, restored in a take-over.

Every worker feeds its own books with the same bytes in the same order. One of them (by rendezvous, like a station)
stores a snapshot now and then in a ring of slots, so that whoever begins again finds one older than the bytes it needs.
"""

import logging
import pickle
from collections.abc import Iterable, Sequence
from typing import Any

from plumbline.bus import keys
from plumbline.bus.messages import CheckpointMessage, Numbered, encode_fields, encode_numbered
from plumbline.epochs.history import HISTORY_NS
from plumbline.gps_time import NS_PER_S
from plumbline.records import Chunk, StationStatus
from plumbline.worker.processing import Feed, Processing
from plumbline.worker.station import new_run

log = logging.getLogger(__name__)

SLOTS = "_books-{}"  # no station's id begins with an underscore
OWNER_KEY = "_books"
SAVE_INTERVAL_NS = 30 * NS_PER_S
LOOK_BACK_NS = 4 * 3600 * NS_PER_S  # without a snapshot: how much of the streams to read again
SILENT_AFTER_NS = 60 * NS_PER_S


class SharedBooks:
    """The books, their feeds, and the receive time up to which they are fed."""

    n_slots = 8

    def __init__(self, processing: Processing) -> None:
        self._processing = processing
        self.clear()

    def clear(self) -> None:
        """Empty books without streams."""
        self.books: Any = self._processing.new_books()
        self._feeds: dict[str, Feed] = {}
        self._last_ns: dict[str, int] = {}  # receive time of each stream's last bytes
        self._begin_ns = 0
        self.fed_ns = 0
        self._saved_ns = 0
        self._told_ns = 0

    def __contains__(self, stream: str) -> bool:
        return stream in self._feeds

    def streams(self) -> dict[str, int]:
        """Each stream, and the receive time up to which its bytes are in the books."""
        return dict.fromkeys(self._feeds, max(self.fed_ns, self._begin_ns))

    def receive(self, chunk: Chunk) -> None:
        """A correction stream's next bytes."""
        try:
            self._feeds[chunk.station].receive(chunk.data, chunk.t_receive_ns)
        except Exception:  # a defect in decoding must not take the stations along
            log.exception("correction stream %s: decoding failed", chunk.station)
        self._last_ns[chunk.station] = chunk.t_receive_ns
        self.fed_ns = max(self.fed_ns, chunk.t_receive_ns)

    def answers_from_ns(self) -> int:
        """The receive time as of which, and later, the books give the answers of that time."""
        settled_ns: int = self.books.settled_ns
        return min(self.fed_ns, max(self.fed_ns - HISTORY_NS, settled_ns))

    # ----------------------------------------------------------------------------------------- snapshots

    def restore(self, snapshots: Iterable[CheckpointMessage], streams: Sequence[str], needed_ns: int) -> None:
        """Begin with the newest snapshot from before ``needed_ns`` (GPS ns), or with empty books well before it."""
        usable = [s for s in snapshots if s.t_receive_ns <= needed_ns]
        for snapshot in sorted(usable, key=lambda s: s.t_receive_ns, reverse=True):
            if self._load(snapshot, set(streams)):
                return
        self._begin_ns = needed_ns - LOOK_BACK_NS
        self._feeds = {stream: self._processing.new_feed(stream, self.books) for stream in streams}

    def _load(self, snapshot: CheckpointMessage, streams: set[str]) -> bool:
        try:
            books, feeds, last_ns = pickle.loads(snapshot.state)
        except Exception as error:  # of another version: as good as none
            log.warning("a snapshot of the books cannot be read: %s", error)
            return False
        if set(feeds) != streams:
            return False
        self.books, self._feeds, self._last_ns = books, feeds, last_ns
        self.fed_ns = self._begin_ns = self._saved_ns = snapshot.t_receive_ns
        return True

    def snapshot_if_due(self, consumed: dict[str, int]) -> tuple[str, bytes] | None:
        """(key, payload) of a snapshot for the next slot, when enough has been fed since the last."""
        if not self._feeds or self.fed_ns - self._saved_ns < SAVE_INTERVAL_NS:
            return None
        self._saved_ns = self.fed_ns
        slot = SLOTS.format(self.fed_ns // SAVE_INTERVAL_NS % self.n_slots)
        state = pickle.dumps((self.books, self._feeds, self._last_ns), protocol=pickle.HIGHEST_PROTOCOL)
        message = CheckpointMessage(slot, self.fed_ns, state, consumed)
        return keys.of(keys.CHECKPOINT, slot), encode_numbered(Numbered(new_run(), 0, encode_fields(message)))

    # ----------------------------------------------------------------------------------------- status

    def statuses_if_due(self, t_receive_ns: int) -> list[StationStatus]:
        """Once a second: what an operator should know of each stream."""
        if t_receive_ns - self._told_ns < NS_PER_S:
            return []
        self._told_ns = t_receive_ns
        return [self._status(stream, t_receive_ns) for stream in sorted(self._feeds)]

    def _status(self, stream: str, t_receive_ns: int) -> StationStatus:
        last_ns = self._last_ns.get(stream)
        if last_ns is None:
            state, reason = "waiting", "no data yet"
        elif t_receive_ns - last_ns > SILENT_AFTER_NS:
            state, reason = "silent", f"no data for {(t_receive_ns - last_ns) / NS_PER_S:.0f} s"
        else:
            state, reason = "receiving", ""
        return StationStatus(stream, t_receive_ns, state, reason, None, None, 0, dict(self._feeds[stream].counters))
