"""What an admitted device sends, taken apart (sans-IO): prefixes out, heartbeats counted, stations told apart.

A connection of one station passes through as it comes, whatever it holds (the frame reader behind the archive sorts it
out), except that a prefix before every packet is taken out, for it may stand in the middle of a frame. A connection of
several stations is cut into frames, and each goes to the station that its reference station id (DF003) belongs to.
"""

from collections import Counter
from dataclasses import dataclass, field

from plumbline.ingest.directory import unescape
from plumbline.ingest.http_chunked import ChunkedDecoder
from plumbline.ingest.registration import Admitted
from plumbline.rtcm3.framing import FrameReader


@dataclass(frozen=True, slots=True)
class Received:
    """What bytes of a device came to: the bytes for each station, in order, and what to answer."""

    parts: tuple[tuple[str, bytes], ...] = ()
    reply: bytes = b""
    error: str = ""


@dataclass(slots=True)
class PrefixStripper:
    """Takes every occurrence of a packet prefix out of a stream."""

    prefix: bytes
    _held: bytes = b""  # the end of what came, as far as it may be the beginning of a prefix

    def receive(self, data: bytes) -> bytes:
        """The bytes without prefixes; a possible beginning of one is held until more comes."""
        data = (self._held + data).replace(self.prefix, b"")
        length = next((n for n in range(len(self.prefix) - 1, 0, -1) if data.endswith(self.prefix[:n])), 0)
        self._held = data[len(data) - length :] if length else b""
        return data[: len(data) - length] if length else data

    def release(self) -> bytes:
        """Nothing came for a while: what is held was no prefix."""
        held, self._held = self._held, b""
        return held

    @property
    def holds(self) -> bool:
        """Whether anything is held."""
        return bool(self._held)


@dataclass(slots=True)
class FrameCutter:
    """Cuts a stream into whole frames and the bytes between them."""

    _reader: FrameReader = field(default_factory=FrameReader)
    _bytes: bytes = b""  # of the stream, from ``_start`` on
    _start: int = 0

    def receive(self, data: bytes) -> tuple[list[tuple[int, bytes, bytes]], bytes]:
        """Frames as (message number, payload, whole frame), and the bytes that are none."""
        self._bytes += data
        self._reader.receive_data(data)
        frames, noise, position = [], [], self._start
        while (frame := self._reader.next_frame()) is not None:
            noise.append(self._bytes[position - self._start : frame.offset - self._start])
            whole = self._bytes[frame.offset - self._start : frame.end - self._start]
            frames.append((frame.number, frame.payload, whole))
            position = frame.end
        settled = self._reader.offset - self._reader.pending_bytes
        noise.append(self._bytes[position - self._start : settled - self._start])
        self._bytes, self._start = self._bytes[settled - self._start :], settled
        return frames, b"".join(noise)


class DeviceStream:
    """The stream of one admitted connection; counts what it sees in ``counters``."""

    def __init__(self, admitted: Admitted) -> None:
        self._stations = admitted.stations
        self._chunked = ChunkedDecoder() if admitted.chunked else None
        self._stripper = PrefixStripper(admitted.prefix) if admitted.prefix else None
        device = admitted.stations[0].device
        self._heartbeat = unescape(device.heartbeat) if device.heartbeat else b""
        self._echo = device.echo_heartbeat
        self._owner = {i: s.station for s in reversed(admitted.stations) for i in s.device.rtcm_station_ids}
        self._inertial = {station.device.inertial_message for station in admitted.stations}
        shared = len(admitted.stations) > 1
        self._cutter = FrameCutter() if shared or self._heartbeat else None
        self._shared = shared
        self._noise_tail = b""
        self.counters: Counter[str] = Counter()

    @property
    def holds(self) -> bool:
        """Whether bytes are held back that :meth:`silence` would release."""
        return self._stripper is not None and self._stripper.holds

    def silence(self) -> Received:
        """No bytes came for a moment."""
        return self._deliver(self._stripper.release()) if self._stripper else Received()

    def receive(self, data: bytes) -> Received:
        """Take bytes as the socket gave them."""
        error = ""
        if self._chunked is not None:
            data = self._chunked.receive(data)
            error = self._chunked.error or ("body_ended" if self._chunked.ended else "")
        if self._stripper is not None:
            data = self._stripper.receive(data)
        received = self._deliver(data)
        return Received(received.parts, received.reply, error) if error else received

    def _deliver(self, data: bytes) -> Received:
        if not data:
            return Received()
        if self._cutter is None:
            return Received(((self._stations[0].station, data),))
        frames, noise = self._cutter.receive(data)
        reply = self._count_heartbeats(noise)
        if not self._shared:
            return Received(((self._stations[0].station, data),), reply)
        parts: dict[str, list[bytes]] = {}
        for number, payload, whole in frames:
            parts.setdefault(self._owner_of(number, payload), []).append(whole)
        return Received(tuple((station, b"".join(pieces)) for station, pieces in parts.items()), reply)

    def _owner_of(self, number: int, payload: bytes) -> str:
        """The station of a frame; what carries no id, or one that nobody claims, is the first station's."""
        first = self._stations[0].station
        rtcm_id = rtcm_station_id(number, payload, self._inertial)
        if rtcm_id is None:
            return first
        owner = self._owner.get(rtcm_id)
        if owner is None:
            self.counters["frames_of_unknown_station_id"] += 1
        return owner or first

    def _count_heartbeats(self, noise: bytes) -> bytes:
        """Count heartbeats and noise in bytes between frames; the answer is what to echo."""
        heartbeat = self._heartbeat
        if not heartbeat:
            self.counters["noise_bytes"] += len(noise)
            return b""
        text = self._noise_tail + noise
        n = text.count(heartbeat)
        rest = text[text.rfind(heartbeat) + len(heartbeat) :] if n else text
        self._noise_tail = rest[-(len(heartbeat) - 1) :] if len(heartbeat) > 1 else b""
        self.counters["heartbeats"] += n
        self.counters["noise_bytes"] += len(noise) - n * len(heartbeat)
        return heartbeat * n if self._echo else b""


def rtcm_station_id(number: int, payload: bytes, inertial: set[int]) -> int | None:
    """DF003 of a message, or None where the message has none (RTCM 10403.3, table 3.1-1)."""
    carries = 1001 <= number <= 1013 or number in (1029, 1032, 1033, 1230) or 1071 <= number <= 1137
    if (carries or number in inertial) and len(payload) >= 3:
        return ((payload[1] & 0x0F) << 8) | payload[2]
    return None
