"""A stream's bytes → decoded messages, and what it says of satellites → the books; the rest is counted."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Final

from plumbline.epochs import translate_ephemeris, translate_ssr
from plumbline.epochs.assembler import EpochAssembler
from plumbline.epochs.base_book import BaseBook
from plumbline.epochs.correction_book import CorrectionBook
from plumbline.epochs.ephemeris_book import EphemerisBook
from plumbline.epochs.history import HISTORY_NS
from plumbline.epochs.reference_book import ReferenceBook
from plumbline.epochs.time_base import TimeBase
from plumbline.epochs.translate_ssr import SsrTranslator
from plumbline.records import (
    UNKNOWN_CHANNEL,
    AntennaDescription,
    Ephemeris,
    Epoch,
    GlonassEphemeris,
    InertialBlock,
    SsrClock,
    SsrOrbit,
)
from plumbline.rtcm3 import (
    DecodedMessage,
    FrameReader,
    InertialMessage,
    Malformed,
    Message,
    Observations,
    Unknown,
    decode,
)
from plumbline.rtcm3.station import describe
from plumbline.signals import System, system_of

_WEEKLESS_KEPT: Final = 500
_BASE_DEADLINE_NS: Final = 800_000_000  # how long a base's epoch waits for late constellations


class StreamDecoder:
    """Sans-IO: bytes in, decoded messages out, in order. Picklable."""

    def __init__(self, inertial_message: int = 4001) -> None:
        self._reader = FrameReader()
        self._inertial_message = inertial_message
        self.messages: Counter[str] = Counter()

    def receive(self, data: bytes) -> list[DecodedMessage]:
        """The messages that these bytes complete."""
        self._reader.receive_data(data)
        decoded: list[DecodedMessage] = []
        while (frame := self._reader.next_frame()) is not None:
            message = decode(frame.payload, inertial_number=self._inertial_message)
            if isinstance(message, Malformed):
                self.messages[f"malformed_{message.number}_{message.reason}"] += 1
            elif isinstance(message, Unknown):
                self.messages[f"unknown_{message.number}"] += 1
            else:
                decoded.append(message)
        return decoded

    @property
    def counters(self) -> dict[str, int]:
        """What was not used, by reason: bytes that were no frame, malformed and unknown messages."""
        return {f"bytes_{reason}": n for reason, n in self._reader.counters.items()} | dict(self.messages)


@dataclass(slots=True)
class Books:
    """Ephemerides and corrections of one or several streams, and their time base. Picklable."""

    ephemerides: EphemerisBook = field(default_factory=EphemerisBook)
    corrections: CorrectionBook = field(default_factory=CorrectionBook)
    time_base: TimeBase = field(default_factory=TimeBase)
    translators: dict[str, SsrTranslator] = field(default_factory=dict)  # by stream
    has_corrections: bool = False
    bases: dict[str, BaseBook] = field(default_factory=dict)  # by stream: observations that others use
    references: dict[str, ReferenceBook] = field(default_factory=dict)  # by stream: whether those bases stand still
    settled_ns: int = 0  # questions as of this receive time or later get the answers of that time, earlier ones may not
    inertial: dict[str, list[InertialBlock]] = field(default_factory=dict)  # by stream: an IMU's last minute
    _weekless: list[tuple[Message, int]] = field(
        default_factory=list
    )  # ephemerides that came before the week was known
    counters: Counter[str] = field(default_factory=Counter)

    def add_ephemeris(self, ephemeris: Ephemeris) -> None:
        """Take an ephemeris that is already a record (from a file)."""
        self.time_base.learn(ephemeris.toe_gps_ns, ephemeris.t_receive_ns)
        self.ephemerides.add(ephemeris)

    def learn(self, message: DecodedMessage, t_receive_ns: int, stream: str = "") -> bool:
        """Take a message if it is an ephemeris or an SSR correction; False if it is neither (its time is noted).

        ``stream`` names its source: dialects and providers are told apart by it."""
        near_ns = self.time_base.near(t_receive_ns)
        if isinstance(message, Observations) and message.system is not System.GLONASS:
            self.time_base.observe(message.t_gps_ns(near_ns))
        if not isinstance(message, Message):
            return False
        if message.number in translate_ephemeris.NUMBERS:
            self._learn_ephemeris(message, t_receive_ns, near_ns)
            return True
        if message.number in translate_ssr.NUMBERS:
            self._learn_correction(message, t_receive_ns, near_ns, stream)
            return True
        return False

    def _learn_ephemeris(self, message: Message, t_receive_ns: int, near_ns: int) -> None:
        ephemeris = translate_ephemeris.ephemeris_from_message(message, t_receive_ns, near_ns)
        if isinstance(ephemeris, translate_ephemeris.Rejected):
            self.counters[f"ephemeris_{ephemeris.reason}"] += 1
            return
        names_a_week = not isinstance(ephemeris, GlonassEphemeris)
        was_known = self.time_base.known
        moved = names_a_week and self.time_base.learn(ephemeris.toe_gps_ns, t_receive_ns)
        if self.time_base.known and not moved:
            self.ephemerides.add(ephemeris)
        else:
            self._weekless = [*self._weekless[-_WEEKLESS_KEPT:], (message, t_receive_ns)]
        if moved or self.time_base.known != was_known:
            self.settled_ns = t_receive_ns
        if moved:
            self.counters["time_base_moved"] += 1
            self.corrections.clear()
        if self.time_base.known and self._weekless:
            waiting, self._weekless = self._weekless, []
            for earlier, received_ns in waiting:
                self._learn_ephemeris(earlier, received_ns, self.time_base.near(received_ns))

    def _learn_correction(self, message: Message, t_receive_ns: int, near_ns: int, stream: str) -> None:
        translator = self.translators.setdefault(stream, SsrTranslator())
        corrections = translator.translate(message, t_receive_ns, near_ns)
        if isinstance(corrections, translate_ephemeris.Rejected):
            self.counters[f"correction_{corrections.reason}"] += 1
            return
        self.has_corrections = self.has_corrections or bool(corrections)
        for correction in corrections:
            if isinstance(correction, SsrOrbit | SsrClock) and not _is_glonass(correction):
                self.time_base.observe(correction.header.t_gps_ns)  # a stale bias's time is that of its arrival
            self.corrections.add(correction, stream)

    def base(self, stream: str, t_receive_ns: int) -> BaseBook:
        """The book of a base's stream, begun when it is asked for first."""
        if stream not in self.bases:
            self.bases[stream] = BaseBook()
            self.settled_ns = t_receive_ns
        return self.bases[stream]


