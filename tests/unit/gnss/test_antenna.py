"""Oracles: projections by hand, linear tables whose interpolation is known, substitution rules."""

import math

import numpy as np
import pytest

from plumbline.gnss.antenna import (
    Calibrated,
    build_antenna_book,
    empty_antenna_book,
    find_receiver,
    receiver_antenna_m,
    satellite_antenna_m,
)
from plumbline.records import AntennaCalibration, AntennaPattern
from plumbline.signals import System, satellite_of_name

T_NS = 1_277_100_000 * 1_000_000_000
ZENITH = np.radians(np.arange(0.0, 91.0, 5.0))
NADIR = np.radians(np.arange(0.0, 15.0))


def receiver(kind: str = "ASH701945E_M    SCIS", serial: str = "", by_azimuth: bool = False) -> AntennaCalibration:
    noazi = 0.001 * np.degrees(ZENITH) / 90.0
    azimuths = np.radians(np.arange(0.0, 361.0, 10.0))
    table = noazi + 0.002 * (azimuths / (2 * math.pi))[:, None] if by_azimuth else None
    patterns = (
        AntennaPattern("G01", (0.0005, -0.0003, 0.09), noazi, table),
        AntennaPattern("G02", (0.0001, 0.0002, 0.12), 2.0 * noazi, None),
    )
    return AntennaCalibration(kind, serial, ZENITH, patterns)


def satellite(name: str, until: int | None = None, begins: int | None = None, z: float = 0.8) -> AntennaCalibration:
    pattern = AntennaPattern(f"{name[0]}01", (0.1, -0.05, z), 0.001 * np.degrees(NADIR), None)
    return AntennaCalibration("BLOCK", name, NADIR, (pattern,), satellite_of_name(name), begins, until)


def test_a_satellites_offset_towards_the_earth_shortens_the_range() -> None:
    book = build_antenna_book([satellite("G05")], T_NS, None)
    body = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])  # satellite overhead, z down
    assert satellite_antenna_m(book, satellite_of_name("G05"), 1, np.array([0.0, 0.0, -1.0]), body) == pytest.approx(
        -0.8
    )
    nadir = math.radians(7.5)
    to_receiver = np.array([math.sin(nadir), 0.0, -math.cos(nadir)])
    wanted = -(0.1 * math.sin(nadir) + 0.8 * math.cos(nadir)) + 0.0075
    assert satellite_antenna_m(book, satellite_of_name("G05"), 1, to_receiver, body) == pytest.approx(wanted, abs=1e-12)
    assert book.satellite_calibrated[satellite_of_name("G05"), 1] == Calibrated.YES


def test_a_satellites_calibration_has_its_time() -> None:
    calibrations = [satellite("G05", until=T_NS - 1, z=0.5), satellite("G05", begins=T_NS, z=1.5)]
    book = build_antenna_book(calibrations, T_NS, None)
    assert book.satellite_offset_m[satellite_of_name("G05"), 1, 2] == 1.5
    early = build_antenna_book(calibrations, T_NS - 10, None)
    assert early.satellite_offset_m[satellite_of_name("G05"), 1, 2] == 0.5


def test_a_receivers_phase_centre_above_it_shortens_the_range() -> None:
    book = build_antenna_book([], T_NS, receiver())
    up = np.array([0.0, 0.0, 1.0])
    assert receiver_antenna_m(book, System.GPS, 1, up, 0.3, math.pi / 2) == pytest.approx(-0.09)
    elevation, azimuth = math.radians(33.0), math.radians(123.0)
    unit = np.array(
        [math.cos(elevation) * math.sin(azimuth), math.cos(elevation) * math.cos(azimuth), math.sin(elevation)]
    )
    wanted = -(0.0005 * unit[1] - 0.0003 * unit[0] + 0.09 * unit[2]) + 0.001 * 57.0 / 90.0
    assert receiver_antenna_m(book, System.GPS, 1, unit, azimuth, elevation) == pytest.approx(wanted, abs=1e-12)


def test_variations_with_azimuth_are_interpolated_in_both() -> None:
    book = build_antenna_book([], T_NS, receiver(by_azimuth=True))
    plain = build_antenna_book([], T_NS, receiver())
    unit = np.array([1.0, 0.0, 0.0])
    for azimuth in (0.0, 1.0, 4.321, 6.283):
        got, base = (receiver_antenna_m(b, System.GPS, 1, unit, azimuth, 0.4) for b in (book, plain))
        assert got - base == pytest.approx(0.002 * azimuth / (2 * math.pi), abs=1e-9)


def test_neighbouring_frequencies_stand_in_and_say_so() -> None:
    book = build_antenna_book([], T_NS, receiver())
    assert book.receiver_calibrated[System.GALILEO, 1] == Calibrated.SUBSTITUTE
    assert book.receiver_calibrated[System.GALILEO, 5] == Calibrated.SUBSTITUTE
    assert book.receiver_calibrated[System.GPS, 1] == Calibrated.YES
    assert book.receiver_offset_enu_m[System.GALILEO, 5] == pytest.approx(book.receiver_offset_enu_m[System.GPS, 2])
    assert book.receiver_calibrated[System.NAVIC, 9] == Calibrated.NO


def test_no_calibration_is_zero_and_flagged() -> None:
    book = empty_antenna_book()
    assert not book.receiver_calibrated.any()
    assert receiver_antenna_m(book, System.GPS, 1, np.array([0.0, 0.0, 1.0]), 0.0, 1.0) == 0.0
    assert satellite_antenna_m(book, 4, 1, np.array([0.0, 0.0, -1.0]), np.eye(3)) == 0.0


def test_the_receivers_own_calibration_before_its_type_before_no_radome() -> None:
    none, scis, own = receiver("ASH701945E_M    NONE"), receiver(), receiver(serial="CR12")
    assert find_receiver([none, scis, own], "ASH701945E_M    SCIS", "CR12") is own
    assert find_receiver([none, scis, own], "ASH701945E_M    SCIS", "other") is scis
    assert find_receiver([none], "ASH701945E_M    SCIS") is none
    assert find_receiver([none, scis], "ASH701945E_M") is none
    assert find_receiver([satellite("G05"), none], "TRM59800.00     SCIS") is None
