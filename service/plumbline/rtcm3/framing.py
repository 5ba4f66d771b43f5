"""Frames: 0xD3, six zero bits, a 10-bit length, the payload, CRC-24Q (RTCM 10403.3, section 4).

Bytes that belong to no frame are counted, each once, under the reason why no frame began at it:

* ``noise``: it is not 0xD3,
* ``bad_reserved``: 0xD3, but the six bits after it are not zero,
* ``bad_crc``: a whole frame's worth of bytes follows and the CRC denies it,
* ``truncated``: the stream ended before the frame did.

After each the search goes on at the next byte, so noise or a false preamble never costs a frame. What a false preamble
can cost is time: up to 1028 bytes have to come before its CRC can deny it. :meth:`FrameReader.look_ahead` shortens that
in a stream that has stalled.
"""

from collections import deque
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plumbline.errors import ContractError
from plumbline.rtcm3.crc24q import crc24q, crc24q_of

PREAMBLE: Final = 0xD3
HEADER_BYTES: Final = 3
OVERHEAD_BYTES: Final = 6  # header and CRC
MAX_PAYLOAD_BYTES: Final = 1023
REJECTION_REASONS: Final = ("noise", "bad_reserved", "bad_crc", "truncated")

_NOISE, _BAD_RESERVED, _BAD_CRC, _TRUNCATED = range(4)


class Frame(NamedTuple):
    """A frame whose CRC is right."""

    number: int  # message number; 0 for a payload too short to have one
    payload: bytes
    offset: int  # of its preamble in the stream, counted from the reader's first byte

    @property
    def end(self) -> int:
        """Stream offset of the first byte behind the frame."""
        return self.offset + len(self.payload) + OVERHEAD_BYTES


@njit(cache=True)
def _scan(
    data: NDArray[np.uint8], final: bool, found: NDArray[np.int64], rejected: NDArray[np.int64]
) -> tuple[int, int]:
    """Find all frames of ``data``: their (start, end, number), how many, and the position where more bytes are needed.

    With ``final`` no more bytes come: an incomplete frame is given up and the search goes on behind its preamble.
    """
    size = data.size
    n = 0
    at = 0
    while at < size:
        if data[at] != PREAMBLE:
            rejected[_NOISE] += 1
            at += 1
            continue
        if at + 1 < size and data[at + 1] & 0xFC:
            rejected[_BAD_RESERVED] += 1
            at += 1
            continue
        end = at + OVERHEAD_BYTES
        if at + HEADER_BYTES <= size:
            end += (int(data[at + 1]) << 8) | int(data[at + 2])
        if end > size:
            if not final:
                break
            rejected[_TRUNCATED] += 1
            at += 1
        elif _crc_is_right(data, at, end):
            found[n, 0], found[n, 1] = at, end
            found[n, 2] = (int(data[at + 3]) << 4) | (int(data[at + 4]) >> 4) if end >= at + OVERHEAD_BYTES + 2 else 0
            n += 1
            at = end
        else:
            rejected[_BAD_CRC] += 1
            at += 1
    return n, at


@njit(cache=True)
def _crc_is_right(data: NDArray[np.uint8], start: int, end: int) -> bool:
    sent = (np.uint32(data[end - 3]) << 16) | (np.uint32(data[end - 2]) << 8) | np.uint32(data[end - 1])
    return crc24q_of(data, start, end - 3) == sent


