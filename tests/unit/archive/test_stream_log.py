"""The archive against itself before and after: what was appended is what is read, whatever a crash has torn off."""

import os
import resource
import signal
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plumbline.archive import Archive, replay
from plumbline.archive.stream_log import HOUR_NS, INDEX_RECORD, StreamLog, hour_path
from plumbline.errors import ContractError
from plumbline.gps_time import NS_PER_S, gps_ns_from_calendar, gps_ns_from_unix_ns

T0_NS = gps_ns_from_calendar(2026, 2, 6, 23, 59, 58 * NS_PER_S)


def filled(root: Path, n: int = 10, step_ns: int = NS_PER_S) -> list[tuple[int, int, bytes]]:
    """A log with chunks over an hour's (and a day's) end; what was appended."""
    log = StreamLog(root)
    appended = []
    for i in range(n):
        data = bytes([i]) * (i + 1)
        t_ns = T0_NS + i * step_ns
        appended.append((log.append(t_ns, data), t_ns, data))
    log.close()
    return appended


def test_hour_files_are_named_by_gps_date() -> None:
    # 2026-02-06 is day 37 of the year
    assert hour_path(T0_NS) == Path("2026/037/23.rtcm3")
    assert hour_path(T0_NS + 2 * NS_PER_S) == Path("2026/038/00.rtcm3")


def test_reads_back_boundaries_and_times_across_midnight(tmp_path: Path) -> None:
    appended = filled(tmp_path)
    assert list(StreamLog(tmp_path).chunks()) == appended
    assert sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*.rtcm3")) == [
        "2026/037/23.rtcm3",
        "2026/038/00.rtcm3",
    ]


def test_reads_from_an_offset_and_from_a_time(tmp_path: Path) -> None:
    appended = filled(tmp_path)
    log = StreamLog(tmp_path)
    for offset, t_ns, data in appended:
        rest = [chunk for chunk in appended if chunk[0] >= offset]
        assert list(log.chunks(offset)) == rest
        assert list(log.chunks(from_ns=t_ns)) == rest
        if len(data) > 1:  # in the middle of a chunk: its rest comes first
            assert next(log.chunks(offset + 1)) == (offset + 1, t_ns, data[1:])
    assert list(log.chunks(log.end)) == []
    assert list(log.chunks(from_ns=appended[-1][1] + 1)) == []


def test_receive_times_must_increase(tmp_path: Path) -> None:
    log = StreamLog(tmp_path)
    log.append(T0_NS, b"a")
    with pytest.raises(ContractError):
        log.append(T0_NS, b"b")


def last_files(root: Path) -> tuple[Path, Path]:
    data = max(root.rglob("*.rtcm3"))
    return data, data.with_suffix(".index")


@given(cut=st.integers(0, 10 * INDEX_RECORD.itemsize), lost=st.integers(0, 60))
@settings(max_examples=60, deadline=None)
def test_recovery_names_every_byte_as_before(tmp_path_factory: pytest.TempPathFactory, cut: int, lost: int) -> None:
    """Cut the index and the data anywhere: bytes that are left keep their offsets, and the log goes on behind them."""
    root = tmp_path_factory.mktemp("log")
    appended = filled(root)
    data_path, index_path = last_files(root)
    os.truncate(index_path, min(cut, index_path.stat().st_size))
    os.truncate(data_path, max(data_path.stat().st_size - lost, 0))
    whole = b"".join(data for _, _, data in appended)
    first = appended[2][0]  # of the last hour file
    left = data_path.stat().st_size
    log = StreamLog(root)
    log.recover()
    chunks = list(log.chunks())
    kept = b"".join(data for _, _, data in chunks)
    assert kept[: first + left] == whole[: first + left]
    assert set(kept[first + left :]) <= {0}  # lost by the disk, but named by the index: noise in its place
    position = 0
    for offset, _, data in chunks:
        assert offset == position
        position += len(data)
    times = [t_ns for _, t_ns, _ in chunks]
    assert times == sorted(set(times))
    t_ns = max(times[-1], T0_NS + HOUR_NS) + 1
    assert log.append(t_ns, b"more") == position
    assert list(log.chunks(position)) == [(position, t_ns, b"more")]


