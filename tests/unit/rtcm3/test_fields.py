"""Oracles: hand-made bit strings, and the identity decode → encode → the same bytes on random bits of every table."""

import math
import random

import pytest

from plumbline.errors import ContractError
from plumbline.rtcm3 import TABLE_MODULES, Malformed, Message
from plumbline.rtcm3.bits import BitReader, BitsExhausted, BitWriter
from plumbline.rtcm3.fields import (
    _TABLES,
    Group,
    Table,
    Values,
    decode_table,
    encode_table,
    flag,
    reserved,
    sign_magnitude,
    signed,
    text,
    unsigned,
)

TABLE = Table(
    100,
    "made up",
    (
        unsigned("", "count_of_a", 3),
        signed("", "height_m", 5, 0.5, sentinel=-16),
        sign_magnitude("", "drift", 4, 2.0),
        unsigned("", "channel", 5, offset=-7),
        flag("", "healthy"),
        reserved(2),
        text("", "name"),
        Group("a", "count_of_a", (unsigned("", "b_count", 2), Values("b", "b_count", signed("", "", 3, 0.1)))),
        Values("c", lambda fields: 2 * fields["count_of_a"], unsigned("", "", 4, sentinel=15)),
    ),
)
FIELDS = {
    "height_m": -7.5,
    "drift": -0.0,
    "channel": -7,
    "healthy": True,
    "name": "é",
    "a": ({"b": (0.1, -0.4)}, {"b": ()}),
    "c": (1, None, 3, 4),
}
BITS = "000001100100" + "010" + "10001" + "1000" + "00000" + "1" + "00" + "00000001" + "11101001"
BITS += "10" + "001" + "100" + "00" + "0001" + "1111" + "0011" + "0100"


def _bytes(bits: str) -> bytes:
    return int(bits.ljust(-(-len(bits) // 8) * 8, "0"), 2).to_bytes(-(-len(bits) // 8), "big")


def test_a_table_writes_the_bits_that_it_says() -> None:
    assert encode_table(TABLE, FIELDS) == _bytes(BITS)


def test_a_table_reads_them_back() -> None:
    message = decode_table(TABLE, _bytes(BITS))
    assert isinstance(message, Message)
    assert message["count_of_a"] == 2
    assert math.copysign(1.0, message["drift"]) == -1.0
    assert message["a"] == ({"b_count": 2, "b": (0.1, -0.4)}, {"b_count": 0, "b": ()})
    assert {k: message[k] for k in FIELDS if k != "a"} == {k: v for k, v in FIELDS.items() if k != "a"}


def test_every_shorter_payload_is_malformed() -> None:
    payload = _bytes(BITS)
    assert all(decode_table(TABLE, payload[:n]) == Malformed(100, "too_short") for n in range(2, len(payload)))


def test_not_available_both_ways() -> None:
    for missing in (None, math.nan):
        message = decode_table(TABLE, encode_table(TABLE, {**FIELDS, "height_m": missing}))
        assert isinstance(message, Message)
        assert message["height_m"] is None


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("height_m", 8.0),
        ("height_m", -8.0),
        ("channel", 25),
        ("channel", None),
        ("drift", 16.0),
        ("c", (1,)),
        ("name", "€"),
    ],
)
def test_what_does_not_fit_breaks_the_contract(name: str, value: object) -> None:
    with pytest.raises(ContractError):
        encode_table(TABLE, {**FIELDS, name: value})
    with pytest.raises(ContractError):
        encode_table(TABLE, {k: v for k, v in FIELDS.items() if k != name})


@pytest.mark.parametrize("key", sorted(_TABLES, key=str), ids=str)
def test_every_table_encodes_what_it_decodes(key: tuple[int, int | None]) -> None:
    """Random bits behind the number, cut to the length that decoding and encoding agree on."""
    assert TABLE_MODULES
    table, generator, seen = _TABLES[key], random.Random(str(key)), 0
    for _ in range(60):
        writer = BitWriter()
        writer.unsigned(table.number, 12)
        if table.subtype is not None:
            writer.unsigned(1, 3)
            writer.unsigned(table.subtype, 8)
        payload = writer.to_bytes()
        payload += generator.randbytes(1023 - len(payload))
        message = decode_table(table, payload)
        if isinstance(message, Malformed):
            continue
        seen += 1
        again = encode_table(table, message.fields)
        bits = 8 * len(again) - 7  # the last byte may be padded with zeros
        assert BitReader(again).unsigned(bits) == BitReader(payload).unsigned(bits)
    assert seen


def test_bits_round_trip_and_end() -> None:
    generator = random.Random(3)
    writer, values = BitWriter(), []
    for _ in range(500):
        bits = generator.randrange(1, 65)
        values.append((generator.getrandbits(bits) - (1 << (bits - 1)), bits))
        writer.signed(*values[-1])
    reader = BitReader(writer.to_bytes())
    assert [(reader.signed(bits), bits) for _, bits in values] == values
    with pytest.raises(BitsExhausted):
        reader.unsigned(reader.remaining + 1)
