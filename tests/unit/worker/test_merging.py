"""Chunks in order, whatever order they come in. Oracle: sorting all chunks of all streams by receive time."""

import random
from collections import deque
from collections.abc import Callable, Iterator

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

    def answer(self, cursor: Cursor, after_ns: int, n_received: int, n: int) -> ArchiveReply:
        """What is archived of the first ``n_received`` chunks, at most ``n`` of those received after a time."""
        received = [c for c in self.chunks[:n_received] if c.station == cursor.station]
        rest = [c for c in received if c.t_receive_ns > after_ns]
        now_ns = self.chunks[n_received - 1].t_receive_ns + 1 if n_received else 1
        return ArchiveReply(received[-1].end if received else 0, self.generation, now_ns, tuple(rest[:n]))


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
            after_ns = merger.asked(cursor)
            merger.fetched(cursor, archives[cursor.archive].answer(cursor, after_ns, n_received, n))
        yield from merger.release()


@pytest.mark.parametrize("seed", range(40))
def test_live_loss_and_restart_change_nothing(seed: int) -> None:
    """Start in the middle of the traffic, lose every fifth published chunk: out come all, once, in order."""
    archive = FakeArchive("x", seed)
    archives = {"x": archive}
    choice = random.Random(seed)
    merger = Merger()
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
    merger = Merger()
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
    merger = Merger()
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
    merger = Merger()
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
    merger = Merger()
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
    merger = Merger()
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
    merger = Merger()
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


def two_live_streams() -> Merger:
    """A station "a" and corrections "ssr" of the archive x, both live up to 100, nothing received yet."""
    merger = Merger()
    merger.ingest_came("x")
    merger.follow("x", "a", correction=False, from_ns=0)
    merger.follow("x", "ssr", correction=True, from_ns=0)
    for cursor in merger.wanted():
        merger.fetched(cursor, ArchiveReply(0, 1, 100, ()))
    merger.tick(Tick("x", 1, 100))
    assert not merger.wanted()
    return merger


def test_what_is_published_while_a_stream_is_fetched_is_not_forgotten() -> None:
    """The archive answers, and before its answer is here a correction and a later chunk of a station are."""
    merger = two_live_streams()
    merger.refetch()
    station, correction = merger.wanted()
    for cursor in (station, correction):
        merger.asked(cursor)
    merger.fetched(station, ArchiveReply(0, 1, 150, ()))
    merger.offer(Chunk("x", "ssr", 0, 200, b"s"))
    merger.offer(Chunk("x", "a", 0, 230, b"a"))
    merger.tick(Tick("x", 1, 300))
    merger.fetched(correction, ArchiveReply(0, 1, 150, ()))
    assert [c.station for c in merger.release()] == ["ssr", "a"]
    assert not merger.wanted()


def test_an_answer_that_ends_before_what_was_published_proves_nothing() -> None:
    """Of two corrections published while the archive was asked, the first was missed."""
    merger = two_live_streams()
    merger.refetch()
    station, correction = merger.wanted()
    for cursor in (station, correction):
        merger.asked(cursor)
    merger.fetched(station, ArchiveReply(0, 1, 150, ()))
    merger.offer(Chunk("x", "ssr", 1, 210, b"t"))
    merger.offer(Chunk("x", "a", 0, 230, b"a"))
    merger.tick(Tick("x", 1, 300))
    merger.fetched(correction, ArchiveReply(0, 1, 150, ()))
    assert list(merger.release()) == []
    assert merger.wanted() == [correction]
    merger.asked(correction)
    both = Chunk("x", "ssr", 0, 200, b"s"), Chunk("x", "ssr", 1, 210, b"t")
    merger.fetched(correction, ArchiveReply(2, 1, 310, both))
    assert [c.data for c in merger.release()] == [b"s", b"t", b"a"]


@pytest.mark.parametrize("loss", ["overflow", "generation"])
def test_a_question_asked_before_a_loss_makes_nothing_live(loss: str) -> None:
    """The answer was on its way when messages after it were lost: the correction at 200 is in the archive alone."""
    merger = two_live_streams()
    merger.refetch()
    station, correction = merger.wanted()
    for cursor in (station, correction):
        merger.asked(cursor)
    if loss == "overflow":
        merger.refetch()
    else:
        merger.tick(Tick("x", 2, 205))
    merger.tick(Tick("x", 2, 300))
    merger.fetched(station, ArchiveReply(1, 1, 150, (Chunk("x", "a", 0, 140, b"a"),)))
    merger.fetched(correction, ArchiveReply(0, 1, 150, ()))
    assert [c.station for c in merger.release()] == ["a"]  # that much the answers prove
    assert merger.idle_until_ns("a") == 150
    assert merger.wanted() == [station, correction]


def test_a_station_of_an_ingest_that_is_gone_waits_for_its_corrections() -> None:
    """Killed while its corrections were being fetched: what they lack is in its archive, and comes back with it."""
    merger = two_live_streams()
    merger.ingest_went("x")
    merger.ingest_came("x")
    station, correction = merger.wanted()
    merger.asked(station)
    merger.fetched(station, ArchiveReply(1, 2, 260, (Chunk("x", "a", 0, 230, b"a"),)))
    merger.ingest_went("x")
    assert list(merger.release()) == []
    merger.ingest_came("x")
    for cursor in merger.wanted():
        merger.asked(cursor)
    merger.fetched(station, ArchiveReply(1, 3, 400, ()))
    merger.fetched(correction, ArchiveReply(1, 3, 400, (Chunk("x", "ssr", 0, 200, b"s"),)))
    assert [c.station for c in merger.release()] == ["ssr", "a"]