def test_a_lost_index_is_rebuilt(tmp_path: Path) -> None:
    appended = filled(tmp_path)
    for index in tmp_path.rglob("*.index"):
        index.unlink()
    log = StreamLog(tmp_path)
    log.recover()
    chunks = list(log.chunks())
    assert b"".join(data for _, _, data in chunks) == b"".join(data for _, _, data in appended)
    assert all(T0_NS - HOUR_NS < t_ns < T0_NS + HOUR_NS for _, t_ns, _ in chunks)


def test_a_full_disk_leaves_the_log_whole(tmp_path: Path) -> None:
    log = StreamLog(tmp_path)
    log.append(T0_NS, b"x" * 1000)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1500, hard))  # the operating system now refuses what goes beyond
    try:
        with pytest.raises(OSError):
            log.append(T0_NS + 1, b"y" * 1000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    log.append(T0_NS + 2, b"z" * 10)
    assert list(log.chunks()) == [(0, T0_NS, b"x" * 1000), (1000, T0_NS + 2, b"z" * 10)]


def test_archive_keeps_its_identity_and_bounds_open_files(tmp_path: Path) -> None:
    archive = Archive(tmp_path, max_open=2)
    for i in range(20):
        chunk = archive.append(f"station-{i % 5}", T0_NS + i, bytes([i]))
        assert (chunk.archive, chunk.offset) == (archive.archive_id, i // 5)
    assert len(os.listdir(f"/proc/{os.getpid()}/fd")) < 200
    archive.sync()
    archive.close()
    again = Archive(tmp_path)
    assert again.archive_id == archive.archive_id
    assert again.end("station-3") == 4
    assert again.end("nobody") == 0
    assert again.last_receive_ns() == T0_NS + 19


def test_archive_recovers_after_a_crash_only(tmp_path: Path) -> None:
    archive = Archive(tmp_path)
    archive.append("a", T0_NS, b"abc")
    _, index = last_files(tmp_path)
    os.truncate(index, 5)  # killed while writing the record
    crashed = Archive(tmp_path)
    assert crashed.mended == {"a": 3}
    assert [chunk.data for chunk in crashed.chunks("a")] == [b"abc"]
    crashed.close()
    assert Archive(tmp_path).mended == {}


@pytest.mark.parametrize("left", [0, 5])
def test_what_nobody_was_told_of_comes_after_all_that_was_told(tmp_path: Path, left: int) -> None:
    """Killed between the bytes and their record: other streams were received, and processed, in the meantime."""
    archive = Archive(tmp_path)
    now_ns = gps_ns_from_unix_ns(time.time_ns())
    archive.append("ssr", now_ns - 1000, b"old")
    archive.append("rover", now_ns + 1000, b"told")  # by a clock that is ahead of the file system's
    archive.append("ssr", now_ns + 2000, b"untold")
    (index,) = (tmp_path / "ssr").rglob("*.index")
    os.truncate(index, INDEX_RECORD.itemsize + left)
    again = Archive(tmp_path)
    assert [(chunk.station, chunk.data) for chunk in replay(again, ["rover", "ssr"])] == [
        ("ssr", b"old"),
        ("rover", b"told"),
        ("ssr", b"untold"),
    ]


def test_a_reader_sees_what_the_writer_appends(tmp_path: Path) -> None:
    writer = Archive(tmp_path)
    reader = Archive(tmp_path, writable=False)
    for i in range(3):
        writer.append("a", T0_NS + i * HOUR_NS, bytes([i]))
        assert [chunk.data for chunk in reader.chunks("a", i)] == [bytes([i])]


def test_pages_cover_everything(tmp_path: Path) -> None:
    archive = Archive(tmp_path)
    for i in range(50):
        archive.append("a", T0_NS + i * NS_PER_S, bytes([i]) * 100)
    position, seen = 0, b""
    while page := archive.read("a", position, max_bytes=350):
        assert sum(len(chunk.data) for chunk in page) <= 450
        seen += b"".join(chunk.data for chunk in page)
        position = page[-1].end
    assert seen == b"".join(bytes([i]) * 100 for i in range(50))


def test_replay_merges_by_receive_time(tmp_path: Path) -> None:
    archive = Archive(tmp_path)
    times = {"a": [0, 3, 4], "b": [1, 2, 5]}
    for station, ts in times.items():
        for t in ts:
            archive.append(station, T0_NS + t, bytes([t]))
    assert [chunk.data[0] for chunk in replay(archive, ["b", "a"])] == [0, 1, 2, 3, 4, 5]
    assert [chunk.data[0] for chunk in replay(archive, ["a", "b"], T0_NS + 2, T0_NS + 5)] == [2, 3, 4]
