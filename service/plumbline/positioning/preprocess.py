"""Observation rows to signal pairs: one dual-frequency pair a satellite, and the combinations that positioning uses.

Which pair: of the bands that the precise clocks refer to (GPS and GLONASS 1/2, Galileo E1/E5a, BeiDou B1I/B3I) where
both are there, else the next. In a band, the code whose bias is known, then the one the clocks refer to (W before C …),
and the phase, of the same signal or another (receivers track GPS L1 P(Y) on the phase of C/A). An arc keeps its phases
as long as both are observed: a change of signal is a new ambiguity. A satellite with one frequency alone gives a code.

Ionosphere-free: ``α·1 − β·2`` with ``α = f₁²/(f₁² − f₂²)``, ``β = α − 1``. Geometry-free: ``λ₁φ₁ − λ₂φ₂``. Wide lane:
Melbourne-Wübbena, ``φ₁ − φ₂ − (f₁P₁ + f₂P₂)/((f₁ + f₂) λ_w)``, cycles (Melbourne 1985; Wübbena 1985).
"""

from functools import lru_cache
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.positioning.satellites import SignalBiases
from plumbline.positioning.state import Records
from plumbline.records import Epoch, Floats
from plumbline.signals import (
    CHANNEL_STEP_HZ,
    FREQUENCY_HZ,
    MSM_SIGNAL_CODES,
    N_SIGNALS,
    SATELLITES_PER_SYSTEM,
    SIGNALS_PER_SYSTEM,
    SYSTEM_LETTERS,
    System,
    system_of_letter,
)

PAIR_DTYPE: Final = np.dtype(
    [
        ("satellite", np.int16),
        ("system", np.int8),
        ("signal_1", np.int16),  # of the phases; −1 where there is no pair of them
        ("signal_2", np.int16),
        ("code_1", np.int16),  # signals of the codes; −1 where there is none
        ("code_2", np.int16),
        ("discontinuity_1", np.int16),
        ("discontinuity_2", np.int16),
        ("half_cycle", np.int8),
        ("lost_lock", np.bool_),  # the source says that lock was lost since the epoch before
        ("bias_known", np.bool_),  # of both codes
        ("frequency_1_hz", np.float64),
        ("frequency_2_hz", np.float64),  # zero: one frequency only
        ("alpha", np.float64),
        ("range_m", np.float64),  # a pseudorange, for the instant of transmission
        ("code_m", np.float64),  # ionosphere-free, biases added
        ("phase_m", np.float64),  # ionosphere-free, biases added where known; NaN without both phases
        ("geometry_free_m", np.float64),
        ("wide_lane_cycles", np.float64),
        ("lock_time_s", np.float64),
        ("cn0_db_hz", np.float64),  # of the weaker signal
        ("thermal", np.float64),  # variance of the codes' thermal noise over that of all other
    ],
    align=True,
)

#: Band pairs of each system, best first.
BAND_PAIRS: Final[dict[System, tuple[str, ...]]] = {
    System.GPS: ("12", "15"),
    System.GLONASS: ("12",),
    System.GALILEO: ("15", "17", "18", "16"),
    System.QZSS: ("12", "15"),
    System.BEIDOU: ("26", "27", "25", "15", "16"),
    System.SBAS: ("15",),
}
#: Tracking modes of a band, best first (a mode not named comes last).
_MODES: Final[dict[System, str]] = {
    System.GPS: "WPCQXLSI",
    System.GLONASS: "PC",
    System.GALILEO: "CQXBIZA",
    System.QZSS: "CXLSQI",
    System.BEIDOU: "IXPDQ",
    System.SBAS: "CXQI",
}
_MAX_PAIRS = 5


