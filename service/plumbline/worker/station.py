"""One station in a worker: its pipeline, the changes that wait for their time, and the messages that leave."""

import logging
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from plumbline.bus import codec, keys
from plumbline.bus.messages import CheckpointMessage, Numbered, StationConfig, encode_fields, encode_numbered
from plumbline.config import StationSettings
from plumbline.records import Chunk, Output, Solution, StationStatus
from plumbline.worker.processing import Processing, StationPipeline

log = logging.getLogger(__name__)


def new_run() -> str:
    """A name for an unbroken count of messages."""
    return secrets.token_hex(8)


@dataclass(frozen=True, slots=True)
class Setup:
    """Settings that a pipeline works under: the station's own and its neighbours'."""

    settings: StationSettings
    neighbours: tuple[StationSettings, ...] = ()
    changed_ns: int = field(default=0, compare=False)  # the latest change of any of them, GPS ns

    @classmethod
    def of(cls, config: StationConfig, neighbours: Sequence[StationConfig]) -> "Setup":
        """Of a station that exists, and of those of its neighbours that do."""
        if config.settings is None:
            raise ValueError(f"station {config.station} is deleted")
        present = tuple(n.settings for n in neighbours if n.settings is not None)
        return cls(config.settings, present, max(c.changed_gps_ns for c in (config, *neighbours)))

    @classmethod
    def from_json(cls, settings: str, neighbours: Sequence[str], changed_ns: int) -> "Setup":
        """Inverse of :meth:`to_json`."""
        read = StationSettings.model_validate_json
        return cls(read(settings), tuple(read(text) for text in neighbours), changed_ns)

    def to_json(self) -> dict[str, Any]:
        """For a checkpoint."""
        return {
            "settings": self.settings.model_dump_json(),
            "neighbours": [n.model_dump_json() for n in self.neighbours],
        }


class StationRunner:
    """A station from a checkpoint on. Every message that it makes is counted within its run."""

    def __init__(
        self,
        processing: Processing,
        config: StationConfig,
        books: Any,
        checkpoint: CheckpointMessage | None,
        neighbours: Sequence[StationConfig] = (),
    ) -> None:
        self.config = config
        self.consumed_ns = checkpoint.t_receive_ns if checkpoint else 0
        self._processing = processing
        self._books = books
        self._run, self._number = new_run(), 0
        self._coming: tuple[StationConfig, Setup] | None = None
        self._setup = Setup.of(config, neighbours)
        self.failures = 0
        self.unsaved = False
        self._unproven = checkpoint is not None  # a state that was restored and has given no solution yet
        self._pipeline = self._start(checkpoint)

    def _start(self, checkpoint: CheckpointMessage | None) -> StationPipeline:
        """A pipeline as it was, under the settings of that time; a change since then comes when its time does."""
        if checkpoint is None:
            return self._fresh()
        state = codec.decode(checkpoint.state)
        then = Setup.from_json(state["settings"], state.get("neighbours", ()), self._setup.changed_ns)
        if then != self._setup and self._setup.changed_ns > self.consumed_ns:
            self._coming, self._setup = (self.config, self._setup), then
        return self._restored(state["snapshot"])

    def _fresh(self) -> StationPipeline:
        setup = self._setup
        return self._processing.new_pipeline(
            setup.settings, self.config.thresholds, self._books, neighbours=setup.neighbours
        )

    def _restored(self, snapshot: bytes) -> StationPipeline:
        setup = self._setup
        return self._processing.restore_pipeline(
            setup.settings, self.config.thresholds, self._books, snapshot, neighbours=setup.neighbours
        )

    @property
    def neighbours(self) -> tuple[str, ...]:
        """The stations whose streams the pipeline is to be given, now or when a change comes."""
        coming = self._coming[1].neighbours if self._coming else ()
        return tuple(dict.fromkeys(n.station for n in (*self._setup.neighbours, *coming)))

    def change(self, config: StationConfig, neighbours: Sequence[StationConfig] = ()) -> None:
        """New settings or thresholds, to take effect behind the last byte received up to their time."""
        if config.settings is not None:
            self._coming = config, Setup.of(config, neighbours)

    def _apply_change(self, t_receive_ns: int) -> None:
        if self._coming is None or t_receive_ns <= self._coming[1].changed_ns:
            return
        (self.config, self._setup), self._coming = self._coming, None
        self._pipeline = self._restored(self._pipeline.snapshot())
        self.unsaved = True

    def receive(self, chunk: Chunk) -> list[Output]:
        """The next bytes of the station, or of a neighbour."""
        self._apply_change(chunk.t_receive_ns)
        self.consumed_ns = max(self.consumed_ns, chunk.t_receive_ns)
        self.unsaved = True
        if chunk.station == self.config.station:
            return self._guarded(lambda pipeline: pipeline.receive(chunk.data, chunk.t_receive_ns))
        if all(chunk.station != n.station for n in self._setup.neighbours):
            return []  # of one to come
        return self._guarded(lambda pipeline: pipeline.receive_neighbour(chunk.station, chunk.data, chunk.t_receive_ns))

    def advance(self, t_receive_ns: int) -> list[Output]:
        """Nothing more has come up to a time."""
        self._apply_change(t_receive_ns)
        outputs = self._guarded(lambda pipeline: pipeline.advance(t_receive_ns))
        self.unsaved = self.unsaved or not all(isinstance(output, StationStatus) for output in outputs)
        return outputs

    def connection_event(self, kind: str, reason: str, t_receive_ns: int) -> list[Output]:
        """The device came or went."""
        return self._guarded(lambda pipeline: pipeline.connection_event(kind, reason, t_receive_ns))

    def _guarded(self, work: Callable[[StationPipeline], list[Output]]) -> list[Output]:
        """A defect in one station's processing must not take the others along: it is logged and counted.

        A restored state that fails before it has given a solution is of another version: the station begins afresh.
        """
        try:
            outputs = work(self._pipeline)
        except Exception:
            self.failures += 1
            if self.failures & (self.failures - 1) == 0:
                log.exception("station %s: processing failed %d times", self.config.station, self.failures)
            if not self._unproven:
                return []
            log.error("station %s: its saved state cannot be used; it begins afresh", self.config.station)
            self._unproven = False
            self._pipeline = self._fresh()
            return self._guarded(work)
        self._unproven = self._unproven and not any(isinstance(output, Solution) for output in outputs)
        return outputs

    # ----------------------------------------------------------------------------------------- what leaves

    def messages(self, outputs: Sequence[Output]) -> list[tuple[str, bytes]]:
        """(key, payload) of each output."""
        station = self.config.station
        return [
            (keys.of(keys.OUTPUTS[type(output).__name__], station), self._numbered(codec.encode(output)))
            for output in outputs
        ]

    def checkpoint(self, consumed: Mapping[str, int]) -> tuple[str, bytes]:
        """(key, payload) of the state behind everything sent so far."""
        state = codec.encode({**self._setup.to_json(), "snapshot": self._pipeline.snapshot()})
        message = CheckpointMessage(self.config.station, self.consumed_ns, state, dict(consumed))
        self.unsaved = False
        return keys.of(keys.CHECKPOINT, self.config.station), self._numbered(encode_fields(message))

    def _numbered(self, body: bytes) -> bytes:
        message = Numbered(self._run, self._number, body)
        self._number += 1
        return encode_numbered(message)
