"""One station's wiring, from bytes to motion and alerts. Pure: bytes and times in, records out.

    bytes ► decoder ► observations ► assembler ► epochs ► mode ► solutions, motion ► judgement ► alerts
                    ► ephemerides, corrections ► books
                    ► inertial samples ──────────────────► mode
    neighbours' bytes ► a pipeline each ► solutions ────────────────────────────► judgement

A neighbour's displacement is computed here once more, from the neighbour's bytes: so it is part of the station's state,
and a station needs nothing of another one but its archived stream, wherever that one is processed.

What a mode does with epochs and samples is in :mod:`plumbline.modes`. Live traffic, the replay of an archive and an
offline reprocessing all run this. Chunks come in the order of their receive times; what leaves depends on them alone.
:meth:`Pipeline.advance` only makes sooner what the next chunk would bring.
"""

import pickle
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from plumbline import modes
from plumbline.config import Mode, StationSettings
from plumbline.epochs.assembler import EpochAssembler
from plumbline.epochs.ephemeris_chain import EphemerisChain
from plumbline.epochs.stream import Books, NavigationFeed, StreamDecoder
from plumbline.epochs.time_base import TimeBase
from plumbline.gps_time import DAY_NS, NS_PER_S, WEEK_NS
from plumbline.judgement import Judge, JudgementState
from plumbline.modes.context import Outcome
from plumbline.modes.other_streams import OtherStreams
from plumbline.positioning.broadcast_source import BroadcastSource
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.satellites import SatelliteSource
from plumbline.positioning.station_facts import facts_of
from plumbline.quality.receiver_events import CONNECTIONS, ReceiverWatch, satellite_counts, slip_counts
from plumbline.records import (
    UNKNOWN_CHANNEL,
    AntennaDescription,
    Epoch,
    InertialBlock,
    Output,
    QualityReport,
    Solution,
    StationStatus,
    Threshold,
)
from plumbline.rtcm3 import DecodedMessage, InertialMessage, Message, Observations
from plumbline.rtcm3.station import describe
from plumbline.signals import System

__all__ = ["Books", "NavigationFeed", "Pipeline"]

_STATUS_INTERVAL_NS: Final = NS_PER_S
_HOUR_NS: Final = 3600 * NS_PER_S
_CONNECTIONS_KEPT: Final = 100
_HELD_SPAN_NS: Final = 180 * NS_PER_S  # how long messages wait for an ephemeris to tell their week


@dataclass(slots=True)
class PipelineState:
    """Everything that a station carries from chunk to chunk: what a checkpoint holds."""

    decoder: StreamDecoder
    assemblers: dict[int, EpochAssembler] = field(default_factory=dict)  # by RTCM station id
    books: Books = field(default_factory=Books)  # from the station's own stream
    description: AntennaDescription = field(default_factory=lambda: AntennaDescription(0))
    mode: object = None  # the mode's own
    pulled: dict[str, int] = field(default_factory=dict)  # by other stream: receive time up to which it was used
    judgement: JudgementState = field(default_factory=JudgementState)
    neighbours: "dict[str, PipelineState]" = field(default_factory=dict)
    held: list[tuple[Observations | InertialMessage, int]] = field(default_factory=list)
    base_offset_ns: int | None = None  # of the time base that the series rests on
    counters: Counter[str] = field(default_factory=Counter)
    receivers: dict[int, ReceiverWatch] = field(default_factory=dict)  # by antenna
    last_solution: Solution | None = None
    t_last_data_ns: int | None = None  # receive time of the last decoded observations
    t_last_status_ns: int = 0
    connection: str = ""  # the last connection event, in words
    connected_ns: tuple[int, ...] = ()  # receive times of the last hour's connections