def _frames_in(data: bytes, base: int, final: bool, rejected: NDArray[np.int64]) -> tuple[list[Frame], int]:
    """Frames in ``data``, whose stream offset is ``base``, and the position where more bytes are needed."""
    found = np.empty((len(data) // OVERHEAD_BYTES + 1, 3), dtype=np.int64)
    n, position = _scan(np.frombuffer(data, dtype=np.uint8), final, found, rejected)
    frames = [Frame(number, data[start + 3 : end - 3], base + start) for start, end, number in found[:n].tolist()]
    return frames, position


def message_number(payload: bytes) -> int:
    """DF002: the first 12 bits of a payload; 0 when it is shorter than that."""
    return (payload[0] << 4) | (payload[1] >> 4) if len(payload) >= 2 else 0


def frame(payload: bytes) -> bytes:
    """Put a payload into a frame; raises :class:`ContractError` above 1023 bytes."""
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise ContractError(f"a frame holds at most {MAX_PAYLOAD_BYTES} bytes, not {len(payload)}")
    head = bytes((PREAMBLE, len(payload) >> 8, len(payload) & 0xFF)) + payload
    return head + crc24q(head).to_bytes(3, "big")


@dataclass(frozen=True, slots=True)
class FrameScan:
    """All frames of a finished byte string, and the bytes that were none by reason."""

    frames: tuple[Frame, ...]
    rejected_bytes: dict[str, int]


def scan_frames(data: bytes) -> FrameScan:
    """Find all frames of a whole recording at once."""
    rejected = np.zeros(len(REJECTION_REASONS), dtype=np.int64)
    frames, _ = _frames_in(data, 0, True, rejected)
    return FrameScan(tuple(frames), _counters(rejected.tolist()))


def _counters(rejected: list[int]) -> dict[str, int]:
    return {reason: n for reason, n in zip(REJECTION_REASONS, rejected, strict=True) if n}


class FrameReader:
    """Cuts a stream into frames: ``receive_data`` stores, ``next_frame`` returns a frame or None. It can be pickled.

    Between calls it holds one incomplete frame at most, and the frames not taken yet: the caller takes them all before
    it brings more, or :class:`ContractError` is raised once more than ``max_buffer`` bytes have come meanwhile.
    """

    __slots__ = ("_base", "_max_buffer", "_pending", "_ready", "_ready_bytes", "_rejected")

    def __init__(self, max_buffer: int = 1 << 20, offset: int = 0) -> None:
        self._max_buffer = max_buffer
        self._base = offset  # stream offset of the first pending byte
        self._pending = b""
        self._ready: deque[Frame] = deque()
        self._ready_bytes = 0
        self._rejected = [0] * len(REJECTION_REASONS)

    @property
    def counters(self) -> dict[str, int]:
        """Bytes that were no frame, by reason; reasons that have not occurred are left out."""
        return _counters(self._rejected)

    @property
    def offset(self) -> int:
        """Stream offset behind the last byte received."""
        return self._base + len(self._pending)

    @property
    def pending_bytes(self) -> int:
        """Bytes received that await the rest of their frame."""
        return len(self._pending)

    @property
    def resume_offset(self) -> int:
        """Stream offset from which a fresh reader would find every frame that this one has not returned yet."""
        return self._ready[0].offset if self._ready else self._base

    def receive_data(self, data: bytes) -> None:
        """Take the next bytes of the stream, cut in any way."""
        if self._ready_bytes > self._max_buffer:
            raise ContractError(f"{self._ready_bytes} bytes of frames were not taken")
        self._pending = self._pending + data if self._pending else bytes(data)
        self._cut(final=False)

    def next_frame(self) -> Frame | None:
        """The next complete frame, or None until more bytes come."""
        if not self._ready:
            return None
        found = self._ready.popleft()
        if not self._ready:
            self._ready_bytes = 0
        return found

    def flush(self) -> None:
        """End of the stream: give up the incomplete frame and look for frames in what is left of it."""
        self._cut(final=True)

    def look_ahead(self) -> None:
        """In a stalled stream: give up the incomplete frame if, and only if, a complete one stands behind its preamble.

        The caller decides by receive time, so that a replay does the same.
        """
        if len(self._pending) <= OVERHEAD_BYTES:
            return
        ahead, _ = _frames_in(self._pending[1:], 1, True, np.zeros(len(REJECTION_REASONS), dtype=np.int64))
        if ahead:
            self._cut_from(ahead[0].offset)

    def _cut_from(self, first: int) -> None:
        """Reject the pending bytes before ``first``, then go on as usual."""
        skipped, rest = self._pending[:first], self._pending[first:]
        self._pending = skipped
        self._cut(final=True)
        self._pending = rest
        self._cut(final=False)

    def _cut(self, final: bool) -> None:
        rejected = np.zeros(len(REJECTION_REASONS), dtype=np.int64)
        frames, position = _frames_in(self._pending, self._base, final, rejected)
        if frames:
            self._ready.extend(frames)
            self._ready_bytes += position
        if rejected.any():
            self._rejected = [a + b for a, b in zip(self._rejected, rejected.tolist(), strict=True)]
        self._pending = self._pending[position:]
        self._base += position
