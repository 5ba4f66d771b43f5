"""Oracles: the interface documents' own statements, and that the reference pair's ionosphere-free delay is zero."""

import math

import pytest

from plumbline.gnss.group_delays import group_delay_s
from plumbline.signals import System, carrier_frequency_hz, signal_id

from .make_ephemeris import glonass, kepler


def _delay(ephemeris: object, system: System, code: str) -> float:
    signal = signal_id(system, code)
    assert signal is not None
    return group_delay_s(ephemeris, signal)  # type: ignore[arg-type]


def _ionosphere_free(ephemeris: object, system: System, first: str, second: str) -> float:
    f1, f2 = (carrier_frequency_hz(signal_id(system, code) or 0) ** 2 for code in (first, second))
    return (f1 * _delay(ephemeris, system, first) - f2 * _delay(ephemeris, system, second)) / (f1 - f2)


def test_gps_single_frequency_users_subtract_tgd() -> None:
    e = kepler("G05", group_delay_s=(-5e-9, 0.0))
    assert _delay(e, System.GPS, "1C") == -5e-9
    assert _delay(e, System.GPS, "2W") == pytest.approx((77 / 60) ** 2 * -5e-9)
    assert _ionosphere_free(e, System.GPS, "1W", "2W") == pytest.approx(0.0, abs=1e-22)


@pytest.mark.parametrize(("message", "partner"), [("FNAV", "5Q"), ("INAV", "7Q")])
def test_galileo_clocks_belong_to_their_messages_pair(message: str, partner: str) -> None:
    e = kepler("E11", message=message, group_delay_s=(3e-9, 4e-9))
    assert _ionosphere_free(e, System.GALILEO, "1C", partner) == pytest.approx(0.0, abs=1e-22)
    assert _delay(e, System.GALILEO, "1C") == (3e-9 if message == "FNAV" else 4e-9)
    assert math.isnan(_delay(e, System.GALILEO, "6C"))


def test_galileo_messages_tell_the_same_of_every_signal() -> None:
    """Clock and delay together are the signal's: between messages both change by the difference of the BGDs."""
    fnav = kepler("E11", message="FNAV", group_delay_s=(3e-9, 4e-9))
    inav = kepler("E11", message="INAV", group_delay_s=(3e-9, 4e-9))
    for code in ("1C", "5Q", "7Q"):
        difference = _delay(inav, System.GALILEO, code) - _delay(fnav, System.GALILEO, code)
        assert difference == pytest.approx(4e-9 - 3e-9, abs=1e-21)


def test_beidou_refers_to_b3i() -> None:
    e = kepler("C20", group_delay_s=(7e-9, -2e-9))
    assert [_delay(e, System.BEIDOU, c) for c in ("2I", "7I", "6I")] == [7e-9, -2e-9, 0.0]
    assert math.isnan(_delay(e, System.BEIDOU, "5P"))


def test_glonass_refers_to_l1() -> None:
    e = glonass(group_delay_s=2.8e-9)
    assert [_delay(e, System.GLONASS, c) for c in ("1C", "2C")] == [0.0, 2.8e-9]


def test_a_signal_that_does_not_exist_is_nan() -> None:
    assert math.isnan(group_delay_s(kepler("G05"), 0))
