"""Several streams of an archive as one, in the order of their receive times, as live processing sees them."""

import heapq
from collections.abc import Iterator, Sequence

from plumbline.archive.archive import Archive
from plumbline.records import Chunk


def replay(
    archive: Archive, stations: Sequence[str], from_ns: int | None = None, to_ns: int | None = None
) -> Iterator[Chunk]:
    """Chunks of ``stations`` with ``from_ns`` ≤ receive time < ``to_ns`` (GPS ns), by receive time, then station."""
    streams = (archive.chunks(station, from_ns=from_ns or 0) for station in sorted(stations))
    for chunk in heapq.merge(*streams, key=lambda chunk: (chunk.t_receive_ns, chunk.station)):
        if to_ns is not None and chunk.t_receive_ns >= to_ns:
            return
        yield chunk
