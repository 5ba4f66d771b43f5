"""Oracles: the standard's own example frame, a bitwise CRC, an identity: however a stream is cut, the same frames."""

import pickle
import random

import pytest

from plumbline.errors import ContractError
from plumbline.rtcm3 import Frame, FrameReader, Message, crc24q, decode, frame, scan_frames

# RTCM 10403.3, section 4.2: message 1005 of station 2003.
EXAMPLE = bytes.fromhex("D300133ED7D30202980EDEEF34B4BD62AC0941986F33360B98")


def _bitwise_crc(data: bytes) -> int:
    crc = 0
    for byte in data:
        crc ^= byte << 16
        for _ in range(8):
            crc = crc << 1 ^ (0x1864CFB if crc & 0x800000 else 0)
    return crc


def _payload(generator: random.Random, size: int) -> bytes:
    return generator.randbytes(size)


def _all(reader: FrameReader) -> list[Frame]:
    frames = []
    while (found := reader.next_frame()) is not None:
        frames.append(found)
    return frames


def _fed(stream: bytes, step: int) -> tuple[list[Frame], dict[str, int]]:
    reader, frames = FrameReader(), []
    for at in range(0, len(stream), step):
        reader.receive_data(stream[at : at + step])
        frames += _all(reader)
    reader.flush()
    return frames + _all(reader), reader.counters


def test_the_standards_example() -> None:
    (found,) = scan_frames(EXAMPLE).frames
    message = decode(found.payload)
    assert isinstance(message, Message)
    assert (found.number, message["station"]) == (1005, 2003)
    position = (message["x_ecef_m"], message["y_ecef_m"], message["z_ecef_m"])
    assert position == pytest.approx((1114104.5999, -4850729.7108, 3975521.4643), abs=1e-6)
    assert frame(found.payload) == EXAMPLE


@pytest.mark.parametrize("size", [*range(20), 255, 1023])
def test_crc_agrees_with_the_bitwise_definition(size: int) -> None:
    data = _payload(random.Random(size), size)
    assert crc24q(data) == _bitwise_crc(data)


def _stream_with_garbage() -> tuple[bytes, list[bytes]]:
    generator = random.Random(7)
    payloads = [_payload(generator, generator.choice((0, 1, 2, 19, 300, 1023))) for _ in range(60)]
    stream = b""
    for payload in payloads:
        noise = bytes(generator.choice((0xD3, 0x00, 0x02, 0xFF, 0x41)) for _ in range(generator.randrange(8)))
        stream += noise + frame(payload)
    return stream + b"\xd3\x03", payloads


@pytest.mark.parametrize("step", [1, 2, 3, 7, 64, 1448, 10**6])
def test_no_cut_and_no_noise_costs_a_frame(step: int) -> None:
    stream, payloads = _stream_with_garbage()
    frames, counters = _fed(stream, step)
    assert [f.payload for f in frames] == payloads
    assert sum(f.end - f.offset for f in frames) + sum(counters.values()) == len(stream)
    assert all(stream[f.offset : f.end] == frame(f.payload) for f in frames)
    whole = scan_frames(stream)
    assert (tuple(frames), counters) == (whole.frames, whole.rejected_bytes)


def test_rejected_bytes_by_reason() -> None:
    broken = bytearray(EXAMPLE)
    broken[10] ^= 1
    stream = b"\x00\x01" + b"\xd3\xfc" + bytes(broken) + EXAMPLE + b"\xd3\x00"
    frames, counters = _fed(stream, 5)
    assert len(frames) == 1
    noise = 2 + 1 + len(broken) - 2 + 1
    # the broken frame has a second 0xD3 inside, whose length leads beyond the end
    assert counters == {"noise": noise, "bad_reserved": 1, "bad_crc": 1, "truncated": 2}


def test_a_false_preamble_delays_a_frame_and_looking_ahead_does_not() -> None:
    reader = FrameReader()
    reader.receive_data(b"\xd3\x03\xff" + EXAMPLE)  # as if 1023 bytes were to come
    assert reader.next_frame() is None
    copy = pickle.loads(pickle.dumps(reader))
    copy.look_ahead()
    assert [f.offset for f in _all(copy)] == [3]
    for _ in range(50):
        reader.receive_data(EXAMPLE)
    assert [f.offset for f in _all(reader)] == [3 + 25 * i for i in range(51)]
    assert reader.counters == {"bad_crc": 1, "noise": 2}


def test_looking_ahead_leaves_a_frame_under_way_alone() -> None:
    payload = bytes(300)
    whole = frame(payload)
    reader = FrameReader()
    reader.receive_data(whole[:200])
    reader.look_ahead()
    reader.receive_data(whole[200:])
    assert [f.payload for f in _all(reader)] == [payload]
    assert reader.counters == {}


def test_a_restored_reader_carries_on_and_a_fresh_one_resumes() -> None:
    stream, payloads = _stream_with_garbage()
    cut = len(stream) // 2
    reader = FrameReader()
    reader.receive_data(stream[:cut])
    before = _all(reader)
    restored = pickle.loads(pickle.dumps(reader))
    resumed = FrameReader(offset=reader.resume_offset)
    restored.receive_data(stream[cut:])
    resumed.receive_data(stream[reader.resume_offset :])
    after = _all(restored)
    assert after == _all(resumed)
    assert [f.payload for f in before + after] == payloads


def test_memory_is_bounded() -> None:
    reader = FrameReader(max_buffer=10_000)
    for _ in range(100):
        reader.receive_data(b"\xd3\x03\xff" + bytes(997))
        assert reader.pending_bytes <= 1029
    reader.receive_data(10 * frame(bytes(1001)))
    with pytest.raises(ContractError):
        reader.receive_data(b"")


def test_a_payload_too_long_breaks_the_contract() -> None:
    with pytest.raises(ContractError):
        frame(bytes(1024))
