"""Multiple Signal Messages 1071–1137 to arrays, one compiled call a message (RTCM 10403.3, section 3.5.16)."""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plumbline.constants import LIGHT_MILLISECOND_M, SPEED_OF_LIGHT_M_S
from plumbline.records import UNKNOWN_CHANNEL, Booleans, Floats
from plumbline.rtcm3.bit_kernels import padded, read_signed, read_unsigned
from plumbline.rtcm3.fields import Malformed
from plumbline.rtcm3.msm_layout import (
    CHANNEL_OFFSET,
    CN0,
    COARSER_CODE_SHIFT,
    COARSER_PHASE_SHIFT,
    CODE_BITS_BELOW_ROUGH,
    COLUMN_BITS,
    DAY_MS,
    EXTENDED,
    FINE_CODE,
    FINE_PHASE,
    FINE_RATE,
    FINEST_CODE_M,
    FINEST_PHASE_M,
    HALF_CYCLE,
    HEADER_BITS,
    HEADER_FIELD_BITS,
    INVALID_WHOLE_MS,
    IODS,
    LEAP_SECOND_MS,
    LOCK,
    MAX_CELLS,
    MAX_CHANNEL_CODE,
    MODULO_MS,
    MSM_NUMBERS,
    N_SATELLITE_COLUMNS,
    PHASE_BITS_BELOW_ROUGH,
    RATE_M_S,
    RESERVED_BITS_AFTER_IODS,
    ROUGH_RATE,
    WEEK_MS,
    WHOLE_MS,
    glonass_epoch,
    least_lock_ms,
)
from plumbline.rtcm3.observations import Observations
from plumbline.signals import CHANNEL_STEP_HZ, FREQUENCY_HZ, SATELLITES_PER_SYSTEM, SIGNALS_PER_SYSTEM, System

# Rows of the array of values that the kernel fills.
_CODE, _PHASE, _CYCLES, _RATE, _DOPPLER, _CN0, _LOCK = range(7)
_OK, _TOO_SHORT, _TOO_MANY_CELLS = range(3)
_REASONS: Final = ("", "too_short", "too_many_cells")
_GLONASS: Final = int(System.GLONASS)

Header = tuple[int, int, int, int, int, int, int, int]
Cells = tuple[int, Header, NDArray[np.int16], NDArray[np.int8], Booleans, Floats]


def decode_msm(number: int, payload: bytes) -> Observations | Malformed:
    """Decode an MSM payload whose number is ``number``, 1071–1137."""
    kind_system = MSM_NUMBERS.get(number)
    if kind_system is None:
        return Malformed(number, "not_an_msm")
    kind, system_id, system = kind_system
    data = np.frombuffer(payload, dtype=np.uint8)
    status, header, ids, channel, half_cycle, values = _decode(data, kind, system_id)
    if status != _OK:
        return Malformed(number, _REASONS[status])
    station, epoch, multiple, iods, steering, external, smoothing, interval = header
    glonass = system is System.GLONASS
    day_of_week, epoch_ms = glonass_epoch(epoch) if glonass else (None, epoch)
    if epoch_ms > (DAY_MS if glonass else WEEK_MS) + LEAP_SECOND_MS:
        return Malformed(number, "epoch_out_of_range")
    satellite, signal = ids
    code, phase, cycles, rate, doppler, cn0, lock = values
    modulus, code_modulo, phase_modulo = 0.0, None, None
    if kind <= 3:
        modulus, code_modulo, phase_modulo = LIGHT_MILLISECOND_M, code, phase
        code = phase = cycles = np.full(code.size, np.nan)
    return Observations(
        number,
        system,
        station,
        epoch_ms,
        day_of_week,
        multiple == 1,
        iods,
        steering,
        external,
        smoothing == 1,
        interval,
        satellite,
        signal,
        code,
        phase,
        cycles,
        rate,
        doppler,
        cn0,
        lock,
        half_cycle,
        channel,
        modulus,
        code_modulo,
        phase_modulo,
    )


