"""Legacy observations. Oracles: hand-made fields by the standard's tables, and the identity decode(encode(x)) = x."""

import numpy as np
import pytest

from plumbline.constants import LIGHT_MILLISECOND_M
from plumbline.errors import ContractError
from plumbline.records import UNKNOWN_CHANNEL
from plumbline.rtcm3 import Malformed, Observations, decode, encode
from plumbline.rtcm3.fields import encode_table
from plumbline.rtcm3.legacy import LEGACY_TABLES, least_lock_s
from plumbline.rtcm3.observations import unroll_legacy_phase
from plumbline.signals import satellite_name, signal_code

HEADER = {
    "station": 3, "epoch_ms": 345_600_000, "multiple_message": True, "smoothing": False, "smoothing_interval": 0,
}  # fmt: skip
SATELLITE = {
    "satellite": 7, "code_1": 0, "pseudorange_1_m": 1000.0, "phase_1_m": -2.5, "lock_1": 50, "ambiguity": 70,
    "cn0_1_db_hz": 45.5, "code_2": 3, "difference_2_m": 4.0, "phase_2_m": 6.5, "lock_2": 127, "cn0_2_db_hz": None,
    "channel": -4,
}  # fmt: skip
BASE_M = 1000.0 + 70 * LIGHT_MILLISECOND_M


def _decode(number: int, *satellites: dict[str, object], **header: object) -> Observations | Malformed:
    fields = {**HEADER, **header, "satellites": tuple({**SATELLITE, **own} for own in satellites)}
    message = decode(encode_table(LEGACY_TABLES[number], fields))
    assert isinstance(message, Observations | Malformed)
    return message


def _rows(message: Observations | Malformed) -> list[tuple[str, str]]:
    assert isinstance(message, Observations)
    ids = zip(message.satellite.tolist(), message.signal.tolist(), strict=True)
    return [(satellite_name(satellite), signal_code(signal)) for satellite, signal in ids]


def test_both_bands_of_1004() -> None:
    message = _decode(1004, {}, {"satellite": 2, "code_1": 1, "code_2": 0})
    assert _rows(message) == [("G02", "1P"), ("G02", "2X"), ("G07", "1C"), ("G07", "2W")]
    assert isinstance(message, Observations)
    np.testing.assert_allclose(message.pseudorange_m[2:], [BASE_M, BASE_M + 4.0], rtol=0, atol=1e-7)
    np.testing.assert_allclose(message.phase_range_m[2:], [BASE_M - 2.5, BASE_M + 6.5], rtol=0, atol=1e-7)
    np.testing.assert_array_equal(message.lock_time_s[2:], [80.0, 937.0])  # 4 · 50 − 120
    np.testing.assert_array_equal(message.cn0_db_hz[2:], [45.5, np.nan])
    assert message.multiple_message


def test_without_a_phase_the_first_bands_pseudorange_only_serves_the_second() -> None:
    message = _decode(1004, {"phase_1_m": None})
    assert _rows(message) == [("G07", "2W")]
    assert isinstance(message, Observations)
    assert message.pseudorange_m[0] == pytest.approx(BASE_M + 4.0)
    assert _rows(_decode(1004, {"difference_2_m": None, "phase_2_m": None})) == [("G07", "1C")]


def test_glonass_has_its_channel_and_two_milliseconds() -> None:
    message = _decode(1012, {"code_2": 1}, {"satellite": 9, "channel": 9, "code_2": 0}, epoch_ms=1000)
    assert _rows(message) == [("R07", "1C"), ("R07", "2P"), ("R09", "1C"), ("R09", "2C")]
    assert isinstance(message, Observations)
    assert message.pseudorange_m[0] == pytest.approx(1000.0 + 140 * LIGHT_MILLISECOND_M)
    assert message.glonass_channel.tolist() == [-4, -4, UNKNOWN_CHANNEL, UNKNOWN_CHANNEL]
    np.testing.assert_array_equal(np.isnan(message.carrier_phase_cycles), [False, False, True, True])


def test_messages_without_the_ambiguity_give_no_full_range() -> None:
    message = _decode(1003, {})
    assert isinstance(message, Observations)
    assert np.isnan(message.pseudorange_m).all()
    assert np.isnan(message.carrier_phase_cycles).all()
    assert message.pseudorange_modulo_m is not None
    np.testing.assert_allclose(message.pseudorange_modulo_m, [1000.0, 1004.0])
    assert message.range_modulus_m == LIGHT_MILLISECOND_M


def test_numbers_beyond_the_system() -> None:
    message = _decode(1002, {"satellite": 40}, {"satellite": 58}, {"satellite": 33}, {"satellite": 0})
    assert _rows(message) == [("S20", "1C"), ("S38", "1C")]


def test_malformed() -> None:
    assert _decode(1002, {}, {}) == Malformed(1002, "repeated_satellite")
    assert _decode(1010, {}, epoch_ms=2**27 - 1) == Malformed(1010, "epoch_out_of_range")
    payload = encode_table(LEGACY_TABLES[1002], {**HEADER, "satellites": (SATELLITE,) * 3})
    assert decode(payload[:-2]) == Malformed(1002, "too_short")


@pytest.mark.parametrize("number", sorted(LEGACY_TABLES))
def test_encoding_keeps_every_value(number: int) -> None:
    first = _decode(number, {"code_2": 0}, {"satellite": 4, "difference_2_m": None, "code_2": 1}, epoch_ms=77_000)
    assert isinstance(first, Observations)
    second = decode(encode(first))
    assert isinstance(second, Observations)
    for name, a, b in zip(first._fields, first, second, strict=True):
        if isinstance(a, np.ndarray):
            pair = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
            np.testing.assert_allclose(*pair, rtol=1e-15, atol=1e-8, err_msg=name)
        else:
            assert a == b, name


def test_what_the_format_has_no_place_for() -> None:
    message = _decode(1004, {})
    assert isinstance(message, Observations)
    with pytest.raises(ContractError):
        encode(message._replace(pseudorange_m=np.full(2, np.nan)))
    with pytest.raises(ContractError):
        encode(message._replace(phase_range_m=message.phase_range_m + 500.0))


def test_lock_times_grow_without_gaps() -> None:
    seconds = [least_lock_s(code) for code in range(128)]
    steps = [1] * 24 + [2] * 24 + [4] * 24 + [8] * 24 + [16] * 24 + [32] * 7
    assert seconds == [sum(steps[:code]) for code in range(127)] + [937]


def test_rollovers_are_undone() -> None:
    truth = np.linspace(0.0, 9000.0, 200)[:, None] + np.array([[0.0, 1e8]])
    phase = truth[0]
    for k, actual in enumerate(truth):
        rolled = actual - 1500.0 * (k // 30)
        phase = unroll_legacy_phase(phase, rolled)
        np.testing.assert_allclose(phase, actual)
    np.testing.assert_array_equal(unroll_legacy_phase(np.array([np.nan]), np.array([7.0])), [7.0])
