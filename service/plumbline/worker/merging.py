"""Chunks of many streams, live and from archives, put into the order of their receive times. No input or output here.

A stream is complete up to its *frontier*: for one that is live the clock of the ingest that it comes from, for one that
is being fetched from the archive the last chunk fetched. A station's chunk is released when every correction stream is
complete beyond it, and a correction when every station has been given what it received before. Within these bounds
chunks leave in the order of (receive time, stream).

A stream becomes live only when what was fetched joins, byte for byte, what is published: chunks that are published
meanwhile are kept aside for that, and an answer to a question asked before something may have been missed proves
nothing. A chunk whose offset is not the next one shows a gap: the stream goes back to being fetched, and nothing is
lost. Archives are asked by receive time, as a power failure may shorten them.

A station may follow other stations' streams beside its own (its neighbours'): each consumer of a stream has a cursor of
its own on it, and gets the chunks of all its streams in the order of their receive times.

When an ingest is gone, the streams of others do not wait for it. Its own do: what they lack is in its archive.
"""

import heapq
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from plumbline.bus.messages import ArchiveReply, Tick
from plumbline.records import Chunk

NEVER_NS = 1 << 62
MAX_PENDING_BYTES = 4 << 20


class Delivery(NamedTuple):
    """A chunk and the station that it is for: its own one, or another that follows it."""

    consumer: str
    chunk: Chunk


@dataclass(slots=True)
class Cursor:
    """How far one stream of one archive has come, for one consumer."""

    archive: str
    station: str  # whose stream it is
    consumer: str
    correction: bool
    last_ns: int  # receive time of the last chunk taken in
    complete_ns: int  # the receive time up to which, by what was fetched, nothing is missing
    next_offset: int | None = None  # of the next chunk expected; None: not known before the first fetch
    consumed_offset: int = 0
    live: bool = False
    doubtful: bool = False  # something may have been missed since the archive was asked
    pending: deque[Chunk] = field(default_factory=deque)
    pending_bytes: int = 0
    ahead: deque[Chunk] = field(default_factory=deque)  # an unbroken run, published while the stream is being fetched
    ahead_bytes: int = 0

    @property
    def key(self) -> tuple[str, str, str]:
        """(archive, station, consumer)."""
        return self.archive, self.station, self.consumer

    def keep_ahead(self, chunk: Chunk) -> None:
        """Keep a chunk for when the fetched ones reach it; of what is more than may be kept, the newest."""
        unbroken = bool(self.ahead) and self.ahead[-1].end == chunk.offset
        if not unbroken or self.ahead_bytes >= MAX_PENDING_BYTES:
            self.forget_ahead()
        self.ahead.append(chunk)
        self.ahead_bytes += len(chunk.data)

    def forget_ahead(self) -> None:
        """Keep nothing aside any more."""
        self.ahead.clear()
        self.ahead_bytes = 0


