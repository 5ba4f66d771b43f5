"""Arrays to Multiple Signal Messages, rounded to the standard's resolution (RTCM 10403.3, section 3.5.16)."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plumbline.constants import BDT_BEHIND_GPST_S, GLONASS_TIME_AHEAD_OF_UTC_S, SPEED_OF_LIGHT_M_S
from plumbline.errors import ContractError
from plumbline.gps_time import NS_PER_MS, NS_PER_S, utc_ns_from_gps
from plumbline.records import UNKNOWN_CHANNEL, Epoch, Floats
from plumbline.rtcm3.bit_kernels import write_bits
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
    HEADER_FIELD_BITS,
    INVALID_WHOLE_MS,
    IODS,
    LOCK,
    MAX_CELLS,
    MODULO_MS,
    MSM_NUMBERS,
    PHASE_BITS_BELOW_ROUGH,
    RATE_M_S,
    RESERVED_BITS_AFTER_IODS,
    ROUGH_RANGE_M,
    ROUGH_RATE,
    UNKNOWN_CHANNEL_CODE,
    WEEK_MS,
    WHOLE_MS,
    lock_code,
    message_number_of,
)
from plumbline.rtcm3.observations import Observations
from plumbline.signals import CHANNEL_STEP_HZ, FREQUENCY_HZ, SATELLITES_PER_SYSTEM, SIGNALS_PER_SYSTEM, System

_CODE, _PHASE, _RATE, _CN0, _LOCK, _HALF, _CHANNEL = range(7)
_MAX_ROUGH_RATE: Final = 8191
_LARGEST_MESSAGE_BYTES: Final = 1023


@dataclass(frozen=True, slots=True)
class MsmHeader:
    """What stands in front of the rows: the message's kind (1–7), its time in the system's own scale, and the rest.

    ``epoch_ms`` and ``day_of_week`` as in :class:`Observations`. ``multiple_message`` tells whether more messages of
    this epoch follow the last of those that the rows make.
    """

    system: System
    kind: int
    station: int
    epoch_ms: int
    day_of_week: int | None = None
    multiple_message: bool = False
    iods: int = 0
    clock_steering: int = 0
    external_clock: int = 0
    smoothing: bool = False
    smoothing_interval: int = 0


def encode_observations(
    header: MsmHeader,
    satellite: NDArray[np.int16],
    signal: NDArray[np.int16],
    pseudorange_m: Floats,
    phase_range_m: Floats,
    phase_range_rate_m_s: Floats,
    cn0_db_hz: Floats,
    lock_time_s: Floats,
    half_cycle_ambiguous: NDArray[np.bool_],
    glonass_channel: NDArray[np.int8],
) -> list[bytes]:
    """Payloads of one system's rows, all shaped (n,) and in any order; as many as 64 cells each need, one if n is 0.

    A satellite's codes have to lie within ±292 m of their middle and its phases within ±1171 m: what does not fit is
    sent as missing (align arbitrary phases with :class:`PhaseAligner` first). Raises :class:`ContractError` for rows of
    another system and for two rows of one signal.
    """
    if np.any(satellite // SATELLITES_PER_SYSTEM != header.system) or np.any(
        signal // SIGNALS_PER_SYSTEM != header.system
    ):
        raise ContractError(f"rows of other systems in a message of {header.system.name}")
    order = np.lexsort((signal, satellite))
    numbers = satellite[order].astype(np.int64) % SATELLITES_PER_SYSTEM
    signals = signal[order].astype(np.int64) % SIGNALS_PER_SYSTEM
    if np.any((np.diff(numbers) == 0) & (np.diff(signals) == 0)):
        raise ContractError("two rows of one satellite and signal in one message")
    values = np.empty((7, order.size))
    for row, column in enumerate(
        (
            pseudorange_m,
            phase_range_m,
            phase_range_rate_m_s,
            cn0_db_hz,
            lock_time_s,
            half_cycle_ambiguous,
            glonass_channel,
        )
    ):
        values[row] = column[order]
    parts = list(_parts(numbers, signals))
    payloads = []
    for i, (start, end) in enumerate(parts):
        fields = _header_fields(header, multiple=header.multiple_message or i + 1 < len(parts))
        number = message_number_of(header.kind, header.system)
        is_glonass = header.system is System.GLONASS
        data, bits = _encode(
            number,
            header.kind,
            is_glonass,
            fields,
            numbers[start:end],
            signals[start:end],
            np.ascontiguousarray(values[:, start:end]),  # one layout, one compiled kernel
        )
        payloads.append(data[: (bits + 7) // 8].tobytes())
    return payloads


def _header_fields(header: MsmHeader, multiple: bool) -> NDArray[np.int64]:
    epoch = header.epoch_ms
    if header.system is System.GLONASS:
        epoch |= (7 if header.day_of_week is None else header.day_of_week) << 27
    flags = (int(multiple), header.iods, header.clock_steering, header.external_clock, int(header.smoothing))
    fields = np.array((header.station, epoch, *flags, header.smoothing_interval), dtype=np.int64)
    if np.any(fields < 0) or np.any(fields >> HEADER_FIELD_BITS):
        raise ContractError(f"a header field does not fit: {header}")
    return fields


def _parts(numbers: NDArray[np.int64], signals: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
    """Split sorted rows between satellites so that satellites × signals never exceeds 64."""
    starts = np.flatnonzero(np.diff(numbers, prepend=-1)).tolist()
    ends = [*starts[1:], numbers.size][: len(starts)]
    begin, n_satellites, used = 0, 0, set[int]()
    for start, end in zip(starts, ends, strict=True):
        own = set(signals[start:end].tolist())
        if n_satellites and (n_satellites + 1) * len(used | own) > MAX_CELLS:
            yield begin, start
            begin, n_satellites, used = start, 0, set()
        n_satellites += 1
        used |= own
    yield begin, int(numbers.size)


def encode_msm(message: Observations) -> bytes:
    """The payload of a decoded MSM, values unchanged; raises :class:`ContractError` if it needs more than one."""
    kind_system = MSM_NUMBERS.get(message.number)
    if kind_system is None:
        raise ContractError(f"{message.number} is no MSM")
    modulo = message.pseudorange_modulo_m is not None and message.phase_range_modulo_m is not None
    header = MsmHeader(
        message.system,
        kind_system[0],
        message.station,
        message.epoch_ms,
        message.day_of_week,
        message.multiple_message,
        message.iods,
        message.clock_steering,
        message.external_clock,
        message.smoothing,
        message.smoothing_interval,
    )
    code = message.pseudorange_modulo_m if modulo else message.pseudorange_m
    phase = message.phase_range_modulo_m if modulo else message.phase_range_m
    assert code is not None
    assert phase is not None
    rows = (message.phase_range_rate_m_s, message.cn0_db_hz, message.lock_time_s, message.half_cycle_ambiguous)
    payloads = encode_observations(
        header, message.satellite, message.signal, code, phase, *rows, message.glonass_channel
    )
    if len(payloads) != 1:
        raise ContractError(f"{message.n_rows} rows need {len(payloads)} messages")
    return payloads[0]


def system_epoch(system: System, t_gps_ns: int) -> tuple[int, int | None]:
    """A GPS time in a system's own MSM scale: ms of the week, or for GLONASS of the day with its day of week."""
    if system is System.GLONASS:
        t_ms = round((utc_ns_from_gps(t_gps_ns) + GLONASS_TIME_AHEAD_OF_UTC_S * NS_PER_S) / NS_PER_MS) % WEEK_MS
        return t_ms % DAY_MS, t_ms // DAY_MS
    behind_ns = BDT_BEHIND_GPST_S * NS_PER_S if system is System.BEIDOU else 0
    return (t_gps_ns - behind_ns + NS_PER_MS // 2) // NS_PER_MS % WEEK_MS, None


def encode_epoch(epoch: Epoch, kind: int, station: int, iods: int = 0) -> list[bytes]:
    """Payloads of a whole epoch, system by system; the multiple-message bit clears on the last alone."""
    frequency_hz = FREQUENCY_HZ[epoch.signal]
    known = np.where(epoch.glonass_channel == UNKNOWN_CHANNEL, np.nan, epoch.glonass_channel)
    steps = CHANNEL_STEP_HZ[epoch.signal]
    wavelength_m = SPEED_OF_LIGHT_M_S / (frequency_hz + np.where(steps > 0, steps * known, 0.0))
    systems = epoch.satellite // SATELLITES_PER_SYSTEM
    present = [System(s) for s in np.unique(systems).tolist()]
    payloads = []
    for system in present:
        rows = systems == system
        epoch_ms, day = system_epoch(system, epoch.t_gps_ns)
        header = MsmHeader(system, kind, station, epoch_ms, day, system is not present[-1], iods)
        payloads += encode_observations(
            header,
            epoch.satellite[rows],
            epoch.signal[rows],
            epoch.pseudorange_m[rows],
            (epoch.carrier_phase_cycles * wavelength_m)[rows],
            (-epoch.doppler_hz * wavelength_m)[rows],
            epoch.cn0_db_hz[rows],
            epoch.lock_time_s[rows],
            epoch.half_cycle_ambiguous[rows],
            epoch.glonass_channel[rows],
        )
    return payloads


# --------------------------------------------------------------------------------------------- kernels


@njit(cache=True)
def _encode(
    number: int,
    kind: int,
    is_glonass: bool,
    header: NDArray[np.int64],
    numbers: NDArray[np.int64],
    signals: NDArray[np.int64],
    values: Floats,
) -> tuple[NDArray[np.uint8], int]:
    """One message's bytes and bits; rows sorted by satellite number (0…63), then signal (0…31)."""
    data = np.zeros(_LARGEST_MESSAGE_BYTES + 8, dtype=np.uint8)
    bits = COLUMN_BITS[kind]
    at = write_bits(data, 0, 12, number)
    for i in range(header.size):
        at = write_bits(data, at, HEADER_FIELD_BITS[i], header[i])
        at += RESERVED_BITS_AFTER_IODS if i == IODS else 0
    first_row, at = _write_masks(data, at, numbers, signals)
    n_satellites = first_row.size - 1
    rough = np.empty(n_satellites, dtype=np.int64)
    rough_rate = np.empty(n_satellites, dtype=np.int64)
    for i in range(n_satellites):
        start, end = first_row[i], first_row[i + 1]
        rough[i] = _rough_range(values, start, end)
        rate = _middle(values[_RATE, start:end])
        rough_rate[i] = round(rate) if abs(rate) <= _MAX_ROUGH_RATE else -_MAX_ROUGH_RATE - 1
    at = _write_satellites(data, at, bits, is_glonass, rough, rough_rate, values[_CHANNEL], first_row)
    at = _write_cells(data, at, bits, rough, rough_rate, first_row, values)
    return data, at


@njit(cache=True)
def _write_masks(
    data: NDArray[np.uint8], at: int, numbers: NDArray[np.int64], signals: NDArray[np.int64]
) -> tuple[NDArray[np.int64], int]:
    """Satellite, signal and cell mask; returns each satellite's first row (and the end), and the bit behind them."""
    column = np.full(SIGNALS_PER_SYSTEM, -1, dtype=np.int64)
    for i in range(signals.size):
        column[signals[i]] = 0
    n_signals = 0
    for j in range(SIGNALS_PER_SYSTEM):
        if column[j] == 0:
            column[j] = n_signals
            n_signals += 1
            write_bits(data, at + SATELLITES_PER_SYSTEM + j, 1, 1)
    cells_at = at + SATELLITES_PER_SYSTEM + SIGNALS_PER_SYSTEM
    first_row = np.empty(numbers.size + 1, dtype=np.int64)
    n_satellites = 0
    for i in range(numbers.size):
        if i == 0 or numbers[i] != numbers[i - 1]:
            write_bits(data, at + numbers[i], 1, 1)
            first_row[n_satellites] = i
            n_satellites += 1
        write_bits(data, cells_at + (n_satellites - 1) * n_signals + column[signals[i]], 1, 1)
    first_row[n_satellites] = numbers.size
    return first_row[: n_satellites + 1], cells_at + n_satellites * n_signals


@njit(cache=True)
def _middle(values: Floats) -> float:
    """Half-way between the least and the greatest; NaN if all are."""
    low, high = np.inf, -np.inf
    for value in values:
        if not np.isnan(value):
            low, high = min(low, value), max(high, value)
    return 0.5 * (low + high) if low <= high else np.nan


@njit(cache=True)
def _rough_range(values: Floats, start: int, end: int) -> int:
    """A satellite's rough range, 2⁻¹⁰ ms: amid its codes, or without any its phases; −1 for none."""
    range_m = _middle(values[_CODE, start:end])
    if np.isnan(range_m):
        range_m = _middle(values[_PHASE, start:end])
    rough = range_m / ROUGH_RANGE_M
    return round(rough) if -0.5 < rough < (INVALID_WHOLE_MS << 10) - 0.5 else -1


@njit(cache=True)
def _write_satellites(
    data: NDArray[np.uint8],
    at: int,
    bits: NDArray[np.int64],
    is_glonass: bool,
    rough: NDArray[np.int64],
    rough_rate: NDArray[np.int64],
    channel: Floats,
    first_row: NDArray[np.int64],
) -> int:
    if bits[WHOLE_MS]:
        for i in range(rough.size):
            at = write_bits(data, at, bits[WHOLE_MS], rough[i] >> 10 if rough[i] >= 0 else INVALID_WHOLE_MS)
    if bits[EXTENDED]:
        for i in range(rough.size):
            code = 0
            if is_glonass:
                known = channel[first_row[i]]
                code = int(known) + CHANNEL_OFFSET if known != UNKNOWN_CHANNEL else UNKNOWN_CHANNEL_CODE
            at = write_bits(data, at, bits[EXTENDED], code)
    for i in range(rough.size):
        at = write_bits(data, at, bits[MODULO_MS], rough[i] & 0x3FF if rough[i] >= 0 else 0)
    if bits[ROUGH_RATE]:
        for i in range(rough.size):
            at = write_bits(data, at, bits[ROUGH_RATE], rough_rate[i])
    return at


@njit(cache=True)
def _write_fine(data: NDArray[np.uint8], at: int, bits: int, value: float, valid: bool) -> int:
    """A signed fine field, or its 'not available' where ``value`` is NaN or does not fit."""
    top = 1 << (bits - 1)
    rounded = -top
    if valid and abs(value) < top - 0.5:
        rounded = round(value)
    return write_bits(data, at, bits, rounded)


@njit(cache=True)
def _write_cells(
    data: NDArray[np.uint8],
    at: int,
    bits: NDArray[np.int64],
    rough: NDArray[np.int64],
    rough_rate: NDArray[np.int64],
    first_row: NDArray[np.int64],
    values: Floats,
) -> int:
    n = values.shape[1]
    phase_at = at + n * bits[FINE_CODE]
    lock_at = phase_at + n * bits[FINE_PHASE]
    half_at = lock_at + n * bits[LOCK]
    cn0_at = half_at + n * bits[HALF_CYCLE]
    rate_at = cn0_at + n * bits[CN0]
    code_shift = COARSER_CODE_SHIFT if bits[FINE_CODE] == 15 else 0
    phase_shift = COARSER_PHASE_SHIFT if bits[FINE_PHASE] == 22 else 0
    cn0_steps = 1.0 if bits[CN0] == 6 else 16.0
    for s in range(rough.size):
        valid = rough[s] >= 0
        for i in range(first_row[s], first_row[s + 1]):
            if bits[FINE_CODE]:
                fine = values[_CODE, i] / FINEST_CODE_M - (rough[s] << CODE_BITS_BELOW_ROUGH)
                _write_fine(data, at + i * bits[FINE_CODE], bits[FINE_CODE], fine / (1 << code_shift), valid)
            if bits[FINE_PHASE]:
                fine = values[_PHASE, i] / FINEST_PHASE_M - (rough[s] << PHASE_BITS_BELOW_ROUGH)
                _write_fine(data, phase_at + i * bits[FINE_PHASE], bits[FINE_PHASE], fine / (1 << phase_shift), valid)
                lock_ms = round(values[_LOCK, i] * 1e3) if values[_LOCK, i] > 0.0 else 0
                write_bits(data, lock_at + i * bits[LOCK], bits[LOCK], lock_code(lock_ms, bits[LOCK]))
                write_bits(data, half_at + i, 1, 1 if values[_HALF, i] else 0)
            if bits[CN0]:
                steps = values[_CN0, i] * cn0_steps
                code = min(round(steps), (1 << bits[CN0]) - 1) if steps > 0.0 else 0
                write_bits(data, cn0_at + i * bits[CN0], bits[CN0], code)
            if bits[FINE_RATE]:
                fine = (values[_RATE, i] - rough_rate[s]) / RATE_M_S
                _write_fine(
                    data, rate_at + i * bits[FINE_RATE], bits[FINE_RATE], fine, rough_rate[s] > -_MAX_ROUGH_RATE - 1
                )
    return int(rate_at + n * bits[FINE_RATE])
