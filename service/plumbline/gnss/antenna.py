"""Antenna phase centres of satellites and receivers (ANTEX 1.4), looked up by satellite id and RINEX band.

An :class:`AntennaBook` holds what is valid at one time as arrays, so that a kernel finds a correction by index. A
missing calibration is zero and flagged. Corrections are metres to *add to the modelled range* (centre of mass to
antenna reference point).
"""

import math
from collections.abc import Iterable
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plumbline.records import AntennaCalibration, AntennaPattern, Floats
from plumbline.signals import N_SATELLITES, SYSTEM_LETTERS, System

N_BANDS: Final = 10  # RINEX bands 1…9; index 0 stays empty
N_NADIR: Final = 31  # satellites: 0…30° by 1°
N_ZENITH: Final = 91  # receivers: 0…90° by 1°
N_AZIMUTH: Final = 73  # receivers: 0…360° by 5°
_DEGREE: Final = math.pi / 180.0

# Bands of another system, or near, that stand in when a receiver's or satellite's own is not calibrated.
_SUBSTITUTES: Final[dict[str, tuple[str, ...]]] = {
    "R1": ("G1",), "R2": ("G2",), "E1": ("G1",), "E5": ("G5", "G2"), "E6": ("G2",), "E7": ("G2",), "E8": ("G5", "G2"),
    "J1": ("G1",), "J2": ("G2",), "J5": ("G5", "G2"), "J6": ("E6", "G2"), "C2": ("C1", "E1", "G1"), "C1": ("E1", "G1"),
    "C5": ("E5", "G5", "G2"), "C6": ("E6", "G2"), "C7": ("E7", "G2"), "C8": ("E8", "G5", "G2"), "G5": ("G2",),
    "S1": ("G1",), "S5": ("G5", "G2"), "I5": ("G5", "G2"),
}  # fmt: skip


class Calibrated(IntEnum):
    """How well a phase centre is known."""

    NO = 0
    YES = 1
    SUBSTITUTE = 2  # of a neighbouring frequency


class AntennaBook(NamedTuple):
    """Phase centres valid at one time. Satellites by (satellite id, band), the receiver by (system, band).

    Offsets in metres: satellites in body axes x, y, z; receiver east, north, up. Variations in metres on even grids:
    satellites nadir 0…30°, receiver azimuth 0…360° and zenith 0…90°. ``*_calibrated`` hold :class:`Calibrated`.
    """

    satellite_offset_m: Floats  # (N_SATELLITES, N_BANDS, 3)
    satellite_variation_m: Floats  # (N_SATELLITES, N_BANDS, N_NADIR)
    satellite_calibrated: NDArray[np.int8]  # (N_SATELLITES, N_BANDS)
    receiver_offset_enu_m: Floats  # (systems, N_BANDS, 3)
    receiver_variation_m: Floats  # (systems, N_BANDS, N_AZIMUTH, N_ZENITH)
    receiver_calibrated: NDArray[np.int8]  # (systems, N_BANDS)


def empty_antenna_book() -> AntennaBook:
    """A book without any calibration: every correction is zero."""
    s = len(System)
    return AntennaBook(
        np.zeros((N_SATELLITES, N_BANDS, 3)),
        np.zeros((N_SATELLITES, N_BANDS, N_NADIR)),
        np.zeros((N_SATELLITES, N_BANDS), np.int8),
        np.zeros((s, N_BANDS, 3)),
        np.zeros((s, N_BANDS, N_AZIMUTH, N_ZENITH)),
        np.zeros((s, N_BANDS), np.int8),
    )


def _pattern(calibration: AntennaCalibration, key: str, may_substitute: bool) -> tuple[AntennaPattern | None, int]:
    """The pattern of a system letter and band (``E5``), or of its substitute."""
    by_key = {p.frequency[0] + p.frequency[-1]: p for p in calibration.patterns}
    if key in by_key:
        return by_key[key], Calibrated.YES
    for other in _SUBSTITUTES.get(key, ()) if may_substitute else ():
        if other in by_key:
            return by_key[other], Calibrated.SUBSTITUTE
    return None, Calibrated.NO


def _valid(calibration: AntennaCalibration, t_gps_ns: int) -> bool:
    begins, ends = calibration.valid_from_gps_ns, calibration.valid_until_gps_ns
    return (begins is None or begins <= t_gps_ns) and (ends is None or t_gps_ns <= ends)


