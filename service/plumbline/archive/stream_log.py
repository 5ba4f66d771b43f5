"""One stream's log: hour files of bytes, each with an index of records ``(offset, receive time, length, CRC-32)``.

Writing puts the bytes first and their index record second, so whatever the index names is there. What a crash leaves:

- bytes without a record (killed between the two writes): they were received, but nobody has been told; recovery gives
  them a record, with a receive time after all that has been told of any stream;
- half an index record: cut off, and its bytes are then the case above;
- records without bytes (the power failed before the disk had them): the missing bytes are written as zeros, which is
  noise between frames, so that offsets that were handed out keep naming what they named;
- no index at all: one is rebuilt over the bytes, with receive times spread over the file's life: no more is known.
"""

import os
import time
import zlib
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plumbline.errors import ContractError
from plumbline.gps_time import GPS_EPOCH_UTC, NS_PER_S, gps_ns_from_unix_ns

HOUR_NS = 3600 * NS_PER_S
INDEX_RECORD = np.dtype([("offset", "<u8"), ("t_receive_ns", "<i8"), ("length", "<u4"), ("crc", "<u4")])
REBUILT_CHUNK_BYTES = 4096
FILE_TIME_STEP_NS = 10_000_000  # a file's time of change may be so much too early: it is the kernel's last tick's
Index = NDArray[np.void]


@dataclass(frozen=True, slots=True)
class Segment:
    """An hour file: where its first byte stands in the stream, and when it was received."""

    data_path: Path
    first_offset: int
    first_receive_ns: int

    @property
    def index_path(self) -> Path:
        """The file of its index records."""
        return self.data_path.with_suffix(".index")

    def index(self) -> Index:
        """All whole index records, in order."""
        size = self.index_path.stat().st_size // INDEX_RECORD.itemsize
        return np.fromfile(self.index_path, INDEX_RECORD, count=size)


