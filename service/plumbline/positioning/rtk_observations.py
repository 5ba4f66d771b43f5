"""Rover and base rows to single differences: what both receivers observe of a satellite on a band.

A row is one (satellite, band) that rover and base both track, on the same signal where they can, else on two signals of
the band. Rows of one system with the same pair of signals form a *group*: they share the receivers' clocks and hardware
delays, code and phase each their own, whatever the two signals' alignment.
"""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.positioning.preprocess import SIGNAL_BAND
from plumbline.positioning.state import Records
from plumbline.records import Epoch, Ints
from plumbline.signals import (
    CHANNEL_STEP_HZ,
    FREQUENCY_HZ,
    MSM_SIGNAL_CODES,
    N_SIGNALS,
    SATELLITES_PER_SYSTEM,
    SIGNALS_PER_SYSTEM,
    System,
)

ROW_DTYPE: Final = np.dtype(
    [
        ("satellite", np.int16),
        ("system", np.int8),
        ("signal", np.int16),  # of the rover
        ("base_signal", np.int16),
        ("group", np.int16),
        ("integer", np.bool_),
        ("half_cycle", np.int8),
        ("lost_lock", np.bool_),  # a source says that lock was lost since the epoch before
        ("wavelength_m", np.float64),
        ("code_m", np.float64),  # rover's and base's, NaN where missing
        ("base_code_m", np.float64),
        ("phase_m", np.float64),
        ("base_phase_m", np.float64),
        ("range_rate_m_s", np.float64),  # minus Doppler times wavelength
        ("base_range_rate_m_s", np.float64),
        ("cn0_db_hz", np.float64),  # of the weaker
        ("lock_time_s", np.float64),
        ("base_lock_time_s", np.float64),
        ("line", np.float64, 3),  # unit vector rover → satellite
        ("sine", np.float64),  # of the elevation
        ("code_oc_m", np.float64),  # single differences, observed minus computed at the approximate position
        ("phase_oc_m", np.float64),
        ("range_rate_oc_m_s", np.float64),
        ("code_weight", np.float64),  # 1/σ² of the single difference, 1/m²; 0: not used
        ("phase_weight", np.float64),
        ("range_rate_weight", np.float64),
        ("arc", np.int64),  # −1: no phase
    ],
    align=True,
)

#: Bands of each system, in the order in which they are taken.
BANDS: Final[dict[System, str]] = {
    System.GPS: "125",
    System.GLONASS: "12",
    System.GALILEO: "15786",
    System.SBAS: "15",
    System.QZSS: "125",
    System.BEIDOU: "276158",
    System.NAVIC: "59",
}
#: Tracking modes, best first: those that every satellite of a system sends come before those that only some do.
MODES: Final[dict[System, str]] = {
    System.GPS: "CWPXLSQI",
    System.GLONASS: "CP",
    System.GALILEO: "CQXBIZA",
    System.SBAS: "CXQI",
    System.QZSS: "CXLSQI",
    System.BEIDOU: "IXPDQ",
    System.NAVIC: "AXBC",
}
_MAX_BANDS: Final = 6


def _tables() -> tuple[NDArray[np.int8], NDArray[np.int8]]:
    """Rank of each signal id within its band, and band digits (system, order) (0: none)."""
    rank, bands = np.full(N_SIGNALS, 20, np.int8), np.zeros((len(System), _MAX_BANDS), np.int8)
    for system, codes in MSM_SIGNAL_CODES.items():
        for msm_signal, code in codes.items():
            rank[system * SIGNALS_PER_SYSTEM + msm_signal - 1] = MODES[system].find(code[1]) % 20
        for i, digit in enumerate(BANDS[system]):
            bands[system, i] = int(digit)
    return rank, bands


_RANK, _BANDS = _tables()
_GLONASS: Final = int(System.GLONASS)
_MIXED: Final = 100  # two different signals are less welcome than any two alike


@njit(cache=True)
def _usable(code: float, phase: float) -> bool:
    return 1e6 < code < 1e8 and not np.isnan(phase)


@njit(cache=True)
def _best_pair(r0, r1, b0, b1, band, rover, base):  # type: ignore[no-untyped-def]
    """Rows (rover, base) of the best pair of signals on a band, (−1, −1) where none."""
    best, i, j = 10_000, -1, -1
    for a in range(r0, r1):
        if SIGNAL_BAND[rover[0][a]] != band or not _usable(rover[1][a], rover[2][a]):
            continue
        for b in range(b0, b1):
            if SIGNAL_BAND[base[0][b]] != band or not _usable(base[1][b], base[2][b]):
                continue
            cost = _RANK[rover[0][a]] + _RANK[base[0][b]] + (0 if rover[0][a] == base[0][b] else _MIXED)
            if cost < best:
                best, i, j = cost, a, b
    return i, j


@njit(cache=True)
def _least(a: float, b: float) -> float:
    """The smaller, one alone where the other is not known."""
    if np.isnan(a):
        return b
    return a if np.isnan(b) else min(a, b)


