"""A recording as a DTU would have sent it: pieces of bytes, each with the time at which it is due.

The times are those that the frames themselves carry: observations, corrections and inertial samples. They know no week,
which a pace does not need. What carries no time (ephemerides, antenna descriptions, noise) is due with what stands
before it.
"""

import heapq
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from plumbline.constants import BDT_BEHIND_GPST_S
from plumbline.gps_time import DAY_NS, NS_PER_MS, NS_PER_S, WEEK_NS, nearest_ns
from plumbline.rtcm3.bits import BitReader, BitsExhausted
from plumbline.rtcm3.framing import scan_frames
from plumbline.signals import System

_START_NS: Final = 10 * WEEK_NS  # any week: only differences count
_FRAME_OVERHEAD: Final = 6
_JUMP_NS: Final = 60 * NS_PER_S  # a longer step is believed once it has been repeated
_REPEATS: Final = 3
_GPS_LEGACY, _GLONASS_LEGACY = range(1001, 1005), range(1009, 1013)
_MSM = range(1071, 1138)
_BIASES: Final = (1059, 1065, 1242, 1248, 1254, 1260, *range(1265, 1271))  # some services never renew their time
_SSR: Final = tuple(n for n in (*range(1057, 1069), *range(1240, 1264)) if n not in _BIASES)
_SSR_GLONASS: Final = (1063, 1064, 1066, 1067, 1068)
_IGS_SSR: Final = 4076


@dataclass(frozen=True, slots=True)
class Piece:
    """Bytes of one stream and the time, ns on the recording's own scale, at which they are due."""

    t_ns: int
    stream: str
    data: bytes


def read_recording(path: Path, stream: str, inertial_message: int = 4001, t_near_ns: int | None = None) -> list[Piece]:
    """Pieces of a recording (plain or gzip), in file order and never going back in time; noise goes with its frame.

    ``t_near_ns`` puts the first time into the right week when several recordings are merged.
    """
    data = path.read_bytes()
    if data[:2] == b"\x1f\x8b":
        import gzip

        data = gzip.decompress(data)
    frames = scan_frames(data).frames
    clock = _Clock(t_near_ns)
    glonass_too = not any(_kind_of_time(frame.number, inertial_message) == "week" for frame in frames)
    due, pieces, start = list[int | None](), list[tuple[int, int]](), 0
    for frame in frames:
        end = frame.offset + len(frame.payload) + _FRAME_OVERHEAD
        pieces.append((start, end))
        due.append(clock.advance(time_of(frame.number, frame.payload, inertial_message, glonass_too)))
        start = end
    if start < len(data):
        pieces.append((start, len(data)))
        due.append(clock.now_ns)
    first = next((t for t in due if t is not None), _START_NS if t_near_ns is None else t_near_ns)
    return [Piece(first if t is None else t, stream, data[a:b]) for t, (a, b) in zip(due, pieces, strict=True)]


def merge(recordings: Iterable[list[Piece]]) -> list[Piece]:
    """All pieces in time order; at equal times in the order in which the recordings are given."""
    return list(heapq.merge(*recordings, key=lambda piece: piece.t_ns))


class _Clock:
    """The recording's time: never back, and far ahead only when several frames agree."""

    def __init__(self, t_near_ns: int | None) -> None:
        self.now_ns: int | None = None
        self._near_ns = _START_NS if t_near_ns is None else t_near_ns
        self._ahead: list[int] = []

    def advance(self, time: tuple[int, int] | None) -> int | None:
        """Take a frame's (remainder, modulus), ns, if it has one; returns the time at which the frame is due."""
        if time is None:
            return self.now_ns
        remainder_ns, modulus_ns = time
        t_ns = nearest_ns(remainder_ns, modulus_ns, self._near_ns if self.now_ns is None else self.now_ns)
        if self.now_ns is None or 0 <= t_ns - self.now_ns <= _JUMP_NS:
            self.now_ns, self._ahead = t_ns, []
        elif t_ns > self.now_ns:
            self._ahead = [t for t in self._ahead if abs(t - t_ns) <= _JUMP_NS] + [t_ns]
            if len(self._ahead) >= _REPEATS:
                self.now_ns, self._ahead = t_ns, []
        return self.now_ns


def _kind_of_time(number: int, inertial_message: int) -> str:
    if (
        number in _GLONASS_LEGACY
        or number in _SSR_GLONASS
        or (number in _MSM and _msm_system(number) is System.GLONASS)
    ):
        return "day"
    timed = number in _GPS_LEGACY or number in _MSM or number in _SSR or number in (_IGS_SSR, inertial_message)
    return "week" if timed else ""


def _msm_system(number: int) -> System | None:
    system = (number - 1071) // 10
    return System(system) if 1 <= (number - 1070) % 10 <= 7 else None


def time_of(
    number: int, payload: bytes, inertial_message: int = 4001, glonass_too: bool = False
) -> tuple[int, int] | None:
    """The time that a message carries as (remainder, modulus), ns of GPS time, or None.

    GLONASS's day is in UTC: it serves a recording that has nothing else, since only differences count.
    """
    kind = _kind_of_time(number, inertial_message)
    try:
        if kind == "day":
            return _glonass_time(number, payload) if glonass_too else None
        return _week_time(number, payload, inertial_message) if kind == "week" else None
    except BitsExhausted:
        return None


def _glonass_time(number: int, payload: bytes) -> tuple[int, int]:
    if number in _SSR_GLONASS:
        return BitReader(payload, 12).unsigned(17) * NS_PER_S, DAY_NS
    at = 27 if number in _MSM else 24  # behind the day of the week
    return BitReader(payload, at).unsigned(27) * NS_PER_MS, DAY_NS


def _week_time(number: int, payload: bytes, inertial_message: int) -> tuple[int, int] | None:
    if number == inertial_message:
        return BitReader(payload, 32).unsigned(30) * NS_PER_MS, WEEK_NS
    if number == _IGS_SSR:
        return BitReader(payload, 23).unsigned(20) * NS_PER_S, WEEK_NS
    if number in _SSR:
        return BitReader(payload, 12).unsigned(20) * NS_PER_S, WEEK_NS
    t_ns = BitReader(payload, 24).unsigned(30) * NS_PER_MS
    if number in _MSM:
        system = _msm_system(number)
        if system is None or t_ns >= WEEK_NS:
            return None
        t_ns += BDT_BEHIND_GPST_S * NS_PER_S if system is System.BEIDOU else 0
    return t_ns % WEEK_NS, WEEK_NS