def _tables() -> tuple[NDArray[np.int8], NDArray[np.int8], NDArray[np.int8], NDArray[np.bool_]]:
    """Band digit and rank of each signal id, band digits (system, preference, 2) of the pairs (0: none), and whether a
    signal is tracked without its code, so that its C/N0 is that after the loss of squaring (GPS P(Y)).
    """
    band, rank = np.zeros(N_SIGNALS, np.int8), np.full(N_SIGNALS, 20, np.int8)
    pairs, codeless = np.zeros((len(System), _MAX_PAIRS, 2), np.int8), np.zeros(N_SIGNALS, np.bool_)
    for system, codes in MSM_SIGNAL_CODES.items():
        for msm_signal, code in codes.items():
            signal = system * SIGNALS_PER_SYSTEM + msm_signal - 1
            band[signal] = int(code[0])
            codeless[signal] = code[1] == "W"
            rank[signal] = _MODES.get(system, "").find(code[1]) % 20
        for i, pair in enumerate(BAND_PAIRS.get(system, ())):
            pairs[system, i] = int(pair[0]), int(pair[1])
    return band, rank, pairs, codeless


SIGNAL_BAND, _RANK, _PAIRS, _CODELESS = _tables()
_THERMAL_CN0_DB_HZ: Final = 33.0  # at which thermal noise is as large as all other
_UNKNOWN_BIAS_RANK: Final = 40
_GLONASS: Final = int(System.GLONASS)


@njit(cache=True)
def _best_row(first: int, last: int, band: int, signal: NDArray[np.int16], cost: NDArray[np.int64]) -> int:
    """Row of [first, last) in a band with the least cost, −1 where none."""
    best = -1
    for row in range(first, last):
        if SIGNAL_BAND[signal[row]] == band and cost[row] >= 0 and (best < 0 or cost[row] < cost[best]):
            best = row
    return best


@njit(cache=True)
def _row_of(first: int, last: int, wanted: int, signal: NDArray[np.int16], cost: NDArray[np.int64]) -> int:
    """Row of [first, last) with a signal, −1 where none."""
    for row in range(first, last):
        if signal[row] == wanted and cost[row] >= 0:
            return row
    return -1


@njit(cache=True)
def _code_costs(signal: NDArray[np.int16], code: Floats, code_bias: Floats) -> NDArray[np.int64]:
    """How unwelcome each row's code is; −1: there is none, or an impossible one."""
    cost = np.empty(signal.size, np.int64)
    for row in range(signal.size):
        possible = 1e6 < code[row] < 1e8
        cost[row] = _RANK[signal[row]] + (_UNKNOWN_BIAS_RANK if np.isnan(code_bias[row]) else 0) if possible else -1
    return cost


@njit(cache=True)
def _phase_costs(signal: NDArray[np.int16], phase: Floats) -> NDArray[np.int64]:
    """How unwelcome each row's phase is; −1: there is none."""
    cost = np.empty(signal.size, np.int64)
    for row in range(signal.size):
        cost[row] = -1 if np.isnan(phase[row]) else _RANK[signal[row]]
    return cost


@njit(cache=True)
def _phase_rows(first, last, system, wanted, signal, code_cost, phase_cost):  # type: ignore[no-untyped-def]
    """Rows of the two phases: those of the arc (signals ``wanted``) where observed, else of the best band pair."""
    row_1 = _row_of(first, last, wanted[0], signal, phase_cost)
    row_2 = _row_of(first, last, wanted[1], signal, phase_cost)
    if row_1 >= 0 and row_2 >= 0 and _codes_of(first, last, row_1, row_2, signal, code_cost)[1] >= 0:
        return row_1, row_2
    for i in range(_MAX_PAIRS):
        if _PAIRS[system, i, 0] == 0:
            break
        row_1 = _best_row(first, last, _PAIRS[system, i, 0], signal, phase_cost)
        row_2 = _best_row(first, last, _PAIRS[system, i, 1], signal, phase_cost)
        if row_1 >= 0 and row_2 >= 0 and _codes_of(first, last, row_1, row_2, signal, code_cost)[1] >= 0:
            return row_1, row_2
    return -1, -1