class NavigationFeed:
    """A stream that stations share: ephemerides, corrections, an antenna's observations, an IMU's samples.

    Bytes in, books kept.
    """

    def __init__(self, stream: str, books: Books) -> None:
        self.stream = stream
        self._books = books
        self._decoder = StreamDecoder()
        self._assembler: EpochAssembler | None = None  # of a base's epochs
        self._description = AntennaDescription(0)

    def receive(self, data: bytes, t_receive_ns: int) -> None:
        """Decode and keep what is for the books; the rest is left alone."""
        if self._assembler is not None:
            self._keep(self._assembler.advance(t_receive_ns), t_receive_ns)
        for message in self._decoder.receive(data):
            if self._books.learn(message, t_receive_ns, self.stream):
                continue
            if isinstance(message, Observations):
                self._observe(message, t_receive_ns)
            elif isinstance(message, InertialMessage):
                self._keep_samples(message, t_receive_ns)
            elif isinstance(message, Message):
                self._describe(message, t_receive_ns)

    def _observe(self, message: Observations, t_receive_ns: int) -> None:
        """A base's observations, of the first antenna that the stream shows."""
        if self._assembler is None:
            self._assembler = EpochAssembler(_BASE_DEADLINE_NS)
            self._description = AntennaDescription(message.station, self._description.position_ecef_m)
        if message.station == self._description.antenna:
            self._tell_channels(message, t_receive_ns)
            t_gps_ns = message.t_gps_ns(self._books.time_base.near(t_receive_ns))
            self._keep(self._assembler.receive(message, t_gps_ns, t_receive_ns), t_receive_ns)

    def _tell_channels(self, message: Observations, t_receive_ns: int) -> None:
        """GLONASS phases need their channel: where the message does not tell it, an ephemeris does."""
        if message.system is not System.GLONASS or self._assembler is None:
            return
        for satellite in message.satellite[message.glonass_channel == UNKNOWN_CHANNEL].tolist():
            channel = self._books.ephemerides.glonass_channel(satellite, t_receive_ns)
            if channel != UNKNOWN_CHANNEL:
                self._assembler.learn_channel(satellite, channel)

    def _keep(self, epochs: list[Epoch], t_receive_ns: int) -> None:
        for epoch in epochs:
            self._books.base(self.stream, t_receive_ns).add(epoch)

    def _keep_samples(self, message: InertialMessage, t_receive_ns: int) -> None:
        block = message.block(self._books.time_base.near(t_receive_ns), t_receive_ns)
        held = self._books.inertial.get(self.stream, [])
        oldest_ns = t_receive_ns - HISTORY_NS
        self._books.inertial[self.stream] = [*(b for b in held if b.t_receive_ns >= oldest_ns), block]

    def _describe(self, message: Message, t_receive_ns: int) -> None:
        description = describe(self._description, message)
        if description != self._description:
            self._description = description
            self._books.base(self.stream, t_receive_ns).describe(description, t_receive_ns)

    @property
    def counters(self) -> dict[str, int]:
        """What was not used, by reason."""
        of_base = self._assembler.counters if self._assembler is not None else {}
        return self._decoder.counters | dict(of_base)


def _is_glonass(correction: SsrOrbit | SsrClock) -> bool:
    """GLONASS's times name no day of the week."""
    return correction.satellite.size > 0 and system_of(int(correction.satellite[0])) is System.GLONASS
