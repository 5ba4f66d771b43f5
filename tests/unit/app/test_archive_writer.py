"""A disk that refuses for a while. Oracle: all that was received is in the archive later, with its receive time."""

import contextlib
import resource
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from plumbline.app.archive_writer import ArchiveWriter
from plumbline.archive import Archive, replay
from plumbline.ingest import ReceiveClock
from plumbline.records import Chunk


@contextlib.contextmanager
def full_disk(limit: int) -> Iterator[None]:
    """The operating system refuses whatever would make a file longer than ``limit`` bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)


@pytest.fixture
def received(tmp_path: Path) -> tuple[ArchiveWriter, Archive, list[Chunk]]:
    archive, published = Archive(tmp_path / "archive"), list[Chunk]()
    times_ns = iter(range(1_500_000_000_000_000_000, 1_600_000_000_000_000_000, 1_000_000_000))
    clock = ReceiveClock(unix_ns=lambda: next(times_ns))
    return ArchiveWriter(archive, clock, published.append, max_bytes=3000), archive, published


def test_what_a_full_disk_refuses_waits_and_keeps_its_time(
    received: tuple[ArchiveWriter, Archive, list[Chunk]],
) -> None:
    writer, archive, published = received
    writer.take("a", bytes(100))
    told_ns = writer.complete_ns()
    with full_disk(500):
        writer.take("a", bytes(1000))
        writer.take("b", b"waits behind it, though its own file is short")
        assert writer.failing
        waiting_since_ns = writer.complete_ns()
        writer.retry()
        assert (len(published), writer.waiting_bytes) == (1, 1045)
        assert told_ns < waiting_since_ns == writer.complete_ns()  # nobody is told that nothing came
    writer.retry()
    assert not writer.failing
    assert published == list(replay(archive, ["a", "b"]))
    assert [chunk.t_receive_ns - published[0].t_receive_ns for chunk in published] == [0, 2 * 10**9, 3 * 10**9]
    assert waiting_since_ns == published[1].t_receive_ns - 1
    assert writer.complete_ns() > published[-1].t_receive_ns


def test_more_than_may_wait_is_counted_as_lost(received: tuple[ArchiveWriter, Archive, list[Chunk]]) -> None:
    writer, archive, _ = received
    with full_disk(0):
        for _ in range(4):
            writer.take("a", bytes(1000))
    assert writer.counters["bytes_lost"] == 1000
    writer.retry()
    assert archive.end("a") == 3000
