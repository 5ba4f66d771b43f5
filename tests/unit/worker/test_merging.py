"""Chunks in order, whatever order they come in. Oracle: sorting all chunks of all streams by receive time."""

import random
from collections.abc import Iterator

import pytest

from plumbline.app.store_role import Continuity
from plumbline.bus.messages import ArchiveReply, Tick
from plumbline.records import Chunk
from plumbline.worker.merging import Cursor, Merger
from plumbline.worker.ownership import owner

STREAMS = {"a": False, "b": False, "ssr": True, "eph": True}


class FakeArchive:
    """The chunks of one ingest, as its archive would answer for them."""

    def __init__(self, name: str, seed: int) -> None:
        choice = random.Random(seed)
        self.name = name
        self.generation = 1
        self.chunks: list[Chunk] = []
        ends = dict.fromkeys(STREAMS, 0)
        t_ns = 1000 + seed
        for _ in range(300):
            t_ns += choice.randrange(2, 20) * 2
            stream = choice.choice(sorted(STREAMS))
            data = bytes(choice.randrange(1, 5))
            self.chunks.append(Chunk(name, stream, ends[stream], t_ns, data))
            ends[stream] += len(data)

    def answer(self, cursor: Cursor, n_received: int, n: int) -> ArchiveReply:
        """What is archived of the first ``n_received`` chunks, at most ``n`` of them."""
        received = [c for c in self.chunks[:n_received] if c.station == cursor.station]
        end = received[-1].end if received else 0
        if cursor.next_offset is None:
            rest = [c for c in received if c.t_receive_ns > cursor.last_ns]
        else:
            rest = [c for c in received if c.offset >= cursor.next_offset]
        now_ns = self.chunks[n_received - 1].t_receive_ns + 1 if n_received else 1
        return ArchiveReply(end, self.generation, now_ns, tuple(rest[:n]))


def assert_in_order(out: list[Chunk], wanted: list[Chunk]) -> None:
    """Every chunk once; each station sees its own and the corrections in order (it waits for no other station)."""
    assert sorted(out, key=lambda c: c.t_receive_ns) == wanted
    for station in ("a", "b"):
        assert [c for c in out if c.station != station] == [c for c in wanted if c.station != station]


def follow_all(merger: Merger, archive: str, from_ns: int = 0) -> None:
    merger.ingest_came(archive)
    for stream, correction in STREAMS.items():
        merger.follow(archive, stream, correction=correction, from_ns=from_ns)


def fetch_all(merger: Merger, archives: dict[str, FakeArchive], n_received: int, n: int = 7) -> Iterator[Chunk]:
    while wanted := merger.wanted():
        for cursor in wanted:
            merger.fetched(cursor, archives[cursor.archive].answer(cursor, n_received, n))
        yield from merger.release()


@pytest.mark.parametrize("seed", range(40))
def test_live_loss_and_restart_change_nothing(seed: int) -> None:
    """Start in the middle of the traffic, lose every fifth published chunk: out come all, once, in order."""
    archive = FakeArchive("x", seed)
    archives = {"x": archive}
    choice = random.Random(seed)
    merger = Merger(lead_ns=0)
    begin = 100
    follow_all(merger, "x")
    out = list(fetch_all(merger, archives, begin))
    for i in range(begin, len(archive.chunks)):
        if choice.random() < 0.2:
            archive.generation += 1  # not published, and the next tick tells
        else:
            merger.offer(archive.chunks[i])
        merger.tick(Tick("x", archive.generation, archive.chunks[i].t_receive_ns + 1))
        out += merger.release()
        out += fetch_all(merger, archives, i + 1)
    assert_in_order(out, archive.chunks)
    assert merger.consumed("a") == {"x": [c for c in archive.chunks if c.station == "a"][-1].end}


def test_a_lost_chunk_in_the_middle_is_noticed_by_its_offset_alone() -> None:
    archive = FakeArchive("x", 5)
    merger = Merger(lead_ns=0)
    follow_all(merger, "x")
    out = list(fetch_all(merger, {"x": archive}, 10))
    of_a = [i for i, c in enumerate(archive.chunks) if c.station == "a" and i >= 10]
    for i in range(10, of_a[1] + 1):
        if i != of_a[0]:
            merger.offer(archive.chunks[i])
            out += merger.release()
    assert merger.wanted()
    out += fetch_all(merger, {"x": archive}, of_a[1] + 1)
    assert [c for c in out if c.station == "a"] == [c for c in archive.chunks[: of_a[1] + 1] if c.station == "a"]


def test_two_ingests_are_merged_by_receive_time() -> None:
    archives = {"x": FakeArchive("x", 0), "y": FakeArchive("y", 1)}  # their stamps never coincide
    merger = Merger(lead_ns=0)
    for name in archives:
        follow_all(merger, name)
    out = list(fetch_all(merger, archives, 0))
    for i in range(300):  # y's traffic arrives in lumps, x's at once
        merger.offer(archives["x"].chunks[i])
        if i % 50 == 49:
            for chunk in archives["y"].chunks[i - 49 : i + 1]:
                merger.offer(chunk)
        out += merger.release()
    for name, archive in archives.items():
        merger.tick(Tick(name, 1, archive.chunks[-1].t_receive_ns + 10_000))
    out += merger.release()
    assert_in_order(out, sorted(archives["x"].chunks + archives["y"].chunks, key=lambda c: c.t_receive_ns))


