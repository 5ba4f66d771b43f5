"""Oracles: hand-counted wire layouts and the identity decode(encode(x)) = x."""

import numpy as np
import pytest

from plumbline.errors import ContractError
from plumbline.gps_time import WEEK_NS
from plumbline.records import AntennaDescription
from plumbline.rtcm3 import InertialMessage, Malformed, Message, decode, encode
from plumbline.rtcm3.inertial import max_samples
from plumbline.rtcm3.station import describe, glonass_code_biases_m

POSITION = {
    "station": 77, "itrf_realization_year": 0, "gps": True, "glonass": True, "galileo": False,
    "reference_station": False, "x_ecef_m": 3582104.7628, "single_oscillator": True, "y_ecef_m": -532590.18,
    "quarter_cycle": 1, "z_ecef_m": 5232755.1333, "antenna_height_m": 0.2160,
}  # fmt: skip


def _through(message: Message) -> Message:
    decoded = decode(encode(message))
    assert isinstance(decoded, Message)
    return decoded


def test_descriptions_add_up() -> None:
    antenna = {"station": 77, "antenna_type": "ASH701945E_M    SCIS", "antenna_setup": 0, "antenna_serial": "1234"}
    receiver = {"receiver_type": "SEPT POLARX5", "receiver_firmware": "5.3.2", "receiver_serial": ""}
    known = AntennaDescription(77)
    for message in (
        Message(1033, antenna | receiver),
        Message(1006, POSITION),
        Message(1008, antenna | {"antenna_type": "", "antenna_serial": ""}),  # says nothing
        Message(1005, {**POSITION, "x_ecef_m": 0.0, "y_ecef_m": 0.0, "z_ecef_m": 0.0}),  # nor does this
    ):
        known = describe(known, _through(message))
    assert known == AntennaDescription(
        77, (3582104.7628, -532590.18, 5232755.1333), 0.216, "ASH701945E_M    SCIS", "1234", "SEPT POLARX5"
    )