@njit(cache=True)
def _decode(data: NDArray[np.uint8], kind: int, system: int) -> Cells:
    header = np.zeros(HEADER_FIELD_BITS.size, dtype=np.int64)
    satellites = np.empty(SATELLITES_PER_SYSTEM, dtype=np.int64)
    cell_satellite = np.empty(MAX_CELLS, dtype=np.int64)
    cell_signal = np.empty(MAX_CELLS, dtype=np.int64)
    size = 8 * data.size
    data = padded(data)
    status, n_satellites, n, at = _read_masks(data, size, header, satellites, cell_satellite, cell_signal)
    bits = COLUMN_BITS[kind]
    wanted = n_satellites * bits[:N_SATELLITE_COLUMNS].sum() + n * bits[N_SATELLITE_COLUMNS:].sum()
    if status == _OK and at + wanted > size:
        status = _TOO_SHORT
    if status != _OK:
        n = 0
    ids = np.empty((2, n), dtype=np.int16)
    channel = np.zeros(n, dtype=np.int8)
    half_cycle = np.zeros(n, dtype=np.bool_)
    values = np.full((7, n), np.nan)
    if n == 0:
        return status, _as_tuple(header), ids, channel, half_cycle, values
    for i in range(n):
        ids[0, i] = system * SATELLITES_PER_SYSTEM + satellites[cell_satellite[i]]
        ids[1, i] = system * SIGNALS_PER_SYSTEM + cell_signal[i]
    rough = np.empty((3, n_satellites), dtype=np.int64)
    at = _read_satellites(data, at, bits, system, rough)
    _read_cells(data, at, bits, cell_satellite, rough, half_cycle, values)
    for i in range(n):
        channel[i] = rough[2, cell_satellite[i]]
        frequency = FREQUENCY_HZ[ids[1, i]]
        if system == _GLONASS:
            frequency += channel[i] * CHANNEL_STEP_HZ[ids[1, i]] if channel[i] != UNKNOWN_CHANNEL else np.nan
        values[_CYCLES, i] = values[_PHASE, i] * (frequency / SPEED_OF_LIGHT_M_S)
        values[_DOPPLER, i] = -values[_RATE, i] * (frequency / SPEED_OF_LIGHT_M_S)
    return status, _as_tuple(header), ids, channel, half_cycle, values


@njit(cache=True)
def _as_tuple(header: NDArray[np.int64]) -> Header:
    """Header fields in the order of HEADER_FIELD_BITS, as plain integers."""
    return header[0], header[1], header[2], header[3], header[4], header[5], header[6], header[7]


@njit(cache=True)
def _read_masks(
    data: NDArray[np.uint8],
    size: int,
    header: NDArray[np.int64],
    satellites: NDArray[np.int64],
    cell_satellite: NDArray[np.int64],
    cell_signal: NDArray[np.int64],
) -> tuple[int, int, int, int]:
    """Header and masks of ``size`` bits: status, number of satellites, of cells, the bit behind. Cells by satellite."""
    if size < HEADER_BITS:
        return _TOO_SHORT, 0, 0, 0
    at = 12
    for i in range(HEADER_FIELD_BITS.size):
        header[i] = read_unsigned(data, at, HEADER_FIELD_BITS[i])
        at += HEADER_FIELD_BITS[i] + (RESERVED_BITS_AFTER_IODS if i == IODS else 0)
    signals = np.empty(SIGNALS_PER_SYSTEM, dtype=np.int64)
    n_satellites = _set_bits(data, at, SATELLITES_PER_SYSTEM, satellites)
    at += SATELLITES_PER_SYSTEM
    n_signals = _set_bits(data, at, SIGNALS_PER_SYSTEM, signals)
    at += SIGNALS_PER_SYSTEM
    if n_satellites * n_signals > MAX_CELLS:
        return _TOO_MANY_CELLS, 0, 0, at
    if at + n_satellites * n_signals > size:
        return _TOO_SHORT, 0, 0, at
    n = 0
    for i in range(n_satellites):
        for j in range(n_signals):
            if read_unsigned(data, at, 1):
                cell_satellite[n] = i
                cell_signal[n] = signals[j]
                n += 1
            at += 1
    return _OK, n_satellites, n, at