@njit(cache=True)
def _codes_of(first, last, row_1, row_2, signal, code_cost):  # type: ignore[no-untyped-def]
    """Rows of the best codes on the bands of two rows; (−1, −1) unless both are there."""
    code_1 = _best_row(first, last, SIGNAL_BAND[signal[row_1]], signal, code_cost)
    code_2 = _best_row(first, last, SIGNAL_BAND[signal[row_2]], signal, code_cost)
    return (code_1, code_2) if code_1 >= 0 and code_2 >= 0 else (-1, -1)


@njit(cache=True)
def _code_rows(first, last, system, signal, code_cost):  # type: ignore[no-untyped-def]
    """Rows of two codes where the phases give no pair; (row, −1) where only one band is observed."""
    for i in range(_MAX_PAIRS):
        if _PAIRS[system, i, 0] == 0:
            break
        row_1 = _best_row(first, last, _PAIRS[system, i, 0], signal, code_cost)
        row_2 = _best_row(first, last, _PAIRS[system, i, 1], signal, code_cost)
        if row_1 >= 0 and row_2 >= 0:
            return row_1, row_2
    for row in range(first, last):
        if code_cost[row] >= 0:
            return row, -1
    return -1, -1


@njit(cache=True)
def _or_zero(value: float) -> float:
    return 0.0 if np.isnan(value) else value


@njit(cache=True)
def _thermal(signal: int, cn0_db_hz: float) -> float:
    """Variance of thermal noise over that of all other: as 10^(−C/N₀/10) (Wieser & Brunner 2000, SIGMA-ε)."""
    if not cn0_db_hz > 0.0 or _CODELESS[signal]:
        return 0.0
    return float(10.0 ** (0.1 * (_THERMAL_CN0_DB_HZ - cn0_db_hz)))


@njit(cache=True)
def _combine_codes(pair, f1, f2, c1, c2):  # type: ignore[no-untyped-def]
    """Fill a pair's frequencies and code from two codes, m (the second NaN: one frequency)."""
    pair.frequency_1_hz, pair.frequency_2_hz = f1, f2
    pair.alpha = f1 * f1 / (f1 * f1 - f2 * f2) if f2 > 0.0 else 1.0
    pair.code_m = pair.alpha * c1 - (pair.alpha - 1.0) * c2 if f2 > 0.0 else c1
    pair.phase_m, pair.geometry_free_m, pair.wide_lane_cycles = np.nan, np.nan, np.nan


@njit(cache=True)
def _combine_phases(pair, l1, l2, c1, c2):  # type: ignore[no-untyped-def]
    """Fill a pair's phase combinations from two phases and codes, m."""
    f1, f2 = pair.frequency_1_hz, pair.frequency_2_hz
    pair.phase_m = pair.alpha * l1 - (pair.alpha - 1.0) * l2
    pair.geometry_free_m = l1 - l2
    wide_lane_m = (f1 * l1 - f2 * l2) / (f1 - f2) - (f1 * c1 + f2 * c2) / (f1 + f2)
    pair.wide_lane_cycles = wide_lane_m * (f1 - f2) / SPEED_OF_LIGHT_M_S


@njit(cache=True)
def _fill_pair(pair, i, j, k, m, rows):  # type: ignore[no-untyped-def]
    """Fill a pair from the rows of its codes (i, j; j −1: one frequency) and of its phases (k, m; −1: none)."""
    signal, code, phase, cn0, lock_time, half_cycle, lost, channel, code_bias, phase_bias, discontinuity = rows
    f1 = FREQUENCY_HZ[signal[i]] + channel[i] * CHANNEL_STEP_HZ[signal[i]]
    f2 = FREQUENCY_HZ[signal[j]] + channel[i] * CHANNEL_STEP_HZ[signal[j]] if j >= 0 else 0.0
    c1 = code[i] + _or_zero(code_bias[i])
    c2 = code[j] + _or_zero(code_bias[j]) if j >= 0 else np.nan
    _combine_codes(pair, f1, f2, c1, c2)
    pair.range_m = code[i]
    pair.code_1, pair.code_2 = signal[i], signal[j] if j >= 0 else np.int16(-1)
    pair.bias_known = not (np.isnan(code_bias[i]) or (j >= 0 and np.isnan(code_bias[j])))
    pair.cn0_db_hz = np.minimum(cn0[i], cn0[max(j, i)])
    pair.thermal = max(_thermal(signal[i], cn0[i]), _thermal(signal[max(j, i)], cn0[max(j, i)]))
    pair.signal_1, pair.signal_2 = -1, -1
    if k >= 0:
        l1 = phase[k] * SPEED_OF_LIGHT_M_S / f1 + _or_zero(phase_bias[k])
        l2 = phase[m] * SPEED_OF_LIGHT_M_S / f2 + _or_zero(phase_bias[m])
        _combine_phases(pair, l1, l2, c1, c2)
        pair.signal_1, pair.signal_2 = signal[k], signal[m]
        pair.discontinuity_1, pair.discontinuity_2 = discontinuity[k], discontinuity[m]
        pair.half_cycle = half_cycle[k] + 2 * half_cycle[m]
        pair.lost_lock = lost[k] or lost[m]
        pair.lock_time_s = np.minimum(lock_time[k], lock_time[m])