def test_lengths_are_the_standards() -> None:
    sizes = {number: len(encode(Message(number, POSITION))) for number in (1005, 1006)}
    assert sizes == {1005: 19, 1006: 21}
    parameters = {"station": 1, "modified_julian_day": 58313, "second_of_day": 86000, "leap_seconds": 18}
    announcement = {"message": 1077, "synchronous": True, "interval_s": 1.0}
    payload = encode(Message(1013, {**parameters, "announcements": (announcement,) * 3}))
    assert len(payload) == -(-(70 + 3 * 29) // 8)
    assert _through(Message(1013, {**parameters, "announcements": (announcement,) * 3}))["n_announcements"] == 3


def test_a_string_longer_than_its_frame_is_malformed() -> None:
    payload = bytearray(encode(Message(1007, {"station": 1, "antenna_type": "TRM", "antenna_setup": 0})))
    payload[3] = 200
    assert decode(bytes(payload)) == Malformed(1007, "too_short")


def test_text_keeps_its_characters() -> None:
    fields = {"station": 23, "modified_julian_day": 132, "second_of_day": 59100, "n_characters": 30}
    words = "UTF-8 проверка wörter"
    assert _through(Message(1029, {**fields, "text": words}))["text"] == words


def test_glonass_biases_by_code() -> None:
    fields = {"station": 1, "aligned": True, "signal_mask": 0b1011, "biases_m": (0.02, None, -655.34)}
    message = _through(Message(1230, fields))
    assert glonass_code_biases_m(message) == pytest.approx({"1C": 0.02, "2P": -655.34})


def _inertial(n: int, gyroscope: bool) -> InertialMessage:
    generator = np.random.default_rng(n)
    force = np.round(generator.uniform(-80, 80, (n, 3)), 5)
    rate = np.round(generator.uniform(-8, 8, (n, 3)), 6) if gyroscope else None
    return InertialMessage(4001, 12, 3, 604_799_999, 999, 10_000, -12.3, force, rate)


@pytest.mark.parametrize(
    ("n", "gyroscope", "size"), [(100, False, 914), (112, False, 1022), (56, True, 1022), (0, True, 14)]
)
def test_inertial_samples_go_through(n: int, gyroscope: bool, size: int) -> None:
    sent = _inertial(n, gyroscope)
    payload = encode(sent)
    assert len(payload) == size
    got = decode(payload)
    assert isinstance(got, InertialMessage)
    header = (got.number, got.station, got.sensor, got.tow_ms, got.tow_us, got.interval_us)
    assert header == (4001, 12, 3, 604_799_999, 999, 10_000)
    assert got.temperature_c == pytest.approx(-12.3)
    np.testing.assert_allclose(got.specific_force_m_s2, sent.specific_force_m_s2, rtol=0, atol=1e-12)
    if sent.angular_rate_rad_s is not None:
        assert got.angular_rate_rad_s is not None
        np.testing.assert_allclose(got.angular_rate_rad_s, sent.angular_rate_rad_s, rtol=0, atol=1e-12)
    assert encode(got) == payload


def test_the_inertial_layout_bit_by_bit() -> None:
    message = InertialMessage(4001, 0xABC, 5, 0x123456, 0x155, 0x98968, None, np.array([[1e-5, -1e-5, 9.80665]]))
    bits = f"{4001:012b}{0xABC:012b}{5:04b}{0:04b}{0x123456:030b}{0x155:010b}{0x98968:020b}{1:08b}{2048:012b}"
    bits += f"{1:024b}{2**24 - 1:024b}{980665:024b}"
    assert encode(message) == int(bits, 2).to_bytes(len(bits) // 8, "big")


def test_inertial_blocks_get_their_full_time() -> None:
    block = _inertial(3, False).block(2001 * WEEK_NS + 5_000_000_000, 7)  # just past the week's end
    assert block.t_first_gps_ns == 2001 * WEEK_NS - 1000
    assert (block.interval_ns, block.t_receive_ns, block.sensor) == (10_000_000, 7, 3)


def test_inertial_number_is_a_setting() -> None:
    payload = encode(_numbered(4050))
    assert isinstance(decode(payload, inertial_number=4050), InertialMessage)
    assert not isinstance(decode(payload), InertialMessage)


def _numbered(number: int) -> InertialMessage:
    return InertialMessage(number, 0, 0, 0, 0, 10_000, None, np.zeros((2, 3)))


def test_inertial_saturates_and_refuses() -> None:
    loud = InertialMessage(4001, 0, 0, 0, 0, 10_000, None, np.array([[1e3, -1e3, 0.0]]))
    got = decode(encode(loud))
    assert isinstance(got, InertialMessage)
    np.testing.assert_allclose(got.specific_force_m_s2, [[83.88607, -83.88607, 0.0]], atol=1e-9)
    with pytest.raises(ContractError):
        encode(InertialMessage(4001, 0, 0, 0, 0, 10_000, None, np.full((1, 3), np.nan)))
    with pytest.raises(ContractError):
        encode(InertialMessage(4001, 0, 0, 0, 0, 10_000, None, np.zeros((max_samples(False) + 1, 3))))


@pytest.mark.parametrize(
    ("at", "width", "value", "reason"),
    [(28, 4, 2, "unknown_kind"), (32, 30, 2**30 - 1, "epoch_out_of_range"), (62, 10, 1000, "epoch_out_of_range"),
     (72, 20, 0, "no_interval"), (92, 8, 255, "too_short")],
)  # fmt: skip
def test_malformed_inertial_messages(at: int, width: int, value: int, reason: str) -> None:
    payload = encode(_inertial(2, False))
    size = 8 * len(payload)
    shift = size - at - width
    changed = int.from_bytes(payload, "big") & ~(((1 << width) - 1) << shift) | value << shift
    assert decode(changed.to_bytes(len(payload), "big")) == Malformed(4001, reason)
