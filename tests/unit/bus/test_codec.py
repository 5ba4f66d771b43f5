"""Records on the bus: what is decoded is what was encoded, and strange bytes are refused, not believed."""

import contextlib
import math
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from plumbline.bus import codec
from plumbline.bus.messages import (
    ArchiveReply,
    CheckpointMessage,
    Numbered,
    StationConfig,
    Tick,
    decode_archive_reply,
    decode_checkpoint,
    decode_chunk,
    decode_configs,
    decode_numbered,
    decode_tick,
    encode_archive_reply,
    encode_chunk,
    encode_configs,
    encode_fields,
    encode_numbered,
)
from plumbline.config import DeviceSettings, StationSettings
from plumbline.errors import ContractError
from plumbline.records import (
    AlertEvent,
    AlertState,
    Chunk,
    Motion,
    Severity,
    Solution,
    StationStatus,
    Status,
    Threshold,
)

RECORDS = [
    Solution("a", 1, 2, Status.NO_CORRECTIONS, "no corrections for Galileo"),
    Solution("a", 1 << 61, 5, Status.PPP_FLOAT, "", 9, np.array([1, np.nan, -0.]), None, np.eye(3), extras={"x": 0.5}),
    Motion("b", 5, 6, 10_000_000, *(np.arange(30.0).reshape(10, 3) * k for k in range(4)), Status.PPP_FIXED, 3),
    AlertEvent("id", "a", "t", AlertState.ACTIVE, Severity.WARNING, 1, 2, 3, "displacement_east", 0.1, 0.05, "text"),
    StationStatus("a", 7, "silent", "ø", None, None, 0, {"bad_crc": 3}),
    StationStatus("a", 7, "receiving", "", 1 << 60, Status.CONVERGING, 12, {}),
]  # fmt: skip


def same(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    return type(a) is type(b) and (a == b or (isinstance(a, float) and math.isnan(a)))


@pytest.mark.parametrize("record", RECORDS, ids=lambda r: type(r).__name__)
def test_records_survive_bit_for_bit(record: object) -> None:
    back = codec.decode(codec.encode(record))
    assert type(back) is type(record)
    for field in fields(record):  # type: ignore[arg-type]
        assert same(getattr(record, field.name), getattr(back, field.name)), field.name


@given(
    arrays.arrays(st.sampled_from([np.float64, np.int64, np.int16, np.int8, np.bool_]), arrays.array_shapes(max_dims=3))
)
def test_arrays_survive_bit_for_bit(array: np.ndarray) -> None:
    assert same(codec.decode(codec.encode([array]))[0], array)
    assert same(codec.decode(codec.encode([array[::-1]]))[0], np.ascontiguousarray(array[::-1]))


def test_unknown_fields_are_ignored_and_absent_ones_take_their_defaults() -> None:
    plain = {
        "": "Solution",
        "station": "a",
        "t_gps_ns": 1,
        "t_receive_ns": 2,
        "status": "rtk_fixed",
        "reason": "",
        "new": 1,
    }
    assert codec.decode(codec.encode(plain)) == Solution("a", 1, 2, Status.RTK_FIXED, "")


@given(st.binary(max_size=200))
def test_strange_bytes_are_refused(data: bytes) -> None:
    for decode in (codec.decode, decode_tick, decode_checkpoint, decode_numbered, decode_configs):
        with contextlib.suppress(ValueError):
            decode(data)
    for whole in map(codec.encode, RECORDS):
        with pytest.raises(ValueError):
            codec.decode(whole[:-1])


def test_what_does_not_belong_on_the_bus_is_a_broken_contract() -> None:
    with pytest.raises(ContractError):
        codec.encode({"x": object()})
    with pytest.raises(ContractError):
        codec.encode([np.array(["text"])])


def test_messages_survive() -> None:
    chunk = Chunk("archive12345", "a", 5, 1 << 60, b"\xd3\x00")
    assert decode_chunk("a", encode_chunk(chunk)) == chunk
    reply = ArchiveReply(99, 7, 1 << 60, (chunk, Chunk("archive12345", "a", 7, (1 << 60) + 1, b"")))
    assert decode_archive_reply("archive12345", "a", encode_archive_reply(reply)) == reply
    with pytest.raises(ValueError):
        decode_archive_reply("x", "a", encode_archive_reply(reply)[:-30])
    tick, numbered = Tick("archive12345", 3, 1 << 60), Numbered("0123456789abcdef", 17, b"body")
    assert decode_tick(encode_fields(tick)) == tick
    assert decode_numbered(encode_numbered(numbered)) == numbered
    checkpoint = CheckpointMessage("a", 1, b"\x00state", {"archive12345": 42})
    assert decode_checkpoint(encode_fields(checkpoint)) == checkpoint
    threshold = Threshold("t", "a", "displacement_horizontal", 0.05, Severity.WARNING, on_delay_s=2.0)
    settings = StationSettings(station="a", device=DeviceSettings(registrations=("\\x01ab",), token="secret"))
    configs = (StationConfig("a", settings, (threshold,), 1, 2), StationConfig("b", None))
    assert decode_configs(encode_configs(configs)) == configs