class Merger:
    """See the module. Feed it with :meth:`offer`, :meth:`tick` and :meth:`fetched`; take from :meth:`release`."""

    def __init__(self) -> None:
        self._cursors: dict[tuple[str, str, str], Cursor] = {}
        self._by_consumer: dict[str, list[Cursor]] = {}
        self._by_stream: dict[tuple[str, str], list[Cursor]] = {}  # by (archive, station)
        self._corrections: list[Cursor] = []
        self._catching_up: dict[tuple[str, str, str], Cursor] = {}
        self._waiting: dict[tuple[str, str, str], Cursor] = {}  # those with pending chunks
        self._alive: set[str] = set()  # archives whose ingest is there
        self._clock_ns: dict[str, int] = {}  # by archive: the time that its ingest told last
        self._generation: dict[str, int] = {}

    # ----------------------------------------------------------------------------------------- streams

    def follow(
        self, archive: str, station: str, *, correction: bool, from_ns: int, consumer: str | None = None
    ) -> None:
        """Begin a stream with the first chunk received after ``from_ns``, wherever in the archive that is.

        ``consumer`` is the station that it is for; None: its own.
        """
        cursor = Cursor(archive, station, consumer or station, correction, last_ns=from_ns, complete_ns=from_ns)
        if cursor.key in self._cursors:
            return
        self._cursors[cursor.key] = cursor
        self._by_consumer.setdefault(cursor.consumer, []).append(cursor)
        self._by_stream.setdefault((archive, station), []).append(cursor)
        if correction:
            self._corrections.append(cursor)
        self._catching_up[cursor.key] = cursor

    def unfollow(self, consumer: str) -> None:
        """Forget all that a consumer follows, in every archive."""
        for cursor in self._by_consumer.pop(consumer, []):
            for index in (self._cursors, self._catching_up, self._waiting):
                index.pop(cursor.key, None)
            self._by_stream[cursor.archive, cursor.station].remove(cursor)
            if cursor.correction:
                self._corrections.remove(cursor)

    def is_followed(self, station: str) -> bool:
        """Whether anybody follows a station's stream."""
        return any(cursors for (_, stream), cursors in self._by_stream.items() if stream == station)

    def consumed(self, station: str) -> dict[str, int]:
        """Archive → offset behind the last byte of a station's own stream that was released to it."""
        own = (c for c in self._by_consumer.get(station, ()) if c.station == station)
        return {c.archive: c.consumed_offset for c in own if c.next_offset is not None}

    @property
    def archives(self) -> tuple[str, ...]:
        """The archives whose ingest is alive."""
        return tuple(sorted(self._alive))

    # ----------------------------------------------------------------------------------------- what comes in

    def ingest_came(self, archive: str) -> None:
        """An ingest is there (again): what it published unseen is fetched before anything else of it is believed."""
        self._alive.add(archive)
        self._clock_ns[archive] = 0
        self._generation.pop(archive, None)
        self.refetch(archive)

    def ingest_went(self, archive: str) -> None:
        """An ingest is gone: others no longer wait for it; its own streams are as complete as they were."""
        self._alive.discard(archive)
        self._generation.pop(archive, None)

    def refetch(self, archive: str | None = None) -> None:
        """Something may have been missed: streams (of an archive) are to be fetched up to their ends first."""
        for cursor in self._cursors.values():
            if archive in (None, cursor.archive):
                self._fall_back(cursor)
                cursor.doubtful = True

    def _fall_back(self, cursor: Cursor) -> None:
        if cursor.live:
            cursor.live = False
            cursor.complete_ns = cursor.last_ns
            self._catching_up[cursor.key] = cursor

    def offer(self, chunk: Chunk) -> None:
        """A chunk as published live."""
        for cursor in self._by_stream.get((chunk.archive, chunk.station), ()):
            if chunk.t_receive_ns <= cursor.last_ns:
                continue
            if cursor.live and chunk.offset == cursor.next_offset and cursor.pending_bytes < MAX_PENDING_BYTES:
                self._take(cursor, chunk)
            else:
                self._fall_back(cursor)
                cursor.keep_ahead(chunk)
        if chunk.archive in self._alive:
            self._clock_ns[chunk.archive] = max(self._clock_ns[chunk.archive], chunk.t_receive_ns)

    def tick(self, tick: Tick) -> None:
        """An ingest's clock; a new generation has its streams fetched again."""
        if tick.archive not in self._alive:
            return
        known = self._generation.setdefault(tick.archive, tick.generation)
        if known != tick.generation:
            self._generation[tick.archive] = tick.generation
            self.refetch(tick.archive)
        self._clock_ns[tick.archive] = max(self._clock_ns[tick.archive], tick.t_receive_ns)

    def wanted(self) -> list[Cursor]:
        """Streams that are to be fetched now."""
        return [
            cursor
            for cursor in self._catching_up.values()
            if cursor.archive in self._alive and cursor.pending_bytes < MAX_PENDING_BYTES // 4
        ]

    def asked(self, cursor: Cursor) -> int:
        """Note that the archive is being asked for a stream; the receive time that its answer is to begin after."""
        cursor.doubtful = False
        return cursor.last_ns

    def fetched(self, cursor: Cursor, reply: ArchiveReply) -> None:
        """What the archive has answered for a stream: chunks received after the time that :meth:`asked` gave."""
        if self._cursors.get(cursor.key) is not cursor or cursor.live:
            return
        if cursor.archive in self._alive:
            self._generation.setdefault(cursor.archive, reply.generation)
        first = reply.chunks[0].offset if reply.chunks else reply.end
        if cursor.next_offset is None:
            cursor.consumed_offset = first
        cursor.next_offset = first
        for chunk in reply.chunks:
            self._take(cursor, chunk)
        if cursor.next_offset >= reply.end:
            self._reach_end(cursor, reply.t_now_ns)
        else:
            cursor.complete_ns = max(cursor.complete_ns, cursor.last_ns)

    def _reach_end(self, cursor: Cursor, t_now_ns: int) -> None:
        """All that the archive held at a time is in: live, if what was published since follows without a gap."""
        cursor.complete_ns = max(cursor.complete_ns, t_now_ns)  # its own: others' chunks may be on their way
        while cursor.ahead and cursor.next_offset is not None and cursor.ahead[0].offset <= cursor.next_offset:
            chunk = cursor.ahead.popleft()
            cursor.ahead_bytes -= len(chunk.data)
            if chunk.t_receive_ns > cursor.last_ns:
                self._take(cursor, chunk)
        if not cursor.ahead and not cursor.doubtful:
            cursor.live = True
            del self._catching_up[cursor.key]

    def _take(self, cursor: Cursor, chunk: Chunk) -> None:
        cursor.pending.append(chunk)
        cursor.pending_bytes += len(chunk.data)
        cursor.next_offset = chunk.end
        cursor.last_ns = chunk.t_receive_ns
        self._waiting[cursor.key] = cursor

    # ----------------------------------------------------------------------------------------- what goes out

    def _frontier_ns(self, cursor: Cursor, archive: str) -> int:
        """How far a stream is complete, for one of ``archive`` that would wait for it."""
        if cursor.archive not in self._alive and cursor.archive != archive:
            return NEVER_NS
        return max(self._clock_ns[cursor.archive], cursor.complete_ns) if cursor.live else cursor.complete_ns

    def correction_frontier_ns(self, archive: str) -> int:
        """The receive time up to which every correction stream is complete, for a stream of an archive."""
        return min((self._frontier_ns(cursor, archive) for cursor in self._corrections), default=NEVER_NS)

    def clock_ns(self) -> int:
        """The latest time that any living ingest has told."""
        return max((self._clock_ns[archive] for archive in self._alive), default=0)

    def idle_until_ns(self, station: str) -> int | None:
        """The receive time up to which a station has no byte unprocessed; None where it has, or nobody can tell."""
        cursors = self._by_consumer.get(station, ())
        alive = [cursor for cursor in cursors if cursor.archive in self._alive]
        if not alive or any(cursor.pending for cursor in cursors):
            return None
        own_ns = min(self._frontier_ns(cursor, cursor.archive) for cursor in alive)
        return min(own_ns, *(self.correction_frontier_ns(cursor.archive) for cursor in alive))

    def _hindmost_station_ns(self, archive: str) -> int:
        """The receive time before which every station has been given all its chunks, for a stream of an archive."""
        heeded = (*self._alive, archive)
        stations = (c for c in self._cursors.values() if not c.correction and c.archive in heeded)
        return min(
            (c.pending[0].t_receive_ns if c.pending else self._frontier_ns(c, archive) for c in stations),
            default=NEVER_NS,
        )

    def release(self, limit: int = 1000) -> Iterator[Chunk]:
        """The chunks of :meth:`deliver` alone."""
        return (delivery.chunk for delivery in self.deliver(limit))

    def deliver(self, limit: int = 1000) -> Iterator[Delivery]:
        """Chunks that may be processed now, in order, about ``limit``; each counts as consumed when it is yielded."""
        released, before = 0, -1
        while self._waiting and before < released < limit:
            before = released
            for delivery in self._pass():
                released += 1
                yield delivery

    def _pass(self) -> Iterator[Delivery]:
        """What may be released by the bounds as they are now, in order; releasing it can widen them."""
        bounds = {archive: self._bounds(archive) for archive in {cursor.archive for cursor in self._waiting.values()}}
        heap = [(cursor.pending[0].t_receive_ns, not cursor.correction, key) for key, cursor in self._waiting.items()]
        heapq.heapify(heap)
        while heap:
            t_ns, _, key = heapq.heappop(heap)
            cursor = self._cursors[key]
            complete_ns, correction_limit_ns = bounds[cursor.archive]
            if t_ns > complete_ns and cursor.archive not in self._alive:
                continue  # what it lacks comes back with its ingest; nobody else waits for that
            if t_ns > (correction_limit_ns if cursor.correction else complete_ns):
                return  # whatever comes later in time has to wait for it
            if cursor.correction or t_ns <= self._siblings_ns(cursor):
                yield Delivery(cursor.consumer, self._consume(cursor))
                if cursor.pending:
                    heapq.heappush(heap, (cursor.pending[0].t_receive_ns, not cursor.correction, key))

    def _bounds(self, archive: str) -> tuple[int, int]:
        """The latest receive times of which a station's chunk, and a correction, of an archive may be released."""
        complete_ns = self.correction_frontier_ns(archive)
        if not any(cursor.correction for cursor in self._waiting.values()):
            return complete_ns, complete_ns
        return complete_ns, min(self._hindmost_station_ns(archive), complete_ns)

    def _consume(self, cursor: Cursor) -> Chunk:
        chunk = cursor.pending.popleft()
        cursor.pending_bytes -= len(chunk.data)
        cursor.consumed_offset = chunk.end
        if not cursor.pending:
            del self._waiting[cursor.key]
        return chunk

    def _siblings_ns(self, cursor: Cursor) -> int:
        """The receive time up to which the other streams of a consumer are complete."""
        siblings = (c for c in self._by_consumer[cursor.consumer] if c is not cursor and not c.pending)
        return min((self._frontier_ns(c, cursor.archive) for c in siblings), default=NEVER_NS)
