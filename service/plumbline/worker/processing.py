"""What a worker does with bytes, as the pipeline gives it: the one place where the two meet."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from plumbline.records import Output


class StationPipeline(Protocol):
    """One station's state: see :class:`plumbline.pipeline.Pipeline`."""

    def receive(self, data: bytes, t_receive_ns: int) -> list[Output]:
        """The station's next bytes."""

    def receive_neighbour(self, name: str, data: bytes, t_receive_ns: int) -> list[Output]:
        """The next bytes of a neighbour's stream."""

    def advance(self, t_receive_ns: int) -> list[Output]:
        """Time passes; nothing more has come up to it."""

    def connection_event(self, kind: str, reason: str, t_receive_ns: int) -> list[Output]:
        """The device came or went."""

    def snapshot(self) -> bytes:
        """The state."""


class Feed(Protocol):
    """One correction stream on its way into the books."""

    def receive(self, data: bytes, t_receive_ns: int) -> None:
        """The stream's next bytes."""

    @property
    def counters(self) -> dict[str, int]:
        """What was not used, by reason."""


@dataclass(frozen=True, slots=True)
class Processing:
    """Makers of books, feeds and pipelines."""

    new_books: Callable[[], Any]
    new_feed: Callable[[str, Any], Feed]
    new_pipeline: Callable[..., StationPipeline]  # (settings, thresholds, books, *, neighbours)
    restore_pipeline: Callable[..., StationPipeline]  # (settings, thresholds, books, snapshot, *, neighbours)


def real_processing() -> Processing:
    """The pipeline."""
    from plumbline.pipeline import Books, Pipeline
    from plumbline.quality.reference_feed import ReferenceFeed

    return Processing(Books, ReferenceFeed, Pipeline, Pipeline.restore)