@njit(cache=True)
def _set_bits(data: NDArray[np.uint8], at: int, bits: int, found: NDArray[np.int64]) -> int:
    """Places of the set bits of a mask; returns how many."""
    n = 0
    for half in range(bits // 32):
        word = read_unsigned(data, at + 32 * half, 32)
        if word == 0:
            continue
        for i in range(32):
            if (word >> (31 - i)) & 1:
                found[n] = 32 * half + i
                n += 1
    return n


@njit(cache=True)
def _read_satellites(
    data: NDArray[np.uint8], at: int, bits: NDArray[np.int64], system: int, rough: NDArray[np.int64]
) -> int:
    """Rough ranges (2⁻¹⁰ ms, −1 invalid), rough rates (m/s) and channels by satellite; returns the bit behind them."""
    n = rough.shape[1]
    extended_at = at + n * bits[WHOLE_MS]
    modulo_at = extended_at + n * bits[EXTENDED]
    rate_at = modulo_at + n * bits[MODULO_MS]
    for i in range(n):
        whole_ms = read_unsigned(data, at + i * bits[WHOLE_MS], bits[WHOLE_MS]) if bits[WHOLE_MS] else 0
        modulo = read_unsigned(data, modulo_at + i * bits[MODULO_MS], bits[MODULO_MS])
        rough[0, i] = -1 if whole_ms == INVALID_WHOLE_MS else (whole_ms << 10) | modulo
        rough[1, i] = _INVALID
        if bits[ROUGH_RATE]:
            rough[1, i] = _signed_or_invalid(data, rate_at + i * bits[ROUGH_RATE], bits[ROUGH_RATE])
        rough[2, i] = UNKNOWN_CHANNEL if system == _GLONASS else 0
        if system == _GLONASS and bits[EXTENDED]:
            code = read_unsigned(data, extended_at + i * bits[EXTENDED], bits[EXTENDED])
            rough[2, i] = code - CHANNEL_OFFSET if code <= MAX_CHANNEL_CODE else UNKNOWN_CHANNEL
    return int(rate_at + n * bits[ROUGH_RATE])


_INVALID: Final = -(1 << 62)


@njit(cache=True)
def _signed_or_invalid(data: NDArray[np.uint8], at: int, bits: int) -> int:
    """A signed field, whose most negative value means "not available"."""
    value = read_signed(data, at, bits)
    return _INVALID if value == -(1 << (bits - 1)) else value


@njit(cache=True)
def _read_cells(
    data: NDArray[np.uint8],
    at: int,
    bits: NDArray[np.int64],
    cell_satellite: NDArray[np.int64],
    rough: NDArray[np.int64],
    half_cycle: Booleans,
    values: Floats,
) -> None:
    n = half_cycle.size
    phase_at = at + n * bits[FINE_CODE]
    lock_at = phase_at + n * bits[FINE_PHASE]
    half_at = lock_at + n * bits[LOCK]
    cn0_at = half_at + n * bits[HALF_CYCLE]
    rate_at = cn0_at + n * bits[CN0]
    code_shift = COARSER_CODE_SHIFT if bits[FINE_CODE] == 15 else 0
    phase_shift = COARSER_PHASE_SHIFT if bits[FINE_PHASE] == 22 else 0
    cn0_unit = 1.0 if bits[CN0] == 6 else 0.0625
    for i in range(n):
        rough_range, rough_rate = rough[0, cell_satellite[i]], rough[1, cell_satellite[i]]
        if bits[FINE_CODE] and rough_range >= 0:
            fine = _signed_or_invalid(data, at + i * bits[FINE_CODE], bits[FINE_CODE])
            if fine != _INVALID:
                values[_CODE, i] = ((rough_range << CODE_BITS_BELOW_ROUGH) + (fine << code_shift)) * FINEST_CODE_M
        if bits[FINE_PHASE] and rough_range >= 0:
            fine = _signed_or_invalid(data, phase_at + i * bits[FINE_PHASE], bits[FINE_PHASE])
            if fine != _INVALID:
                values[_PHASE, i] = ((rough_range << PHASE_BITS_BELOW_ROUGH) + (fine << phase_shift)) * FINEST_PHASE_M
        if bits[LOCK]:
            lock_ms = least_lock_ms(read_unsigned(data, lock_at + i * bits[LOCK], bits[LOCK]), bits[LOCK])
            values[_LOCK, i] = lock_ms * 1e-3 if lock_ms >= 0 else np.nan
            half_cycle[i] = read_unsigned(data, half_at + i, 1) == 1
        if bits[CN0]:
            cn0 = read_unsigned(data, cn0_at + i * bits[CN0], bits[CN0])
            values[_CN0, i] = cn0 * cn0_unit if cn0 else np.nan
        if bits[FINE_RATE] and rough_rate != _INVALID:
            fine = _signed_or_invalid(data, rate_at + i * bits[FINE_RATE], bits[FINE_RATE])
            if fine != _INVALID:
                values[_RATE, i] = (rough_rate * 10_000 + fine) * RATE_M_S
