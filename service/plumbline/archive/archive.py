"""A directory of stream logs, with an identity of its own and a bound on open files."""

import uuid
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path

from plumbline.archive.stream_log import StreamLog
from plumbline.records import Chunk

CLEAN_MARK = "closed-cleanly"


class Archive:
    """The streams of one ingest. ``writable=False`` only reads, and may do so while another process writes."""

    def __init__(self, root: Path, *, writable: bool = True, max_open: int = 256) -> None:
        self.root = root
        self._writable = writable
        self._max_open = max_open
        self._logs: OrderedDict[str, StreamLog] = OrderedDict()  # those with open files, least recently used first
        self._ends: dict[str, StreamLog] = {}
        self.mended: dict[str, int] = {}  # station → bytes that a crash had left without an index, or without content
        if writable:
            root.mkdir(parents=True, exist_ok=True)
            self._recover()
        self.archive_id = self._identity()

    def _identity(self) -> str:
        path = self.root / "ID"
        if not path.exists() and self._writable:
            path.write_text(uuid.uuid4().hex[:12], encoding="ascii")
        return path.read_text(encoding="ascii").strip() if path.exists() else "none"

    def _recover(self) -> None:
        mark = self.root / CLEAN_MARK
        if mark.exists():
            mark.unlink()
            return
        told_ns = self.last_receive_ns()
        for station in self.stations():
            if mended := self._log(station).recover(told_ns):
                self.mended[station] = mended
                told_ns = max(told_ns, self._log(station).last_receive_ns)

    def stations(self) -> list[str]:
        """The streams that have a log, sorted."""
        return sorted(p.name for p in self.root.iterdir() if p.is_dir()) if self.root.is_dir() else []

    def _log(self, station: str) -> StreamLog:
        log = self._ends.get(station)
        if log is None:
            log = self._ends.setdefault(station, StreamLog(self.root / station))
        return log

    def append(self, station: str, t_receive_ns: int, data: bytes) -> Chunk:
        """Write bytes through to the operating system and name them; publish only what this has returned.

        Raises ContractError when ``t_receive_ns`` is not after the stream's last, OSError when the disk refuses.
        """
        log = self._log(station)
        offset = log.append(t_receive_ns, data)
        self._logs[station] = log
        self._logs.move_to_end(station)
        if len(self._logs) > self._max_open:
            self._logs.popitem(last=False)[1].close()
        return Chunk(self.archive_id, station, offset, t_receive_ns, data)

    def end(self, station: str) -> int:
        """Offset of the byte that the stream's next chunk will begin with; 0 for a stream not seen yet."""
        return self._log(station).end

    def last_receive_ns(self) -> int:
        """The latest receive time in the archive, 0 when it is empty: a clock must go on after it."""
        return max((self._log(station).last_receive_ns for station in self.stations()), default=0)

    def chunks(self, station: str, from_offset: int = 0, from_ns: int | None = None) -> Iterator[Chunk]:
        """Chunks as they were received, from an offset or from a receive time (GPS ns) on, to the present end."""
        log = self._log(station)
        if not self._writable:
            log.refresh()
        for offset, t_receive_ns, data in log.chunks(from_offset, from_ns):
            yield Chunk(self.archive_id, station, offset, t_receive_ns, data)

    def read(
        self, station: str, from_offset: int = 0, max_bytes: int = 1 << 20, from_ns: int | None = None
    ) -> list[Chunk]:
        """The next chunks from an offset (or a receive time) on: at least one if there is any, about ``max_bytes``."""
        found: list[Chunk] = []
        size = 0
        for chunk in self.chunks(station, from_offset, from_ns):
            found.append(chunk)
            size += len(chunk.data)
            if size >= max_bytes:
                break
        return found

    def sync(self) -> None:
        """Have the disk hold everything appended so far (call it from a thread now and then)."""
        for log in list(self._logs.values()):
            log.sync()

    def close(self) -> None:
        """Sync, let go of the files, and leave word that there is nothing to recover."""
        for log in self._logs.values():
            log.close()
        self._logs.clear()
        if self._writable:
            (self.root / CLEAN_MARK).touch()