def test_a_chunk_that_a_dead_ingest_holds_back_holds_back_no_other_ingest() -> None:
    merger = two_live_streams()
    merger.ingest_came("y")
    merger.follow("y", "b", correction=False, from_ns=0)
    for cursor in merger.wanted():
        merger.fetched(cursor, ArchiveReply(0, 1, 100, ()))
    merger.offer(Chunk("x", "a", 0, 230, b"a"))
    merger.refetch("x")
    merger.ingest_went("x")
    merger.offer(Chunk("y", "b", 0, 300, b"b"))
    assert [c.station for c in merger.release()] == ["b"]


class Network:
    """One ingest, its bus and a worker: messages arrive in order and late, answers at any later time.

    The ingest may be killed with messages unsent, jam (and tell so), and the worker's inbox may overflow.
    """

    def __init__(self, seed: int) -> None:
        self.choice = random.Random(seed)
        self.archive = FakeArchive("x", seed)
        self.merger = Merger()
        self.out: list[Chunk] = []
        self.n_received = 0
        self.on_their_way: deque[Callable[[], None]] = deque()
        self.answers: dict[tuple[str, str], tuple[Cursor, ArchiveReply]] = {}
        self.on_their_way.append(self.come)
        self.untold = False

    def come(self) -> None:
        follow_all(self.merger, "x")

    def receive(self) -> None:
        """The ingest's next chunk, archived, and published unless the bus is jammed."""
        chunk = self.archive.chunks[self.n_received]
        self.n_received += 1
        if self.choice.random() < 0.05:
            self.archive.generation += 1
            self.untold = True
            return
        if self.untold:
            self.tell(chunk.t_receive_ns - 1)
        self.on_their_way.append(lambda: self.merger.offer(chunk))

    def tell(self, t_ns: int) -> None:
        self.untold = False
        tick = Tick("x", self.archive.generation, t_ns)
        self.on_their_way.append(lambda: self.merger.tick(tick))

    def now_ns(self) -> int:
        return self.archive.chunks[self.n_received - 1].t_receive_ns + 1 if self.n_received else 1

    def die(self) -> None:
        """`kill -9`, with some messages unsent, and another start."""
        for _ in range(self.choice.randrange(len(self.on_their_way) + 1)):
            self.on_their_way.pop()
        self.answers.clear()
        self.archive.generation += 1
        self.untold = False
        self.on_their_way.append(lambda: self.merger.ingest_went("x"))
        self.on_their_way.append(self.come)

    def step(self) -> None:
        """One thing happens."""
        roll = self.choice.random()
        if roll < 0.25 and self.n_received < len(self.archive.chunks):
            self.receive()
        elif roll < 0.35:
            self.tell(self.now_ns())
        elif roll < 0.60 and self.on_their_way:
            self.on_their_way.popleft()()
        elif roll < 0.75:
            self.ask()
        elif roll < 0.90 and self.answers:
            key = self.choice.choice(sorted(self.answers))
            self.merger.fetched(*self.answers.pop(key))
        elif roll < 0.905:
            self.die()
        elif roll < 0.91 and self.on_their_way:
            for _ in range(self.choice.randrange(len(self.on_their_way))):
                self.lose_next()
        else:
            self.out += self.merger.release()

    def lose_next(self) -> None:
        """The worker's inbox is full: what comes next is dropped, and the worker knows that something was."""
        message = self.on_their_way.popleft()
        if message == self.come:  # the coming of an ingest is never dropped
            message()
        self.merger.refetch()

    def ask(self) -> None:
        for cursor in self.merger.wanted():
            if cursor.key not in self.answers:
                after_ns = self.merger.asked(cursor)
                answer = self.archive.answer(cursor, after_ns, self.n_received, self.choice.randrange(1, 9))
                self.answers[cursor.key] = cursor, answer

    def settle(self) -> None:
        """The traffic has ended: everything arrives."""
        while self.on_their_way:
            self.on_their_way.popleft()()
        for key in list(self.answers):
            self.merger.fetched(*self.answers.pop(key))
        self.tell(self.now_ns())
        self.on_their_way.popleft()()
        for _ in range(1000):
            self.out += self.merger.release()
            self.ask()
            for key in list(self.answers):
                self.merger.fetched(*self.answers.pop(key))


@pytest.mark.parametrize("seed", range(100))
def test_whatever_is_late_lost_or_killed_changes_nothing(seed: int) -> None:
    network = Network(seed)
    while network.n_received < len(network.archive.chunks):
        network.step()
    network.settle()
    assert_in_order(network.out, network.archive.chunks)


def test_bytes_consumed_before_are_not_released_again() -> None:
    archive = FakeArchive("x", 3)
    merger = Merger()
    consumed_ns = archive.chunks[149].t_receive_ns
    follow_all(merger, "x", from_ns=consumed_ns)
    merger.offer(archive.chunks[100])  # still on its way when the subscription began
    assert_in_order(list(fetch_all(merger, {"x": archive}, 300)), archive.chunks[150:])


def test_an_archive_shortened_by_a_power_failure_goes_on() -> None:
    merger = Merger()
    merger.ingest_came("x")
    merger.follow("x", "a", correction=False, from_ns=0)
    (cursor,) = merger.wanted()
    merger.fetched(cursor, ArchiveReply(10, 1, 100, (Chunk("x", "a", 0, 50, bytes(10)),)))
    assert len(list(merger.release())) == 1
    merger.ingest_went("x")
    merger.ingest_came("x")
    (cursor,) = merger.wanted()
    merger.asked(cursor)
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