@njit(cache=True)
def _pair_up(satellite, rows, arcs, wanted_systems, pairs):  # type: ignore[no-untyped-def]
    """Fill ``pairs`` (room for one a satellite) from the systems wanted; returns how many were made."""
    signal, code, phase, channel, code_bias = rows[0], rows[1], rows[2], rows[7], rows[8]
    code_cost, phase_cost = _code_costs(signal, code, code_bias), _phase_costs(signal, phase)
    made, first, arc = 0, 0, 0
    while first < satellite.size:
        last = first
        while last < satellite.size and satellite[last] == satellite[first]:
            last += 1
        system = satellite[first] // SATELLITES_PER_SYSTEM
        if not wanted_systems[system]:
            first = last
            continue
        while arc < arcs.size and arcs[arc].satellite < satellite[first]:
            arc += 1
        wanted = (np.int16(-1), np.int16(-1))
        if arc < arcs.size and arcs[arc].satellite == satellite[first]:
            wanted = (arcs[arc].signal_1, arcs[arc].signal_2)
        k, m = _phase_rows(first, last, system, wanted, signal, code_cost, phase_cost)
        if k >= 0:
            i, j = _codes_of(first, last, k, m, signal, code_cost)
        else:
            i, j = _code_rows(first, last, system, signal, code_cost)
        if i >= 0 and (system != _GLONASS or -7 <= channel[first] <= 6):
            pairs[made].satellite, pairs[made].system = satellite[first], system
            _fill_pair(pairs[made], i, j, k, m, rows)
            made += 1
        first = last
    return made


@lru_cache(maxsize=64)
def wanted_systems(letters: str) -> NDArray[np.bool_]:
    """Whether a system number is among RINEX letters, (systems,)."""
    wanted = np.zeros(len(System), np.bool_)
    for letter in letters:
        wanted[system_of_letter(letter)] = True
    return wanted


def signal_pairs(
    epoch: Epoch, channel: NDArray[np.int8], biases: SignalBiases, arcs: Records, systems: str = SYSTEM_LETTERS
) -> Records:
    """One record (``PAIR_DTYPE``) for each satellite with a usable code, ordered by satellite.

    ``channel`` (n,) are the GLONASS channels of the epoch's rows, ``biases`` those of its rows; a GLONASS satellite
    without its channel gives none, nor does one of a system that is not among the letters of ``systems``.
    """
    n = epoch.satellite.size
    pairs = np.zeros(n, PAIR_DTYPE)
    lost = epoch.loss_of_lock if epoch.loss_of_lock is not None else np.zeros(n, np.bool_)
    rows = (
        epoch.signal, epoch.pseudorange_m, epoch.carrier_phase_cycles, epoch.cn0_db_hz, epoch.lock_time_s,
        epoch.half_cycle_ambiguous, lost, channel, biases.code_m, biases.phase_m,
        np.ascontiguousarray(biases.discontinuity),
    )  # fmt: skip
    return pairs[: _pair_up(epoch.satellite, rows, arcs, wanted_systems(systems), pairs)]
