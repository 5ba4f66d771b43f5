"""SSR messages ↔ records. Oracles: values packed by hand, round trips through the wire, the standards' formulas."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plumbline.epochs.encode_ssr import combined_messages, messages_from_correction
from plumbline.epochs.translate_ephemeris import Rejected
from plumbline.epochs.translate_ssr import SsrTranslator, ura_m
from plumbline.errors import ContractError
from plumbline.gps_time import DAY_NS, NS_PER_S, gps_ns
from plumbline.records import SsrClock, SsrCodeBias, SsrHeader, SsrOrbit, SsrPhaseBias, SsrUra, SsrVtec
from plumbline.rtcm3 import decode, encode
from plumbline.rtcm3.fields import Message
from plumbline.signals import System, satellite_of_name, signal_id

T0 = gps_ns(2400, 100_800.0)
HEADER = SsrHeader(T0, T0 + NS_PER_S, 5.0, 3, 260, 2)
NAMES = {System.GPS: "G05 G17", System.GLONASS: "R02 R24", System.GALILEO: "E01 E36", System.QZSS: "J01 J09",
         System.SBAS: "S20 S58", System.BEIDOU: "C01 C59"}  # fmt: skip


def ids(system):
    return np.array([satellite_of_name(name) for name in NAMES[system].split()], dtype=np.int16)


def orbit(system, *, igs=False, rng=None):
    rng = rng or np.random.default_rng(1)
    rule = ("toe_720s" if igs else "toe_8s") if system is System.BEIDOU else "issue"
    rac = np.round(rng.uniform(-100, 100, (2, 3)) / 4e-4) * 4e-4
    rates = np.round(rng.uniform(-1, 1, (2, 3)) / 4e-6) * 4e-6
    return SsrOrbit(HEADER, ids(system), np.array([17, 201], dtype=np.int64), rac, rates, rule)


def clock(system, *, high_rate=False):
    polynomial = np.array([[1.2345, -1e-3, 2e-8], [-200.0001, 0.999999, -1.3]])
    if high_rate:
        polynomial[:, 1:] = 0.0
    return SsrClock(HEADER, ids(system), polynomial, high_rate)


def code_bias(system):
    signals = [signal_id(system, "2I" if system is System.BEIDOU else "1C"),
               signal_id(system, {System.BEIDOU: "6I", System.GLONASS: "2P"}.get(system, "5Q"))]  # fmt: skip
    return SsrCodeBias(HEADER, np.repeat(ids(system), 2), np.array(signals * 2, dtype=np.int16),
                       np.array([1.23, -0.5, 0.0, 81.91]))  # fmt: skip


def phase_bias(system):
    code = code_bias(system)
    yaw = np.repeat(np.array([3, 200]) * np.pi / 256, 2)
    return SsrPhaseBias(HEADER, code.satellite, code.signal, code.bias_m / 2, np.array([True, False, True, True]),
                        np.array([0, 1, 2, 3]), np.array([0, 5, 15, 1]), yaw, np.repeat([0.0, -np.pi / 8192], 2),
                        True, False)  # fmt: skip


def same(left, right):
    """Equal but for the receive time and what the fields quantise away (a hundredth of a step)."""
    assert type(left) is type(right)
    for field in dataclasses.fields(left):
        a, b = getattr(left, field.name), getattr(right, field.name)
        if isinstance(a, np.ndarray):
            np.testing.assert_allclose(a, b, rtol=0, atol=2e-10)
        elif field.name == "header":
            assert dataclasses.replace(a, t_receive_ns=0) == dataclasses.replace(b, t_receive_ns=0)
        else:
            assert a == b


def through_the_wire(messages, near_ns=T0, translator=None):
    translator = translator or SsrTranslator(beidou_is_draft=False)
    records = []
    for message in messages:
        got = translator.translate(decode(encode(message)), near_ns)
        assert not isinstance(got, Rejected), got
        records += got
    return records


@pytest.mark.parametrize("igs", [False, True], ids=["rtcm", "igs"])
@pytest.mark.parametrize("system", list(NAMES), ids=lambda s: s.name)
def test_records_survive_the_wire(system, igs):
    of_orbit = orbit(system, igs=igs)
    corrections = [of_orbit, clock(system), clock(system, high_rate=True), code_bias(system), phase_bias(system)]
    for correction in corrections:
        (back,) = through_the_wire(messages_from_correction(correction, igs=igs))
        same(back, correction)
    combined = through_the_wire(combined_messages(of_orbit, clock(system), igs=igs))
    same(combined[0], of_orbit)
    same(combined[1], clock(system))


def test_a_record_of_many_systems_gives_a_message_of_each():
    both = SsrUra(HEADER, np.concatenate([ids(System.GPS), ids(System.GALILEO)]), np.array([0.25, 2.0, 0.5, np.nan]))
    messages = messages_from_correction(both)
    assert [m.number for m in messages] == [1061, 1244]
    back = through_the_wire(messages)
    assert np.all(back[0].ura_m >= both.ura_m[:2])
    assert np.isnan(back[1].ura_m[1])


def test_long_records_are_split_and_say_so():
    satellites = np.arange(63, dtype=np.int16)
    clocks = SsrClock(HEADER, satellites, np.zeros((63, 3)))
    orbits = SsrOrbit(HEADER, satellites, np.zeros(63, np.int64), np.zeros((63, 3)), np.zeros((63, 3)))
    for messages, parts in (
        (messages_from_correction(clocks), 1),
        (messages_from_correction(orbits), 2),
        (combined_messages(orbits, clocks), 2),
    ):
        assert all(len(encode(message)) <= 1023 for message in messages)
        assert sum(len(message["satellites"]) for message in messages) == 63
        assert [message["more_follows"] for message in messages] == [True] * (parts - 1) + [False]


@pytest.mark.parametrize(("code", "metres"), [(1, 0.00025), (8, 0.002), (15, 0.00725), (61, 4.91975), (62, 5.4665)])
def test_user_range_accuracy(code, metres):
    """DF389: 3^class (1 + value/4) − 1 mm; under 1 mm is given as 1 mm; the last code is 'more than 5466.5 mm'."""
    assert ura_m(code) == pytest.approx(max(metres, 0.001), abs=1e-9)
    assert ura_m(63) > 5.4665
    assert np.isnan(ura_m(0))


def test_beidous_dialects():
    """The standard counts from C01 and in BDT; the draft from C01 = 0 and in GPS time, told by its longer issue."""
    (standard,) = messages_from_correction(orbit(System.BEIDOU))
    assert standard["epoch_s"] == 100_800 - 14
    rows = tuple({k: v for k, v in row.items() if k != "iod"} | {"iod_crc": 5} for row in standard["satellites"])
    draft = Message(1258, {**standard.fields, "satellites": rows, "epoch_s": 100_800})
    clocks = messages_from_correction(clock(System.BEIDOU))
    translator = SsrTranslator()
    assert translator.translate(clocks[0], T0) == Rejected("beidou_dialect_unknown")
    (got,) = through_the_wire([draft], translator=translator)
    assert (got.satellite - ids(System.BEIDOU)).tolist() == [1, 1]
    assert got.header.t_gps_ns == T0
    (got,) = through_the_wire(clocks, translator=translator)
    assert (got.satellite - ids(System.BEIDOU)).tolist() == [1, 1]
    (got,) = through_the_wire([standard], translator=translator)
    assert (got.satellite - ids(System.BEIDOU)).tolist() == [0, 0]
    assert got.header.t_gps_ns == T0


@pytest.mark.parametrize("offset_s", [-86_400.0 * 3.4, -1.0, 0.0, 86_400.0 * 3.4])
@pytest.mark.parametrize("system", [System.GPS, System.BEIDOU])
def test_epochs_resolve_to_the_nearest_week(system, offset_s):
    (got,) = through_the_wire(messages_from_correction(clock(system)), T0 + round(offset_s * NS_PER_S))
    assert got.header.t_gps_ns == T0


def test_glonass_epochs_resolve_to_the_nearest_day():
    (message,) = messages_from_correction(clock(System.GLONASS))
    assert message["epoch_s"] == (100_800 - 18 + 10_800) % 86_400
    (got,) = through_the_wire([message], T0 + 11 * 3600 * NS_PER_S)
    assert got.header.t_gps_ns == T0
    (got,) = through_the_wire([message], T0 + DAY_NS)
    assert got.header.t_gps_ns == T0 + DAY_NS


def test_biases_with_a_stale_epoch_count_from_their_arrival():
    messages = messages_from_correction(code_bias(System.GPS))
    (near,) = through_the_wire(messages, T0 + 1700 * NS_PER_S)
    assert near.header.t_gps_ns == T0
    (stale,) = through_the_wire(messages, T0 + 43_000 * NS_PER_S)
    assert stale.header.t_gps_ns == T0 + 43_000 * NS_PER_S


def test_update_interval_zero_refers_to_the_epoch_itself():
    """DF391: code 0 is one second, and alone has its reference time at the epoch; code 3 is 10 s."""
    header = dataclasses.replace(HEADER, update_interval_s=0.0)
    (message,) = messages_from_correction(dataclasses.replace(clock(System.GPS), header=header))
    assert message["update_interval"] == 0
    (got,) = through_the_wire([message])
    assert got.header.update_interval_s == 0.0
    got = SsrTranslator().translate(Message(1058, {**message.fields, "update_interval": 3}), T0)
    assert got[0].header.update_interval_s == 10.0


def test_what_cannot_be_read_is_counted():
    translator = SsrTranslator()
    (message,) = messages_from_correction(code_bias(System.GPS))
    bias = {"signal": 3, "bias_m": 0.0}
    rows = ({"satellite": 0, "biases": ()}, {"satellite": 4, "biases": (bias, {"signal": 0, "bias_m": 1.0})})
    (got,) = translator.translate(Message(1059, {**message.fields, "satellites": rows}), T0)
    assert got.bias_m.tolist() == [1.0]
    assert translator.skipped == {"satellite_out_of_range": 1, "unknown_signal": 1}
    assert translator.translate(Message(1005, {}), T0) == Rejected("not_an_ssr_message")
    assert translator.translate(Message(4076, {}, 141), T0) == Rejected("not_an_ssr_message")


def test_issues_of_the_wrong_kind_do_not_go_out():
    with pytest.raises(ContractError, match="BeiDou issues"):
        messages_from_correction(orbit(System.BEIDOU), igs=True)


@settings(max_examples=40, deadline=None)
@given(degree=st.integers(1, 16), order=st.integers(1, 16), layers=st.integers(1, 4), igs=st.booleans())
def test_vtec_survives_the_wire(degree, order, layers, igs):
    order = min(order, degree)
    if layers * (degree + 1) * (order + 1) * 32 > 8000:
        layers = 1
    rng = np.random.default_rng(degree * 17 + order)
    n, m = np.meshgrid(np.arange(degree + 1), np.arange(order + 1), indexing="ij")
    cosine = np.where(m <= n, np.round(rng.uniform(-150, 150, n.shape) / 0.005) * 0.005, 0.0)
    sine = np.where((m <= n) & (m > 0), np.round(rng.uniform(-150, 150, n.shape) / 0.005) * 0.005, 0.0)
    sent = SsrVtec(HEADER, 1.25, (450.0,) * layers, (cosine,) * layers, (sine,) * layers)
    messages = messages_from_correction(sent, igs=igs)
    if len(encode(messages[0])) > 1023:
        return
    (back,) = through_the_wire(messages)
    assert back.layer_height_km == sent.layer_height_km
    for a, b in zip((*back.cosine_tecu, *back.sine_tecu), (*sent.cosine_tecu, *sent.sine_tecu), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)
