"""Fuzzing of the frame reader and of every decoder: no exception, no hang, no growth; what decodes also re-encodes.

In CI a few seconds; ``PLUMBLINE_FUZZ_SECONDS=600 pytest tests/fuzz`` goes on for ten minutes a test.
"""

import os
import random
import time
import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st

from plumbline.errors import ContractError
from plumbline.rtcm3 import FrameReader, Malformed, Message, Observations, Unknown, decode, encode, frame, scan_frames
from plumbline.rtcm3.fields import _TABLES
from plumbline.rtcm3.inspection import inspect_bytes
from plumbline.rtcm3.legacy import LEGACY_TABLES
from plumbline.rtcm3.msm_layout import MSM_NUMBERS

SECONDS = float(os.environ.get("PLUMBLINE_FUZZ_SECONDS", "0"))
LONGEST_S = 1.0  # a decoder works on at most 1023 bytes; what takes this long hangs

KEYS = sorted(_TABLES, key=str) + [(number, None) for number in (*LEGACY_TABLES, *MSM_NUMBERS, 4001, 4075, 1)]


def _payload(key: tuple[int, int | None], seed: int, size: int, ones: int, sparse_masks: bool) -> bytes:
    """A payload of a type: ``size`` random bytes, of whose bits about ``ones`` eighths are set.

    An MSM of random masks has too many cells nearly always: ``sparse_masks`` leaves few bits of them.
    """
    generator = random.Random(seed)
    bits = generator.getrandbits(8 * 1023)
    for _ in range(abs(ones - 4)):
        bits = bits & generator.getrandbits(8 * 1023) if ones < 4 else bits | generator.getrandbits(8 * 1023)
    number, subtype = key
    bits = _put(bits, 0, 12, number)
    if subtype is not None:
        bits = _put(bits, 15, 8, subtype)
    if number in MSM_NUMBERS and sparse_masks:
        bits = _put(bits, 24, 30, generator.randrange(86_400_000))
        bits = _put(bits, 73, 64, sum(1 << i for i in generator.sample(range(64), generator.randrange(9))))
        bits = _put(bits, 137, 32, sum(1 << i for i in generator.sample(range(32), generator.randrange(8))))
    return bits.to_bytes(1023, "big")[:size]


def _put(bits: int, at: int, width: int, value: int) -> int:
    shift = 8 * 1023 - at - width
    return bits & ~(((1 << width) - 1) << shift) | value << shift


numbered = st.builds(
    _payload,
    st.sampled_from(KEYS),
    st.integers(0, 2**64),
    st.one_of(st.integers(0, 60), st.integers(0, 1023), st.just(1023)),
    st.integers(1, 7),
    st.booleans(),
)
chunks = st.lists(
    st.one_of(
        st.binary(max_size=60),
        numbered.map(frame),
        st.builds(lambda payload, at: _flip(frame(payload), at), numbered, st.integers(0, 10_000)),
        st.sampled_from([b"\xd3", b"\xd3\x00", b"\xd3\x03\xff", b"\xd3\x00\x00", b"\r\nheartbeat\r\n"]),
    ),
    max_size=8,
)


def _flip(data: bytes, bit: int) -> bytes:
    at, changed = bit % (8 * len(data)), bytearray(data)
    changed[at >> 3] ^= 1 << (at & 7)
    return bytes(changed)


def _for_as_long_as_asked(run: Callable[[], None]) -> None:
    """Once, and then with ever new seeds until the time is up."""
    end, turn = time.monotonic() + SECONDS, 0
    while turn == 0 or time.monotonic() < end:
        seed(turn)(run)()
        turn += 1


def _fuzz(examples: int) -> settings:
    return settings(max_examples=examples, deadline=None, database=None, suppress_health_check=list(HealthCheck))


@pytest.mark.timeout(SECONDS + 300)
def test_decoders_never_raise_and_what_decodes_re_encodes() -> None:
    @_fuzz(3000)
    @given(st.one_of(numbered, numbered, st.binary(max_size=40)))
    def run(payload: bytes) -> None:
        start = time.perf_counter()
        message = decode(payload)
        assert time.perf_counter() - start < LONGEST_S
        if isinstance(message, Malformed | Unknown):
            return
        try:
            again = encode(message)
        except ContractError:  # a legacy satellite without a pseudorange, say: no place in the format
            assert isinstance(message, Observations)
            return
        second = decode(again)
        assert type(second) is type(message)
        if isinstance(message, Message):
            assert second == message or encode(second) == again
        elif isinstance(message, Observations) and isinstance(second, Observations):
            _assert_no_value_changed(message, second)

    decode(bytes(30))
    _for_as_long_as_asked(run)


def _assert_no_value_changed(first: Observations, second: Observations) -> None:
    """Values survive or, where a satellite's lie too far apart for one message, are missing: never different."""
    kept = np.isin(
        first.satellite.astype(np.int64) << 16 | first.signal, second.satellite.astype(np.int64) << 16 | second.signal
    )
    assert kept.sum() == second.n_rows
    for a, b in ((first.pseudorange_m, second.pseudorange_m), (first.cn0_db_hz, second.cn0_db_hz)):
        known = np.isfinite(b)
        np.testing.assert_allclose(a[kept][known], b[known], rtol=0, atol=0.0101)


@pytest.mark.timeout(SECONDS + 300)
def test_however_a_stream_is_cut_the_frames_are_the_same() -> None:
    @_fuzz(500)
    @given(chunks, st.integers(0, 2**32))
    def run(parts: list[bytes], seed: int) -> None:
        stream = b"".join(parts)
        whole = scan_frames(stream)
        reader, generator, frames, at = FrameReader(), random.Random(seed), [], 0
        while at < len(stream):
            step = generator.choice((1, 2, 5, 50, 500))
            reader.receive_data(stream[at : at + step])
            assert reader.pending_bytes <= 1028
            at += step
            while (found := reader.next_frame()) is not None:
                frames.append(found)
        reader.flush()
        while (found := reader.next_frame()) is not None:
            frames.append(found)
        assert (tuple(frames), reader.counters) == (whole.frames, whole.rejected_bytes)
        assert sum(f.end - f.offset for f in frames) + sum(reader.counters.values()) == len(stream)
        inspect_bytes(stream, "fuzz").to_text()

    _for_as_long_as_asked(run)


@pytest.mark.timeout(SECONDS + 300)
def test_garbage_around_frames_costs_none() -> None:
    noise = st.binary(max_size=30).map(lambda data: data.replace(b"\xd3", b""))

    @_fuzz(500)
    @given(st.lists(st.tuples(noise, numbered), max_size=6), noise)
    def run(pieces: list[tuple[bytes, bytes]], tail: bytes) -> None:
        stream = b"".join(garbage + frame(payload) for garbage, payload in pieces) + tail
        scan = scan_frames(stream)
        assert [f.payload for f in scan.frames] == [payload for _, payload in pieces]
        assert scan.rejected_bytes.get("noise", 0) == len(tail) + sum(len(garbage) for garbage, _ in pieces)

    _for_as_long_as_asked(run)


def test_a_reader_fed_garbage_does_not_grow() -> None:
    generator = random.Random(11)
    reader = FrameReader()

    def feed(rounds: int) -> None:
        for _ in range(rounds):
            reader.receive_data(generator.randbytes(1400) + b"\xd3\x03\xff")
            while (found := reader.next_frame()) is not None:
                decode(found.payload)

    feed(200)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    feed(2000)
    growth = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert growth < 20_000