def hour_path(t_receive_ns: int) -> Path:
    """``YYYY/DDD/HH.rtcm3`` of a receive time, by the GPS calendar."""
    date = GPS_EPOCH_UTC + timedelta(hours=t_receive_ns // HOUR_NS)
    return Path(f"{date:%Y}") / f"{date:%j}" / f"{date:%H}.rtcm3"


class StreamLog:
    """The log of one stream. One writer at a time; readers need none of the writer's state but :meth:`refresh`."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._segments: list[Segment] = []
        self._hour = -1
        self._data_fd = self._index_fd = -1
        self._new_path: Path | None = None  # an hour file that has no record yet
        self._unsynced: Segment | None = None
        self.end = 0
        self.last_receive_ns = 0
        self.refresh()

    # ---------------------------------------------------------------------------------------------- reading

    def refresh(self) -> None:
        """Find the hour files that are there, and the end of the last; raises nothing for half-written ones."""
        segments = []
        for data_path in sorted(self._root.glob("[0-9]*/[0-9]*/[0-9]*.rtcm3")):
            if _has_record(data_path):
                head = np.fromfile(data_path.with_suffix(".index"), INDEX_RECORD, count=1)
                segments.append(Segment(data_path, int(head["offset"][0]), int(head["t_receive_ns"][0])))
        self._segments = segments
        if segments:
            last = segments[-1].index()[-1]
            self.end = int(last["offset"]) + int(last["length"])
            self.last_receive_ns = int(last["t_receive_ns"])

    def records(self, from_offset: int = 0, from_ns: int | None = None) -> Iterator[tuple[Segment, Index]]:
        """Index records from an offset on (that which holds it included) or from a receive time on, by hour file."""
        key, value = ("first_offset", from_offset) if from_ns is None else ("first_receive_ns", from_ns)
        first = max(bisect_right(self._segments, value, key=lambda segment: getattr(segment, key)) - 1, 0)
        for segment in self._segments[first:]:
            index = segment.index()
            if from_ns is None:
                begin = int(np.searchsorted(index["offset"] + index["length"], from_offset, side="right"))
            else:
                begin = int(np.searchsorted(index["t_receive_ns"], from_ns, side="left"))
            if begin < len(index):
                yield segment, index[begin:]

    def chunks(self, from_offset: int = 0, from_ns: int | None = None) -> Iterator[tuple[int, int, bytes]]:
        """(offset, receive time, bytes) as they were appended; the first is cut to begin at ``from_offset``."""
        for segment, index in self.records(from_offset, from_ns):
            with segment.data_path.open("rb") as file:
                file.seek(int(index["offset"][0]) - segment.first_offset)
                for offset, t_receive_ns, length, _ in index.tolist():
                    data = file.read(length)
                    if len(data) < length:
                        return
                    skip = max(from_offset - offset, 0) if from_ns is None else 0
                    yield offset + skip, t_receive_ns, data[skip:]

    # ---------------------------------------------------------------------------------------------- writing

    def append(self, t_receive_ns: int, data: bytes) -> int:
        """Write a chunk through to the operating system; returns its offset.

        Raises ContractError when its receive time is not after the last one's.
        """
        if t_receive_ns <= self.last_receive_ns:
            raise ContractError(f"receive time {t_receive_ns} is not after {self.last_receive_ns}")
        hour = t_receive_ns // HOUR_NS
        if hour != self._hour:
            self._open_hour(hour, t_receive_ns)
        offset = self.end
        try:
            _write_all(self._data_fd, data)
            _write_all(self._index_fd, _record(offset, t_receive_ns, data))
        except OSError:
            self._give_up_half_written()
            raise
        if self._new_path is not None:
            self._segments.append(Segment(self._new_path, offset, t_receive_ns))
            self._new_path = None
        self.end += len(data)
        self.last_receive_ns = t_receive_ns
        self._unsynced = self._segments[-1]
        return offset

    def _open_hour(self, hour: int, t_receive_ns: int) -> None:
        self.close()
        path = self._root / hour_path(t_receive_ns)
        path.parent.mkdir(parents=True, exist_ok=True)
        known = bool(self._segments) and self._segments[-1].data_path == path
        self._new_path = None if known else path
        self._data_fd = _open_to_append(path)
        try:
            self._index_fd = _open_to_append(path.with_suffix(".index"))
        except OSError:
            os.close(self._data_fd)
            raise
        self._hour = hour

    def _give_up_half_written(self) -> None:
        """The disk has refused a chunk: cut off what it took of it, so that data and index agree again."""
        first_offset = self.end if self._new_path is not None else self._segments[-1].first_offset
        os.ftruncate(self._data_fd, self.end - first_offset)
        whole = os.fstat(self._index_fd).st_size // INDEX_RECORD.itemsize * INDEX_RECORD.itemsize
        os.ftruncate(self._index_fd, whole)

    def sync(self) -> None:
        """Have the disk hold what was appended; may run on another thread (hence its own descriptors)."""
        segment, self._unsynced = self._unsynced, None
        for path in (segment.data_path, segment.index_path) if segment else ():
            descriptor = os.open(path, os.O_RDONLY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)

    def close(self) -> None:
        """Sync and let go of the files; appending opens them again."""
        if self._hour >= 0:
            self.sync()
            os.close(self._data_fd)
            os.close(self._index_fd)
            self._hour = -1

    # ---------------------------------------------------------------------------------------------- recovery

    def recover(self, told_ns: int = 0) -> int:
        """Mend what a crash left in the hour files that it can have touched; returns the bytes that needed it.

        ``told_ns`` (GPS) is the latest receive time of any stream of the archive.
        """
        mended = 0
        end, last_ns = 0, 0
        paths = sorted(self._root.glob("[0-9]*/[0-9]*/[0-9]*.rtcm3"))
        for position, path in enumerate(paths):
            if position == len(paths) - 1 or not _has_record(path):
                mended += _mend(path, end, last_ns, max(told_ns, last_ns))
            if _has_record(path):
                index = Segment(path, 0, 0).index()
                end, last_ns = int(index["offset"][-1]) + int(index["length"][-1]), int(index["t_receive_ns"][-1])
        self.refresh()
        return mended


def _open_to_append(path: Path) -> int:
    return os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)


def _has_record(data_path: Path) -> bool:
    index_path = data_path.with_suffix(".index")
    return index_path.is_file() and index_path.stat().st_size >= INDEX_RECORD.itemsize


def _record(offset: int, t_receive_ns: int, data: bytes) -> bytes:
    return np.array([(offset, t_receive_ns, len(data), zlib.crc32(data))], INDEX_RECORD).tobytes()


def _write_all(descriptor: int, data: bytes) -> None:
    written = os.write(descriptor, data)
    while written < len(data):
        written += os.write(descriptor, data[written:])


def _mend(path: Path, previous_end: int, previous_ns: int, told_ns: int) -> int:
    """Make one hour file and its index agree; returns how many bytes were given a record or written as zeros."""
    index_path = path.with_suffix(".index")
    lost = not index_path.exists()
    index_path.touch()
    whole = index_path.stat().st_size // INDEX_RECORD.itemsize * INDEX_RECORD.itemsize
    os.truncate(index_path, whole)
    index = np.fromfile(index_path, INDEX_RECORD)
    first = int(index["offset"][0]) if len(index) else previous_end
    indexed = int(index["offset"][-1]) + int(index["length"][-1]) - first if len(index) else 0
    size = path.stat().st_size
    if size < indexed:
        with path.open("ab") as file:
            file.write(bytes(indexed - size))
    elif size > indexed:
        n = -(-(size - indexed) // REBUILT_CHUNK_BYTES)
        times_ns = _spread_ns(path, n, previous_ns) if lost else _untold_ns(path, n, told_ns)
        _index_orphans(path, first, indexed, times_ns)
    return abs(size - indexed)


def _spread_ns(path: Path, n: int, previous_ns: int) -> list[int]:
    """Receive times for n pieces of a file without an index: over the file's life."""
    hour_start = _hour_start_ns(path)
    begin = max(previous_ns + 1, hour_start)
    written = min(gps_ns_from_unix_ns(path.stat().st_mtime_ns), hour_start + HOUR_NS - 1)
    step = max((written - begin) // n, 1)
    return [begin + i * step for i in range(n)]


def _untold_ns(path: Path, n: int, told_ns: int) -> list[int]:
    """Receive times for n pieces that were written last of all: after everything that has been told, one after another.

    A clock told after the last chunk and before these bytes is earlier than their writing.
    """
    written = gps_ns_from_unix_ns(min(path.stat().st_mtime_ns + FILE_TIME_STEP_NS, time.time_ns()))
    return [max(told_ns + 1, written) + i for i in range(n)]


def _index_orphans(path: Path, first_offset: int, indexed: int, times_ns: Sequence[int]) -> None:
    """Append a record for each piece of the bytes that have none."""
    data = path.read_bytes()[indexed:]
    with path.with_suffix(".index").open("ab") as file:
        for i, t_ns in enumerate(times_ns):
            begin = i * REBUILT_CHUNK_BYTES
            file.write(_record(first_offset + indexed + begin, t_ns, data[begin : begin + REBUILT_CHUNK_BYTES]))


def _hour_start_ns(path: Path) -> int:
    year, day, hour = int(path.parts[-3]), int(path.parts[-2]), int(path.stem)
    first_day = GPS_EPOCH_UTC.replace(year=year, month=1, day=1)
    return ((first_day - GPS_EPOCH_UTC).days + day - 1) * 24 * HOUR_NS + hour * HOUR_NS