class Pipeline:
    """One station. ``books`` are shared; ``source``, where given, replaces them (precise products, offline);
    ``neighbours`` are the settings of those that the station's own name.
    """

    def __init__(
        self,
        settings: StationSettings,
        thresholds: Sequence[Threshold],
        books: Books,
        source: SatelliteSource | None = None,
        neighbours: Sequence[StationSettings] = (),
    ) -> None:
        self.settings = settings
        self._judge = Judge(settings, thresholds, books, neighbours)
        self._neighbours = {n.station: Pipeline(_as_witness(n), (), books) for n in neighbours}
        self._shared = books
        self._facts: StationFacts | None = None
        self._deadline_ns = round(settings.epoch_deadline_s * NS_PER_S)
        self.state = PipelineState(StreamDecoder(settings.device.inertial_message))
        self._given_source = source
        self._context = modes.Context(settings, books, source or self._books_source(), self._facts_at)
        self._other_streams = OtherStreams(settings, books)
        self._adopt(self.state)

    def _adopt(self, state: PipelineState) -> None:
        """Go on from a state: the mode, the judgement and the neighbours from theirs in it."""
        self.state = state
        self._context.source = self._given_source or self._books_source()
        self._mode = modes.start(self._context, state.mode)
        state.mode = self._mode.state
        self._judge.resume(state.judgement)
        for name, neighbour in self._neighbours.items():
            neighbour._adopt(state.neighbours.get(name, neighbour.state))
        state.neighbours = {name: neighbour.state for name, neighbour in self._neighbours.items()}

    # ---------------------------------------------------------------------------------------- inputs

    def receive(self, data: bytes, t_receive_ns: int) -> list[Output]:
        """Take the next bytes of the station's own stream, received at a time; return all that they bring."""
        outputs = self._advance(t_receive_ns)
        for message in self.state.decoder.receive(data):
            outputs += self._message(message, t_receive_ns)
        return outputs + self._status(t_receive_ns)

    def receive_neighbour(self, name: str, data: bytes, t_receive_ns: int) -> list[Output]:
        """Take the next bytes of a neighbour's stream: what it shows speaks for or against what the station shows."""
        outputs = self._advance(t_receive_ns)
        self._hear(name, self._neighbours[name].receive(data, t_receive_ns))
        return outputs + self._status(t_receive_ns)

    def _hear(self, name: str, outputs: Sequence[Output]) -> None:
        for output in outputs:
            if isinstance(output, Solution):
                self._judge.said(self.state.judgement, name, output)

    def advance(self, t_receive_ns: int) -> list[Output]:
        """Time passes without data: close epochs that wait too long, and notice silence."""
        return self._advance(t_receive_ns) + self._status(t_receive_ns)

    def finish(self, t_receive_ns: int) -> list[Output]:
        """The stream has ended for good (a file): close what is open."""
        outputs = self._release_held()
        open_epochs = [epoch for assembler in self.state.assemblers.values() for epoch in assembler.flush()]
        outputs += self._process_epochs(open_epochs)
        outputs += self._told(self._mode.advance(t_receive_ns + self._deadline_ns + WEEK_NS))
        outputs += self._judge.finish(self.state.judgement)
        return outputs + self._status(t_receive_ns)

    def connection_event(self, kind: str, reason: str, t_receive_ns: int) -> list[Output]:
        """The device connected, went or was refused: words for the status, no influence on the series."""
        self.state.connection = f"{kind}: {reason}" if reason else kind
        if kind == "connected":
            within = (t for t in self.state.connected_ns if t_receive_ns - t < _HOUR_NS)
            self.state.connected_ns = (*within, t_receive_ns)[-_CONNECTIONS_KEPT:]
        self.state.t_last_status_ns = 0
        return self._status(t_receive_ns)

    # ---------------------------------------------------------------------------------------- checkpoint

    def snapshot(self) -> bytes:
        """The state, to be restored by :meth:`restore` of the same version."""
        return pickle.dumps(self.state, protocol=pickle.HIGHEST_PROTOCOL)

    @classmethod
    def restore(
        cls,
        settings: StationSettings,
        thresholds: Sequence[Threshold],
        books: Books,
        snapshot: bytes,
        neighbours: Sequence[StationSettings] = (),
    ) -> "Pipeline":
        """A pipeline that carries on where the snapshot was taken; one that cannot be read gives a fresh start."""
        pipeline = cls(settings, thresholds, books, neighbours=neighbours)
        try:
            state = pickle.loads(snapshot)
        except Exception as error:
            pipeline.state.counters[f"checkpoint_not_readable_{type(error).__name__}"] += 1
            return pipeline
        if isinstance(state, PipelineState):
            pipeline._adopt(state)
        return pipeline

    # ---------------------------------------------------------------------------------------- the flow

    def _message(self, message: DecodedMessage, t_receive_ns: int) -> list[Output]:
        if self._learn(message, t_receive_ns):
            return self._release_held() if self.state.books.time_base.known else []
        if isinstance(message, Observations | InertialMessage):
            return self._timed(message, t_receive_ns)
        if isinstance(message, Message) and self._antenna_of(message.fields.get("station", -1)) == 0:
            self.state.description = describe(self.state.description, message)
        return []

    def _learn(self, message: DecodedMessage, t_receive_ns: int) -> bool:
        books = self.state.books
        had_corrections = books.has_corrections
        learned = books.learn(message, t_receive_ns)
        if books.has_corrections != had_corrections and self._given_source is None:
            self._context.source = self._books_source()
        return learned

    def _base(self) -> TimeBase:
        """What tells the stream's week: its own ephemerides, else the shared ones."""
        own, shared = self.state.books.time_base, self._shared.time_base
        return shared if shared.known and not own.known else own

    def _timed(self, message: Observations | InertialMessage, t_receive_ns: int) -> list[Output]:
        """Hold messages back until an ephemeris tells their week; without one no position is lost by it."""
        if isinstance(message, Observations):
            self.state.t_last_data_ns = t_receive_ns
        if self._base().known:
            return self._release_held() + self._use(message, t_receive_ns)
        self.state.held.append((message, t_receive_ns))
        first, last = (_time_of(*self.state.held[k]) for k in (0, -1))
        span_ns = (last - first + DAY_NS // 2) % DAY_NS - DAY_NS // 2  # weeks and days are guesses as yet
        return self._release_held() if abs(span_ns) > _HELD_SPAN_NS else []

    def _release_held(self) -> list[Output]:
        held, self.state.held = self.state.held, []
        return [output for message, t_receive_ns in held for output in self._use(message, t_receive_ns)]

    def _use(self, message: Observations | InertialMessage, t_receive_ns: int) -> list[Output]:
        base = self._base()
        if self.state.base_offset_ns is not None and abs(base.offset_ns - self.state.base_offset_ns) > WEEK_NS // 2:
            self._begin_anew()
        self.state.base_offset_ns = base.offset_ns
        near_ns = base.near(t_receive_ns)
        if isinstance(message, InertialMessage):
            return self.receive_inertial(message.block(near_ns, t_receive_ns))
        return self._assemble(message, message.t_gps_ns(near_ns), t_receive_ns)

    def _begin_anew(self) -> None:
        """The stream turns out to mean another week: what was filtered so far belongs to another series."""
        self.state.counters["time_base_moved_under_the_series"] += 1
        self.state.assemblers.clear()
        self._mode.begin_anew()
        self._judge.resume(self.state.judgement, anew=True)

    def _assemble(self, message: Observations, t_gps_ns: int, t_receive_ns: int) -> list[Output]:
        antenna = self._antenna_of(message.station)
        if antenna is None:
            self.state.counters[f"observations_of_other_antenna_{message.station}"] += 1
            return []
        assembler = self.state.assemblers.get(message.station)
        if assembler is None:
            assembler = self.state.assemblers[message.station] = EpochAssembler(self._deadline_ns)
        self._tell_channels(assembler, message, t_receive_ns)
        epochs = assembler.receive(message, t_gps_ns, t_receive_ns)
        return [output for epoch in epochs for output in self.process_epoch(epoch, antenna)]

    def _tell_channels(self, assembler: EpochAssembler, message: Observations, t_receive_ns: int) -> None:
        """GLONASS phases need their channel: where the message does not tell it, an ephemeris does."""
        if message.system is not System.GLONASS:
            return
        unknown = np.unique(message.satellite[message.glonass_channel == UNKNOWN_CHANNEL])
        for satellite, channel in zip(
            unknown, self._context.source.glonass_channels(t_receive_ns, unknown), strict=True
        ):
            if channel != UNKNOWN_CHANNEL:
                assembler.learn_channel(int(satellite), int(channel))

    def _antenna_of(self, rtcm_station: int) -> int | None:
        """Number of an antenna: its place among the settings' station ids; without any, the first one seen is 0."""
        own = self.settings.device.rtcm_station_ids[: self.settings.n_own_antennas] or tuple(self.state.assemblers)[:1]
        return own.index(rtcm_station) if rtcm_station in own else (None if own else 0)

    def _advance(self, t_receive_ns: int) -> list[Output]:
        """Everything up to a receive time that is not the station's own bytes: other streams' inputs, deadlines."""
        for name, neighbour in self._neighbours.items():
            self._hear(name, neighbour.advance(t_receive_ns))
        outputs: list[Output] = []
        for arrival in self._other_streams.until(t_receive_ns, self.state.pulled):
            outputs += self._close_overdue(arrival.t_receive_ns)
            if isinstance(arrival.what, InertialBlock):
                outputs += self.receive_inertial(arrival.what)
            else:
                outputs += self.process_epoch(arrival.what, arrival.antenna)
        outputs += self._close_overdue(t_receive_ns)
        return [*outputs, *self._judge.advance(self.state.judgement, t_receive_ns)]

    def _close_overdue(self, t_receive_ns: int) -> list[Output]:
        overdue = [epoch for a in self.state.assemblers.values() for epoch in a.advance(t_receive_ns)]
        return self._process_epochs(overdue) + self._told(self._mode.advance(t_receive_ns))

    def _process_epochs(self, epochs: Sequence[Epoch]) -> list[Output]:
        numbered = [(epoch, self._antenna_of(epoch.antenna) or 0) for epoch in epochs]
        return [output for epoch, antenna in numbered for output in self.process_epoch(epoch, antenna)]

    def process_epoch(self, epoch: Epoch, antenna: int = 0) -> list[Output]:
        """Use one epoch of an antenna, whichever way it came."""
        self.state.t_last_data_ns = epoch.t_receive_ns
        self.state.receivers.setdefault(antenna, ReceiverWatch()).see(epoch)
        return self._told(self._mode.receive_epoch(epoch, antenna))

    def receive_inertial(self, block: InertialBlock) -> list[Output]:
        """Take samples that are already a record (from a file)."""
        return self._told(self._mode.receive_inertial(block))

    def _facts_at(self, epoch: Epoch) -> StationFacts:
        if self._facts is None:
            self._facts = facts_of(self.settings, epoch.t_gps_ns, self.state.description.antenna_type or "")
        return self._facts

    def _told(self, outcomes: Sequence[Outcome]) -> list[Output]:
        """What a mode has made, with the alerts that it raises."""
        for outcome in outcomes:
            if isinstance(outcome, Solution):
                self.state.last_solution = outcome
                self.state.counters.update(satellite_counts(outcome))
            elif isinstance(outcome, QualityReport):
                self.state.counters.update(slip_counts(outcome))
        return self._judge.told(self.state.judgement, outcomes)

    # ---------------------------------------------------------------------------------------- status

    def _status(self, t_receive_ns: int) -> list[Output]:
        """About once a second of receive time: what an operator should know."""
        if t_receive_ns - self.state.t_last_status_ns < _STATUS_INTERVAL_NS:
            return []
        self.state.t_last_status_ns = t_receive_ns
        solution = self.state.last_solution
        name, reason = self._health(t_receive_ns)
        status = StationStatus(
            station=self.settings.station,
            t_receive_ns=t_receive_ns,
            state=name,
            reason=reason,
            last_epoch_gps_ns=solution.t_gps_ns if solution else None,
            solution_status=solution.status if solution else None,
            n_satellites=solution.n_satellites if solution else 0,
            counters=self.counters,
        )
        return [status, *self._judge.status(self.state.judgement, status)]

    def _health(self, t_receive_ns: int) -> tuple[str, str]:
        """State and reason: receiving means decoded observations, not an open socket."""
        t_data_ns = self.state.t_last_data_ns
        if t_data_ns is None:
            return "waiting", self._why_waiting()
        silent_s = (t_receive_ns - t_data_ns) / NS_PER_S
        if silent_s > self.settings.silent_after_s:
            ending = f"; {self.state.connection}" if self.state.connection else ""
            return "silent", f"no observations for {silent_s:.0f} s{ending}"
        if self.state.last_solution is None:
            return "receiving", "waiting for an ephemeris: the stream has not sent one yet"
        return "receiving", self.state.last_solution.reason

    def _why_waiting(self) -> str:
        counters = self.counters
        if counters:
            told = ", ".join(f"{name} {n}" for name, n in sorted(counters.items()))
            return f"no observation message yet; not used: {told}"
        return self.state.connection or "no data yet"

    @property
    def counters(self) -> Mapping[str, int]:
        """What was not used, by reason, of all stages."""
        total = Counter(self.state.counters)
        total.update(self.state.decoder.counters)
        total.update(self.state.books.counters)
        for assembler in self.state.assemblers.values():
            total.update(assembler.counters)
        total.update(self._mode.counters)
        if len(self.state.connected_ns) > 1:
            total[CONNECTIONS] = len(self.state.connected_ns)
        for receiver in self.state.receivers.values():
            total.update(receiver.counters)
        return dict(total)

    def _books_source(self) -> SatelliteSource:
        """Ephemerides of the station's own stream first, then the shared ones; its own corrections if it has any."""
        own, shared = self.state.books, self._shared
        return BroadcastSource(
            EphemerisChain(own.ephemerides, shared.ephemerides),
            own.corrections if own.has_corrections else shared.corrections,
            self.settings.positioning,
        )


def _as_witness(settings: StationSettings) -> StationSettings:
    """A neighbour's settings as far as its displacement needs them: no accelerometer, no witnesses of its own."""
    plain = {Mode.PPP_ACCEL: Mode.PPP, Mode.RTK_IMU_LOOSE: Mode.RTK, Mode.RTK_IMU_TIGHT: Mode.RTK}
    mode = plain.get(settings.mode, settings.mode)
    return settings.model_copy(update={"mode": mode, "neighbours": ()})


def _time_of(message: Observations | InertialMessage, t_receive_ns: int) -> int:
    """A message's time by its receive time alone: differences are right, the week may not be."""
    if isinstance(message, InertialMessage):
        return message.block(t_receive_ns, t_receive_ns).t_first_gps_ns
    return message.t_gps_ns(t_receive_ns)
