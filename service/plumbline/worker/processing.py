"""What a worker does with bytes, as the pipeline gives it: the one place where the two meet."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from plumbline.config import StationSettings
from plumbline.records import Output, Threshold


class StationPipeline(Protocol):
    """One station's state: see :class:`plumbline.pipeline.Pipeline`."""

    def receive(self, data: bytes, t_receive_ns: int) -> list[Output]:
        """The station's next bytes."""

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
    new_pipeline: Callable[[StationSettings, Sequence[Threshold], Any], StationPipeline]
    restore_pipeline: Callable[[StationSettings, Sequence[Threshold], Any, bytes], StationPipeline]


def real_processing() -> Processing:
    """The pipeline."""
    from plumbline.pipeline import Books, NavigationFeed, Pipeline

    return Processing(Books, NavigationFeed, Pipeline, Pipeline.restore)