def test_a_dead_ingest_holds_nobody_up() -> None:
    archives = {"x": FakeArchive("x", 0), "y": FakeArchive("y", 1)}
    merger = Merger(lead_ns=0)
    for name in archives:
        follow_all(merger, name)
    out = list(fetch_all(merger, archives, 0))
    for chunk in archives["x"].chunks:
        merger.offer(chunk)
    assert len(out) + len(list(merger.release())) < 300  # y may still have something older
    merger.ingest_went("y")
    out = [*out, *merger.release()]
    merger.tick(Tick("x", 1, archives["x"].chunks[-1].t_receive_ns + 1))
    out += merger.release()
    assert out[-1] == archives["x"].chunks[-1]


def test_a_station_waits_for_corrections_that_are_being_fetched() -> None:
    merger = Merger(lead_ns=0)
    merger.ingest_came("x")
    merger.follow("x", "a", correction=False, from_ns=0)
    merger.follow("x", "ssr", correction=True, from_ns=0)
    station, correction = merger.wanted()
    merger.fetched(station, ArchiveReply(3, 1, 1000, (Chunk("x", "a", 0, 500, b"abc"),)))
    assert list(merger.release()) == []
    merger.fetched(correction, ArchiveReply(1, 1, 1001, (Chunk("x", "ssr", 0, 400, b"s"),)))
    assert [c.station for c in merger.release()] == ["ssr", "a"]
    assert merger.idle_until_ns("a") == 1000


def test_an_answer_for_one_stream_says_nothing_of_chunks_of_others_on_their_way() -> None:
    merger = Merger(lead_ns=0)
    merger.ingest_came("x")
    merger.follow("x", "a", correction=False, from_ns=0)
    merger.follow("x", "ssr", correction=True, from_ns=0)
    for cursor in merger.wanted():
        merger.fetched(cursor, ArchiveReply(0, 1, 100, ()))
    merger.follow("x", "b", correction=False, from_ns=0)
    (cursor,) = merger.wanted()
    merger.fetched(cursor, ArchiveReply(1, 1, 500, (Chunk("x", "b", 0, 450, b"b"),)))
    assert list(merger.release()) == []  # a correction of before 450 may be under way
    merger.offer(Chunk("x", "ssr", 0, 400, b"s"))
    merger.tick(Tick("x", 1, 600))
    assert [c.station for c in merger.release()] == ["ssr", "b"]


def test_a_correction_from_the_archive_waits_for_a_station_s_chunk_on_its_way() -> None:
    merger = Merger(lead_ns=0)
    merger.ingest_came("x")
    merger.follow("x", "b", correction=False, from_ns=0)
    (cursor,) = merger.wanted()
    merger.fetched(cursor, ArchiveReply(0, 1, 100, ()))
    merger.follow("x", "ssr", correction=True, from_ns=0)
    (cursor,) = merger.wanted()
    merger.fetched(cursor, ArchiveReply(1, 1, 1000, (Chunk("x", "ssr", 0, 900, b"s"),)))
    assert list(merger.release()) == []
    merger.offer(Chunk("x", "b", 0, 700, b"b"))
    merger.tick(Tick("x", 1, 1000))
    assert [c.station for c in merger.release()] == ["b", "ssr"]


def test_bytes_consumed_before_are_not_released_again() -> None:
    archive = FakeArchive("x", 3)
    merger = Merger(lead_ns=0)
    consumed_ns = archive.chunks[149].t_receive_ns
    follow_all(merger, "x", from_ns=consumed_ns)
    merger.offer(archive.chunks[100])  # still on its way when the subscription began
    assert_in_order(list(fetch_all(merger, {"x": archive}, 300)), archive.chunks[150:])


def test_an_archive_shortened_by_a_power_failure_goes_on() -> None:
    merger = Merger(lead_ns=0)
    merger.ingest_came("x")
    merger.follow("x", "a", correction=False, from_ns=0)
    (cursor,) = merger.wanted()
    merger.fetched(cursor, ArchiveReply(10, 1, 100, (Chunk("x", "a", 0, 50, bytes(10)),)))
    assert len(list(merger.release())) == 1
    merger.ingest_went("x")
    merger.ingest_came("x")
    (cursor,) = merger.wanted()
    merger.fetched(cursor, ArchiveReply(4, 2, 200, ()))
    merger.offer(Chunk("x", "a", 4, 300, b"new"))
    assert [c.data for c in merger.release()] == [b"new"]
    assert merger.consumed("a") == {"x": 7}


def test_rendezvous_moves_only_what_it_must() -> None:
    stations = [f"station-{i}" for i in range(2000)]
    workers = ["w1", "w2", "w3", "w4"]
    before = {s: owner(s, workers) for s in stations}
    shares = [list(before.values()).count(w) for w in workers]
    assert min(shares) > 400  # 500 each, give or take 4 sigma (77)
    without = {s: owner(s, [w for w in workers if w != "w2"]) for s in stations}
    assert all(without[s] == before[s] for s in stations if before[s] != "w2")
    assert {without[s] for s in stations if before[s] == "w2"} == {"w1", "w3", "w4"}
    assert owner("x", []) is None
    assert owner("x", reversed(workers)) == owner("x", workers)


def test_a_gap_in_a_run_spoils_it_and_a_new_run_begins_afresh() -> None:
    seen = Continuity()
    assert [seen.follows("a", "run1", n) for n in (0, 1, 2)] == [True, True, True]
    assert not seen.follows("a", "run1", 4)
    assert not seen.follows("a", "run1", 5)
    assert seen.follows("a", "run2", 0)
    assert not seen.follows("b", "run3", 7)  # the store came in the middle
    seen.forget()
    assert not seen.follows("a", "run2", 1)
