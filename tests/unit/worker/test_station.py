"""A station between its checkpoints. Oracle: what a pipeline that is never interrupted gives and knows."""

import pickle
from collections.abc import Sequence
from typing import Any

from plumbline.bus import codec
from plumbline.bus.messages import CheckpointMessage, StationConfig, decode_checkpoint, decode_numbered, encode_fields
from plumbline.config import StationSettings
from plumbline.epochs.stream import Books
from plumbline.gps_time import NS_PER_S
from plumbline.records import Chunk, Output, Solution, StationStatus, Status, Threshold
from plumbline.worker.processing import Processing, real_processing
from plumbline.worker.shared_books import SharedBooks
from plumbline.worker.station import StationRunner

CONFIG = StationConfig("bridge", StationSettings(station="bridge"))


def solution(t_ns: int) -> Solution:
    return Solution("bridge", t_ns, t_ns, Status.NO_CORRECTIONS, "no corrections")


class OpenEpoch:
    """A pipeline reduced to its shape: bytes open an epoch, time closes it. Its state is the open epoch."""

    def __init__(
        self,
        settings: StationSettings,
        thresholds: Sequence[Threshold],
        books: Any,
        neighbours: Sequence[StationSettings] = (),
    ) -> None:
        self.opened_ns: int | None = None

    def receive(self, data: bytes, t_receive_ns: int) -> list[Output]:
        self.opened_ns = t_receive_ns
        return []

    def receive_neighbour(self, name: str, data: bytes, t_receive_ns: int) -> list[Output]:
        return []

    def advance(self, t_receive_ns: int) -> list[Output]:
        if self.opened_ns is None:
            return [StationStatus("bridge", t_receive_ns, "receiving", "", None, None, 0, {})]
        opened_ns, self.opened_ns = self.opened_ns, None
        return [solution(opened_ns)]

    def connection_event(self, kind: str, reason: str, t_receive_ns: int) -> list[Output]:
        return []

    def snapshot(self) -> bytes:
        return pickle.dumps(self.opened_ns)

    @classmethod
    def restore(
        cls,
        settings: StationSettings,
        thresholds: Sequence[Threshold],
        books: Any,
        state: bytes,
        neighbours: Sequence[StationSettings] = (),
    ) -> Any:
        pipeline = cls(settings, thresholds, books)
        pipeline.opened_ns = pickle.loads(state)
        return pipeline


PROCESSING = Processing(Books, real_processing().new_feed, OpenEpoch, OpenEpoch.restore)


def saved(runner: StationRunner) -> CheckpointMessage:
    return decode_checkpoint(decode_numbered(runner.checkpoint({})[1]).body)


def test_an_epoch_closed_by_time_alone_is_saved_as_closed() -> None:
    """Else a take-over, hours later, would close it again, by then with other corrections at hand."""
    runner = StationRunner(PROCESSING, CONFIG, Books(), None)
    runner.receive(Chunk("x", "bridge", 0, 5 * NS_PER_S, b"epoch"))
    saved(runner)
    assert not runner.unsaved
    assert runner.advance(6 * NS_PER_S) == [solution(5 * NS_PER_S)]
    assert runner.unsaved
    again = StationRunner(PROCESSING, CONFIG, Books(), saved(runner))
    assert not any(isinstance(output, Solution) for output in again.advance(9 * NS_PER_S))
    assert not again.unsaved  # a status is no news to save


def test_a_state_of_another_version_is_given_up_at_its_first_failure() -> None:
    """It can be read, but lacks what this version's pipeline uses."""
    processing = real_processing()
    runner = StationRunner(processing, CONFIG, processing.new_books(), None)
    message = saved(runner)
    state = codec.decode(message.state)
    pipeline_state = pickle.loads(state["snapshot"])
    del pipeline_state.decoder._reader
    spoiled = codec.encode(state | {"snapshot": pickle.dumps(pipeline_state)})
    checkpoint = decode_checkpoint(encode_fields(CheckpointMessage("bridge", NS_PER_S, spoiled, {})))
    again = StationRunner(processing, CONFIG, processing.new_books(), checkpoint)
    for second in (2, 3):
        outputs = again.receive(Chunk("x", "bridge", second, second * NS_PER_S, b"?"))
        assert [type(output) for output in outputs] == [StationStatus]
    assert again.failures == 1


def test_books_answer_for_the_last_minute_but_not_for_before_a_change_of_their_time_base() -> None:
    books = SharedBooks(PROCESSING)
    books.restore((), ["ssr"], needed_ns=0)
    assert books.answers_from_ns() == 0
    books.receive(Chunk("x", "ssr", 0, 1000 * NS_PER_S, b"noise"))
    assert books.answers_from_ns() == 940 * NS_PER_S
    books.books.settled_ns = 990 * NS_PER_S
    assert books.answers_from_ns() == 990 * NS_PER_S
    books.receive(Chunk("y", "ssr", 0, 900 * NS_PER_S, b"from an ingest that was away"))
    assert books.fed_ns == 1000 * NS_PER_S
