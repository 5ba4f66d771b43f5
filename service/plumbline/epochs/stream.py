"""A stream's bytes → decoded messages, and what it says of satellites → the books; the rest is counted."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Final

from plumbline.epochs import translate_ephemeris, translate_ssr
from plumbline.epochs.correction_book import CorrectionBook
from plumbline.epochs.ephemeris_book import EphemerisBook
from plumbline.epochs.time_base import TimeBase
from plumbline.epochs.translate_ssr import SsrTranslator
from plumbline.records import Ephemeris, GlonassEphemeris
from plumbline.rtcm3 import DecodedMessage, FrameReader, Malformed, Message, Observations, Unknown, decode
from plumbline.signals import System

_WEEKLESS_KEPT: Final = 500


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
        moved = names_a_week and self.time_base.learn(ephemeris.toe_gps_ns, t_receive_ns)
        if self.time_base.known and not moved:
            self.ephemerides.add(ephemeris)
        else:
            self._weekless = [*self._weekless[-_WEEKLESS_KEPT:], (message, t_receive_ns)]
        if moved:
            self.counters["time_base_moved"] += 1
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
            self.time_base.observe(correction.header.t_gps_ns)
            self.corrections.add(correction, stream)


class NavigationFeed:
    """A stream of ephemerides or corrections that stations share: bytes in, books kept."""

    def __init__(self, stream: str, books: Books) -> None:
        self.stream = stream
        self._books = books
        self._decoder = StreamDecoder()

    def receive(self, data: bytes, t_receive_ns: int) -> None:
        """Decode and keep what is for the books; the rest is left alone."""
        for message in self._decoder.receive(data):
            self._books.learn(message, t_receive_ns, self.stream)

    @property
    def counters(self) -> dict[str, int]:
        """What was not used, by reason."""
        return self._decoder.counters
