"""Ephemeris and SSR tables. Oracles: the standards' message lengths, and the identity bits → fields → bits."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plumbline.rtcm3 import ephemeris, igs_ssr, ssr
from plumbline.rtcm3.bits import BitWriter
from plumbline.rtcm3.fields import Group, Malformed, Message, Row, Table, Values, decode_table, encode_table, table_of
from plumbline.signals import System

TABLES = [
    *(ephemeris.GPS, ephemeris.GLONASS, ephemeris.NAVIC, ephemeris.BEIDOU, ephemeris.QZSS),
    *(ephemeris.GALILEO_FNAV, ephemeris.GALILEO_INAV),
    *(table_of(number) for number in sorted(ssr.MESSAGES)),
    ssr.VTEC,
    *(table_of(igs_ssr.NUMBER, subtype) for subtype in sorted(igs_ssr.SUBTYPES)),
    igs_ssr.VTEC,
]


def _name(table):
    return f"{table.number}" if table.subtype is None else f"{table.number}-{table.subtype}"


def _write(rows, writer, rng, scope, most):
    """Append random bits for rows; counts are kept small enough for a frame. Returns nothing."""
    counts = {row.count for row in rows if isinstance(row, Group) and isinstance(row.count, str)}
    for row in rows:
        if isinstance(row, Row):
            value = rng.getrandbits(row.bits)
            if row.name in counts:
                value = min(value, most)
            if row.name == "subtype":
                value = scope["subtype"]
            scope[row.name] = value + row.offset
            writer.unsigned(value, row.bits)
        elif isinstance(row, Group):
            for _ in range(scope[row.count]):
                _write(row.rows, writer, rng, dict(scope), 3)
        elif isinstance(row, Values):
            for _ in range(row.count(scope)):
                writer.unsigned(rng.getrandbits(row.row.bits), row.row.bits)


def random_payload(table: Table, rng: random.Random) -> bytes:
    writer = BitWriter()
    writer.unsigned(table.number, 12)
    _write(table.rows, writer, rng, {"subtype": table.subtype}, 12)
    return writer.to_bytes()


@pytest.mark.parametrize(
    ("number", "bits"),
    # RTCM 10403.3, tables 3.5-21 (1019), 22 (1020), and the ephemeris tables of the other systems: total bits
    [(1019, 488), (1020, 360), (1041, 482), (1042, 511), (1044, 485), (1045, 496), (1046, 504)],
)
def test_ephemerides_have_the_standards_lengths(number, bits):
    assert 12 + sum(row.bits for row in table_of(number).rows) == bits


@pytest.mark.parametrize(
    ("number", "header", "satellite"),
    # RTCM 10403.3, tables 3.5-45 … 3.5-56 and the amendments for the other systems: bits of header and satellite
    [
        *((1057, 68, 135), (1058, 67, 76), (1059, 67, 11), (1060, 68, 205), (1061, 67, 12), (1062, 67, 28)),
        *((1063, 65, 134), (1064, 64, 75), (1065, 64, 10), (1066, 65, 204), (1067, 64, 11), (1068, 64, 27)),
        *((1240, 68, 137), (1243, 68, 207), (1246, 68, 133), (1247, 67, 74), (1252, 68, 160), (1258, 68, 145)),
        *((1265, 69, 28), (1266, 66, 27), (1268, 69, 26), (1270, 69, 28)),
    ],
)
def test_ssr_messages_have_the_standards_lengths(number, header, satellite):
    *rows, group = table_of(number).rows
    assert 12 + sum(row.bits for row in rows) == header
    assert sum(row.bits for row in group.rows if isinstance(row, Row)) == satellite


@pytest.mark.parametrize("subtype", [21, 42, 63, 84, 105, 126, 67, 127])
def test_igs_headers_have_the_standards_lengths(subtype):
    """IGS SSR 1.00, table 9: 78 bits, one more with the CRS indicator, two more with the consistency indicators."""
    *rows, _ = table_of(igs_ssr.NUMBER, subtype).rows
    place = subtype % 20
    assert 12 + sum(row.bits for row in rows) == 78 + {1: 1, 3: 1, 6: 2}.get(place, 0)


@pytest.mark.parametrize("table", TABLES, ids=_name)
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_any_bits_survive_decoding_and_encoding(table, seed):
    payload = random_payload(table, random.Random(seed))
    message = decode_table(table, payload)
    assert isinstance(message, Message)
    assert encode_table(table, message.fields) == payload


@pytest.mark.parametrize("table", TABLES, ids=_name)
def test_a_cut_message_is_malformed(table):
    payload = random_payload(table, random.Random(table.number))
    assert isinstance(decode_table(table, payload[: len(payload) // 2 - 1]), Malformed | Message)
    assert decode_table(table, payload[:3]) == Malformed(table.number, "too_short")


@pytest.mark.parametrize("number", [1258, 1261])
def test_beidous_draft_layout_is_told_by_the_length(number):
    table = table_of(number)
    for seed in range(20):
        payload = random_payload(table.alternative, random.Random(seed))
        message = decode_table(table, payload)
        if message["satellites"]:
            assert ssr.beidou_orbit_is_draft(message) is True
        assert encode_table(table, message.fields) == payload
        standard = decode_table(table, random_payload(table, random.Random(seed)))
        assert ssr.beidou_orbit_is_draft(standard) is (False if standard["satellites"] else None)


def test_vtec_counts_of_coefficients():
    """IGS SSR 1.00, 4.5.1: (N+1)(N+2)/2 − (N−M)(N−M+1)/2 cosines, N + 1 sines fewer; counted out here."""
    for degree in range(1, 17):
        for order in range(1, degree + 1):
            counted = sum(1 for n in range(degree + 1) for m in range(order + 1) if m <= n)
            fields = {"degree": degree, "order": order}
            assert ssr.n_cosine(fields) == counted
            assert ssr.n_sine(fields) == counted - (degree + 1)


def test_every_system_has_its_messages():
    numbers = {1057: System.GPS, 1063: System.GLONASS, 1240: System.GALILEO}
    numbers |= {1246: System.QZSS, 1252: System.SBAS, 1258: System.BEIDOU}
    for base, system in numbers.items():
        for place, kind in enumerate(list(ssr.SsrKind)[:6]):
            assert ssr.MESSAGES[base + place] == (system, kind)
    assert sorted(igs_ssr.SUBTYPES) == [base + k for base in range(20, 140, 20) for k in range(1, 8)]