@njit(cache=True)
def _fill(row, i, j, system, channel, rover, base):  # type: ignore[no-untyped-def]
    """Fill a row from rover row i and base row j."""
    row.system, row.signal, row.base_signal = system, rover[0][i], base[0][j]
    frequency = FREQUENCY_HZ[rover[0][i]] + channel * CHANNEL_STEP_HZ[rover[0][i]]
    wavelength = SPEED_OF_LIGHT_M_S / frequency
    row.wavelength_m = wavelength
    row.code_m, row.base_code_m = rover[1][i], base[1][j]
    row.phase_m, row.base_phase_m = rover[2][i] * wavelength, base[2][j] * wavelength
    row.range_rate_m_s, row.base_range_rate_m_s = -rover[3][i] * wavelength, -base[3][j] * wavelength
    row.cn0_db_hz = _least(rover[4][i], base[4][j])
    row.lock_time_s, row.base_lock_time_s = rover[5][i], base[5][j]
    row.half_cycle = rover[6][i] + 2 * base[6][j]
    row.lost_lock = rover[7][i] or base[7][j]
    row.integer = system != _GLONASS and row.half_cycle == 0
    row.arc = -1


@njit(cache=True)
def _end_of(satellite, first):  # type: ignore[no-untyped-def]
    last = first
    while last < satellite.size and satellite[last] == satellite[first]:
        last += 1
    return last


@njit(cache=True)
def _match(satellite, rover, base_satellite, base, frequencies, rows):  # type: ignore[no-untyped-def]
    """Fill ``rows`` from both epochs' columns, ordered by satellite; returns how many."""
    made, r0, b0 = 0, 0, 0
    while r0 < satellite.size and b0 < base_satellite.size:
        r1, b1 = _end_of(satellite, r0), _end_of(base_satellite, b0)
        if satellite[r0] == base_satellite[b0]:
            system = satellite[r0] // SATELLITES_PER_SYSTEM
            channel = rover[8][r0] if -7 <= rover[8][r0] <= 6 else base[8][b0]
            found = 0
            for k in range(_MAX_BANDS):
                if found == frequencies or _BANDS[system, k] == 0 or (system == _GLONASS and not -7 <= channel <= 6):
                    break
                i, j = _best_pair(r0, r1, b0, b1, _BANDS[system, k], rover, base)
                if i >= 0:
                    rows[made].satellite = satellite[r0]
                    _fill(rows[made], i, j, system, channel, rover, base)
                    made, found = made + 1, found + 1
        r0_next = r1 if satellite[r0] <= base_satellite[b0] else r0
        if base_satellite[b0] <= satellite[r0]:
            b0 = b1
        r0 = r0_next
    return made


@njit(cache=True)
def _group(rows: Records) -> int:
    """Number the groups of the rows in the order of their first; returns how many there are."""
    signals = np.empty((rows.size, 2), np.int16)
    made = 0
    for row in rows:
        k = 0
        while k < made and (signals[k, 0] != row.signal or signals[k, 1] != row.base_signal):
            k += 1
        if k == made:
            signals[k, 0], signals[k, 1] = row.signal, row.base_signal
            made += 1
        row.group = k
    return made


@njit(cache=True)
def satellites_in(rows: Records, with_code: bool, with_phase: bool) -> tuple[Ints, Ints]:
    """First row of each satellite (s,), of the rows that are used, and every row's number among them (n,), −1: none."""
    first, number = np.empty(rows.size, np.int64), np.full(rows.size, -1)
    made, last = 0, -1
    for i in range(rows.size):
        if (with_code and rows[i].code_weight == 0.0) or (with_phase and rows[i].arc < 0):
            continue
        if rows[i].satellite != last:
            first[made], last = i, rows[i].satellite
            made += 1
        number[i] = made - 1
    return first[:made], number


def _columns(epoch: Epoch) -> tuple[NDArray[np.generic], ...]:
    lost = epoch.loss_of_lock if epoch.loss_of_lock is not None else np.zeros(epoch.satellite.size, np.bool_)
    return (
        epoch.signal, epoch.pseudorange_m, epoch.carrier_phase_cycles, epoch.doppler_hz, epoch.cn0_db_hz,
        epoch.lock_time_s, epoch.half_cycle_ambiguous, lost, epoch.glonass_channel,
    )  # fmt: skip


def single_difference_rows(rover: Epoch, base: Epoch, frequencies: int) -> Records:
    """Rows (``ROW_DTYPE``) of satellites and bands that both epochs have, by satellite; at most ``frequencies`` each.

    Measurements are filled in, the model (lines, differences, weights) is not yet.
    """
    rows = np.zeros(min(rover.satellite.size, base.satellite.size), ROW_DTYPE)
    made = _match(rover.satellite, _columns(rover), base.satellite, _columns(base), frequencies, rows)
    rows = rows[:made]
    _group(rows)
    return rows