def _fill_satellite(book: AntennaBook, calibration: AntennaCalibration, satellite: int) -> None:
    letter = SYSTEM_LETTERS[satellite // 64]
    for band in range(1, N_BANDS):
        pattern, quality = _pattern(calibration, f"{letter}{band}", may_substitute=letter == "C" and band == 2)
        if pattern is None:
            continue
        book.satellite_offset_m[satellite, band] = pattern.offset_m
        grid = np.arange(N_NADIR) * _DEGREE
        book.satellite_variation_m[satellite, band] = np.interp(grid, calibration.zenith_grid_rad, pattern.variation_m)
        book.satellite_calibrated[satellite, band] = quality


def _receiver_grid(calibration: AntennaCalibration, pattern: AntennaPattern) -> Floats:
    """Variation (N_AZIMUTH, N_ZENITH), with or without dependence on azimuth in the file."""
    zenith = np.arange(N_ZENITH) * _DEGREE
    if pattern.variation_by_azimuth_m is None:
        row = np.interp(zenith, calibration.zenith_grid_rad, pattern.variation_m)
        return np.repeat(row[None, :], N_AZIMUTH, axis=0)
    table = pattern.variation_by_azimuth_m
    rows = np.array([np.interp(zenith, calibration.zenith_grid_rad, row) for row in table])
    given = np.linspace(0.0, 360.0, len(table))
    wanted = np.linspace(0.0, 360.0, N_AZIMUTH)
    return np.array([np.interp(wanted, given, rows[:, i]) for i in range(N_ZENITH)]).T


def _fill_receiver(book: AntennaBook, calibration: AntennaCalibration) -> None:
    for system, letter in enumerate(SYSTEM_LETTERS):
        for band in range(1, N_BANDS):
            pattern, quality = _pattern(calibration, f"{letter}{band}", may_substitute=True)
            if pattern is None:
                continue
            north, east, up = pattern.offset_m
            book.receiver_offset_enu_m[system, band] = east, north, up
            book.receiver_variation_m[system, band] = _receiver_grid(calibration, pattern)
            book.receiver_calibrated[system, band] = quality


def find_receiver(
    calibrations: Iterable[AntennaCalibration], antenna_type: str, serial: str = ""
) -> AntennaCalibration | None:
    """Calibration of a receiver antenna: the individual of that serial, else its type, else with radome NONE."""
    name, radome = antenna_type[:16].strip(), antenna_type[16:20].strip() or "NONE"
    candidates = [c for c in calibrations if c.satellite is None and c.antenna_type[:16].strip() == name]
    ranked = [c for c in candidates if serial and c.serial == serial]
    ranked += [c for c in candidates if not c.serial and (c.antenna_type[16:20].strip() or "NONE") == radome]
    ranked += [c for c in candidates if not c.serial and (c.antenna_type[16:20].strip() or "NONE") == "NONE"]
    return ranked[0] if ranked else None


def build_antenna_book(
    calibrations: Iterable[AntennaCalibration], t_gps_ns: int, receiver: AntennaCalibration | None
) -> AntennaBook:
    """Book of the satellites' antennas valid at a GPS time and of one receiver's antenna (None: zero, flagged)."""
    book = empty_antenna_book()
    for calibration in calibrations:
        if calibration.satellite is not None and _valid(calibration, t_gps_ns):
            _fill_satellite(book, calibration, calibration.satellite)
    if receiver is not None:
        _fill_receiver(book, receiver)
    return book


@njit(cache=True)
def _interpolate(values: Floats, position: float) -> float:
    """Linear in an even grid, held at its ends."""
    k = min(max(int(position), 0), values.shape[0] - 2)
    fraction = min(max(position - k, 0.0), 1.0)
    result: float = values[k] + (values[k + 1] - values[k]) * fraction
    return result


@njit(cache=True)
def satellite_antenna_m(book: AntennaBook, satellite: int, band: int, to_receiver: Floats, body: Floats) -> float:
    """Range correction of a satellite's phase centre, m; unit vector to the receiver (3,), body axes as rows (3, 3)."""
    offset = book.satellite_offset_m[satellite, band]
    cosine = 0.0
    correction = 0.0
    for axis in range(3):
        component = to_receiver[0] * body[axis, 0] + to_receiver[1] * body[axis, 1] + to_receiver[2] * body[axis, 2]
        correction -= offset[axis] * component
        cosine = component
    nadir = math.acos(min(1.0, max(-1.0, cosine)))
    return correction + _interpolate(book.satellite_variation_m[satellite, band], nadir / _DEGREE)


@njit(cache=True)
def receiver_antenna_m(
    book: AntennaBook, system: int, band: int, unit_enu: Floats, azimuth_rad: float, elevation_rad: float
) -> float:
    """Range correction of the receiver's phase centre, m; unit vector receiver → satellite, east, north, up (3,)."""
    offset = book.receiver_offset_enu_m[system, band]
    correction = -(offset[0] * unit_enu[0] + offset[1] * unit_enu[1] + offset[2] * unit_enu[2])
    zenith = 90.0 - elevation_rad / _DEGREE
    position = azimuth_rad / _DEGREE / 5.0
    k = min(max(int(position), 0), N_AZIMUTH - 2)
    left = _interpolate(book.receiver_variation_m[system, band, k], zenith)
    right = _interpolate(book.receiver_variation_m[system, band, k + 1], zenith)
    result: float = correction + left + (right - left) * (position - k)
    return result
