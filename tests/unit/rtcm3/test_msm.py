"""Oracles: a plain decoder that reads bit by bit, the standard's tables, and the identity decode(encode(x)) = x."""

import math
import random
from typing import Any

import numpy as np
import pytest

from plumbline.constants import LIGHT_MILLISECOND_M, SPEED_OF_LIGHT_M_S
from plumbline.errors import ContractError
from plumbline.gps_time import gps_ns_from_calendar, resolve_bdt_tow_ms, resolve_glonass_ms, resolve_tow_ms
from plumbline.records import UNKNOWN_CHANNEL, Epoch
from plumbline.rtcm3 import Malformed, MsmHeader, Observations, decode, encode, encode_epoch, encode_observations
from plumbline.rtcm3.bits import BitReader, BitWriter
from plumbline.rtcm3.msm_layout import least_lock_ms, lock_code
from plumbline.signals import System, carrier_frequency_hz, satellite_id, signal_id

SATELLITE_COLUMNS = {4: (8, 0, 10, 0), 5: (8, 4, 10, 14), 6: (8, 0, 10, 0), 7: (8, 4, 10, 14)}
CELL_COLUMNS = {
    1: (15, 0, 0, 0, 0, 0),
    2: (0, 22, 4, 1, 0, 0),
    3: (15, 22, 4, 1, 0, 0),
    4: (15, 22, 4, 1, 6, 0),
    5: (15, 22, 4, 1, 6, 15),
    6: (20, 24, 10, 1, 10, 0),
    7: (20, 24, 10, 1, 10, 15),
}


def _random_payload(generator: random.Random, number: int) -> bytes:
    """An MSM whose every field is random, its invalid values often."""
    kind, system = number % 10, (number - 1070) // 10
    n_satellites, n_signals = generator.choice(((1, 1), (3, 2), (8, 8), (16, 4)))
    cells = [generator.random() < 0.7 for _ in range(n_satellites * n_signals)]
    writer = BitWriter()
    writer.unsigned(number, 12)
    writer.unsigned(generator.getrandbits(12), 12)
    if system == System.GLONASS:
        writer.unsigned(generator.randrange(8), 3)
        writer.unsigned(generator.randrange(86_400_000), 27)
    else:
        writer.unsigned(generator.randrange(604_800_000), 30)
    for bits in (1, 3, 7, 2, 2, 1, 3):
        writer.unsigned(generator.getrandbits(bits), bits)
    writer.unsigned(sum(1 << bit for bit in generator.sample(range(64), n_satellites)), 64)
    writer.unsigned(sum(1 << bit for bit in generator.sample(range(32), n_signals)), 32)
    for cell in cells:
        writer.unsigned(int(cell), 1)
    columns = [(bits, n_satellites) for bits in SATELLITE_COLUMNS.get(kind, (0, 0, 10, 0))]
    columns += [(bits, sum(cells)) for bits in CELL_COLUMNS[kind]]
    for bits, n in columns:
        for _ in range(n if bits else 0):
            special = generator.random() < 0.15
            value = generator.choice((1 << (bits - 1), (1 << bits) - 1)) if special else generator.getrandbits(bits)
            writer.unsigned(value, bits)
    return writer.to_bytes()


def _plain_decode(payload: bytes) -> list[dict[str, Any]]:
    """The twin: rows as dictionaries, read one bit field after the other."""
    reader = BitReader(payload)
    number = reader.unsigned(12)
    kind, system = number % 10, System((number - 1070) // 10)
    reader.unsigned(61)
    satellites = [i for i in range(64) if reader.unsigned(1)]
    signals = [i for i in range(32) if reader.unsigned(1)]
    cells = [(s, g) for s in satellites for g in signals if reader.unsigned(1)]
    whole_bits, extended_bits, modulo_bits, rate_bits = SATELLITE_COLUMNS.get(kind, (0, 0, 10, 0))

    def column(bits: int, keys: list[Any], signed: bool = False) -> dict[Any, Any]:
        if not bits:
            return dict.fromkeys(keys)
        raw = {i: reader.signed(bits) if signed else reader.unsigned(bits) for i in range(len(keys))}
        return {key: None if signed and raw[i] == -(1 << (bits - 1)) else raw[i] for i, key in enumerate(keys)}

    whole, extended = column(whole_bits, satellites), column(extended_bits, satellites)
    modulo, rough_rate = column(modulo_bits, satellites), column(rate_bits, satellites, signed=True)
    bits = CELL_COLUMNS[kind]
    code, phase = column(bits[0], cells, signed=True), column(bits[1], cells, signed=True)
    lock, half, cn0 = column(bits[2], cells), column(bits[3], cells), column(bits[4], cells)
    rate = column(bits[5], cells, signed=True)
    rows = []
    for cell in cells:
        satellite = cell[0]
        rough = math.nan if whole[satellite] == 255 else (whole[satellite] or 0) + modulo[satellite] / 1024
        code_unit, phase_unit = 2.0 ** -(24 if bits[0] == 15 else 29), 2.0 ** -(29 if bits[1] == 22 else 31)
        row: dict[str, Any] = {"satellite": system * 64 + satellite, "signal": system * 32 + cell[1]}
        row["code"] = math.nan if code[cell] is None else (rough + code[cell] * code_unit) * LIGHT_MILLISECOND_M
        row["phase"] = math.nan if phase[cell] is None else (rough + phase[cell] * phase_unit) * LIGHT_MILLISECOND_M
        missing = rough_rate[satellite] is None or rate[cell] is None
        row["rate"] = math.nan if missing else rough_rate[satellite] + 1e-4 * rate[cell]
        row["cn0"] = (cn0[cell] or math.nan) / (16 if bits[4] == 10 else 1)
        row["lock"] = math.nan if lock[cell] is None else _LOCK_MS[bits[2]](lock[cell]) / 1000
        row["half"] = bool(half[cell])
        row["channel"] = 0
        if system is System.GLONASS:
            known = extended[satellite] is not None and extended[satellite] <= 13
            row["channel"] = extended[satellite] - 7 if known else UNKNOWN_CHANNEL
        rows.append(row)
    return rows


def _df407_ms(code: int) -> float:
    """RTCM 10403.3, table 3.5-76, as it is printed: range, factor, offset."""
    if code < 64:
        return code
    for i in range(1, 21):
        if code < 64 + 32 * i:
            return (1 << i) * code - _DF407_OFFSETS[i - 1]
    return 67108864 if code == 704 else math.nan


_DF407_OFFSETS = (
    64, 256, 768, 2048, 5120, 12288, 28672, 65536, 147456, 327680, 720896, 1572864, 3407872, 7340032, 15728640,
    33554432, 71303168, 150994944, 318767104, 671088640,
)  # fmt: skip
_LOCK_MS = {4: lambda code: 0 if code == 0 else 2 ** (code + 4), 10: _df407_ms}
ALL_NUMBERS = [1070 + 10 * system + kind for system in System for kind in range(1, 8)]


@pytest.mark.parametrize("number", ALL_NUMBERS)
def test_the_kernel_agrees_with_its_plain_twin(number: int) -> None:
    generator = random.Random(number)
    for _ in range(8):
        payload = _random_payload(generator, number)
        message = decode(payload)
        assert isinstance(message, Observations)
        twin = _plain_decode(payload)
        code, phase = message.pseudorange_modulo_m, message.phase_range_modulo_m
        if number % 10 > 3:
            assert code is None
            assert phase is None
            code, phase = message.pseudorange_m, message.phase_range_m
        else:
            assert np.isnan(message.pseudorange_m).all()
            assert np.isnan(message.carrier_phase_cycles).all()
        columns: dict[str, Any] = {
            "satellite": message.satellite, "signal": message.signal, "code": code, "phase": phase,
            "rate": message.phase_range_rate_m_s, "cn0": message.cn0_db_hz, "lock": message.lock_time_s,
            "half": message.half_cycle_ambiguous, "channel": message.glonass_channel,
        }  # fmt: skip
        for name, column in columns.items():
            np.testing.assert_allclose(column, [row[name] for row in twin], rtol=1e-14, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("number", ALL_NUMBERS)
def test_encoding_keeps_every_value(number: int) -> None:
    """Where random fine fields of a satellite lie too far apart for one rough range, some come back as missing."""
    generator = random.Random(number)
    for _ in range(8):
        payload = _random_payload(generator, number)
        first = decode(payload)
        assert isinstance(first, Observations)
        once = decode(encode(first))
        assert isinstance(once, Observations)
        twice = decode(encode(once))
        assert isinstance(twice, Observations)
        for name, a, b in zip(once._fields, once, twice, strict=True):
            if isinstance(a, np.ndarray):
                np.testing.assert_array_equal(a, b, err_msg=name)
            else:
                assert a == b, name
        np.testing.assert_array_equal(first.satellite, once.satellite)
        np.testing.assert_array_equal(first.cn0_db_hz, once.cn0_db_hz)
        np.testing.assert_array_equal(np.nan_to_num(first.lock_time_s), np.nan_to_num(once.lock_time_s))
        fits = np.isfinite(once.pseudorange_m)
        np.testing.assert_array_equal(first.pseudorange_m[fits], once.pseudorange_m[fits])
        assert fits.sum() >= 0.5 * np.isfinite(first.pseudorange_m).sum()


@pytest.mark.parametrize("bits", [4, 10])
def test_lock_time_indicators(bits: int) -> None:
    top = 15 if bits == 4 else 704
    assert [least_lock_ms(code, bits) for code in range(top + 1)] == [_LOCK_MS[bits](code) for code in range(top + 1)]
    for code in range(1, top + 1):
        least = least_lock_ms(code, bits)
        assert (lock_code(least, bits), lock_code(least - 0.5, bits)) == (code, code - 1)
    assert lock_code(math.nan, bits) == lock_code(-1.0, bits) == 0


def _rows(system: System, satellites: list[int], codes: list[str], **changes: Any) -> dict[str, Any]:
    n = len(satellites) * len(codes)
    ids = [satellite_id(system, number) for number in satellites for _ in codes]
    signals = [signal_id(system, code) for _ in satellites for code in codes]
    rows: dict[str, Any] = {
        "satellite": np.array(ids, dtype=np.int16),
        "signal": np.array(signals, dtype=np.int16),
        "pseudorange_m": 2.2e7 + np.arange(n) * 0.37,
        "phase_range_m": 2.2e7 - 3.0 + np.arange(n) * 0.11,
        "phase_range_rate_m_s": np.full(n, -431.23456),
        "cn0_db_hz": np.full(n, 44.31),
        "lock_time_s": np.full(n, 12.3),
        "half_cycle_ambiguous": np.arange(n) % 3 == 0,
        "glonass_channel": np.full(n, -3 if system is System.GLONASS else 0, dtype=np.int8),
    }
    return rows | changes


def _decoded(payload: bytes) -> Observations:
    message = decode(payload)
    assert isinstance(message, Observations)
    return message


@pytest.mark.parametrize(("kind", "code_m", "phase_m"), [(4, 0.0179, 0.00056), (7, 0.00056, 0.00014)])
def test_values_are_rounded_to_the_standards_resolution(kind: int, code_m: float, phase_m: float) -> None:
    rows = _rows(System.GLONASS, [3, 9, 24], ["1C", "2P"])
    (payload,) = encode_observations(MsmHeader(System.GLONASS, kind, 77, 10_200_000, 6, iods=5), **rows)
    message = _decoded(payload)
    assert (message.number, message.station, message.epoch_ms, message.day_of_week) == (1080 + kind, 77, 10_200_000, 6)
    assert (message.iods, message.multiple_message) == (5, False)
    assert np.abs(message.pseudorange_m - rows["pseudorange_m"]).max() <= code_m / 2 * 1.001
    assert np.abs(message.phase_range_m - rows["phase_range_m"]).max() <= phase_m / 2 * 1.001
    np.testing.assert_array_equal(message.half_cycle_ambiguous, rows["half_cycle_ambiguous"])
    assert np.all(message.lock_time_s <= 12.3)
    if kind == 7:
        frequency = np.array([carrier_frequency_hz(int(s), -3) for s in message.signal])
        np.testing.assert_allclose(message.doppler_hz, 431.2346 * frequency / SPEED_OF_LIGHT_M_S, rtol=1e-12)
        cycles = message.phase_range_m * frequency / SPEED_OF_LIGHT_M_S
        np.testing.assert_allclose(message.carrier_phase_cycles, cycles, rtol=1e-15)
    else:
        assert np.isnan(message.carrier_phase_cycles).all()  # MSM4 does not tell the channel
        assert (message.glonass_channel == UNKNOWN_CHANNEL).all()


def test_missing_code_missing_phase_and_missing_satellite() -> None:
    rows = _rows(System.GALILEO, [1, 2, 3], ["1C", "5Q"])
    rows["pseudorange_m"][[0, 2, 3, 4, 5]] = np.nan
    rows["phase_range_m"][[1, 4, 5]] = np.nan
    message = _decoded(encode_observations(MsmHeader(System.GALILEO, 7, 0, 0), **rows)[0])
    np.testing.assert_array_equal(np.isnan(message.pseudorange_m), np.isnan(rows["pseudorange_m"]))
    np.testing.assert_array_equal(np.isnan(message.phase_range_m), np.isnan(rows["phase_range_m"]))


def test_a_satellite_without_a_rough_range_has_neither_code_nor_phase() -> None:
    payload = bytearray(encode_observations(MsmHeader(System.GPS, 7, 0, 0), **_rows(System.GPS, [5], ["1C"]))[0])
    at = 169 + 1  # the whole milliseconds follow the cell mask of one cell
    value = int.from_bytes(payload, "big") | 0xFF << (8 * len(payload) - at - 8)
    message = _decoded(value.to_bytes(len(payload), "big"))
    assert np.isnan([message.pseudorange_m[0], message.phase_range_m[0], message.carrier_phase_cycles[0]]).all()
    assert message.cn0_db_hz[0] == pytest.approx(44.3125)


def test_more_cells_than_64_are_malformed_and_encoding_splits_them() -> None:
    rows = _rows(System.BEIDOU, list(range(1, 41)), ["2I", "6I", "7I", "5P", "1P"])
    order = np.random.default_rng(1).permutation(200)
    shuffled = {name: column[order] for name, column in rows.items()}
    payloads = encode_observations(MsmHeader(System.BEIDOU, 7, 1, 5000), **shuffled)
    messages = [_decoded(payload) for payload in payloads]
    assert [m.multiple_message for m in messages] == [True] * (len(payloads) - 1) + [False]
    assert max(m.n_rows for m in messages) <= 64
    np.testing.assert_array_equal(np.concatenate([m.satellite for m in messages]), rows["satellite"])
    np.testing.assert_array_equal(np.concatenate([m.signal for m in messages]), rows["signal"])
    widened = bytearray(payloads[0])
    widened[9:21] = b"\xff" * 12  # all the satellites, all the signals
    assert decode(bytes(widened)) == Malformed(1127, "too_many_cells")


def test_an_empty_message_and_every_shorter_one() -> None:
    empty = _rows(System.GPS, [], ["1C"])
    (payload,) = encode_observations(MsmHeader(System.GPS, 5, 9, 123), **empty)
    message = _decoded(payload)
    assert (message.n_rows, message.station, message.epoch_ms) == (0, 9, 123)
    whole = encode_observations(MsmHeader(System.GPS, 7, 0, 0), **_rows(System.GPS, [1, 2], ["1C", "2W"]))[0]
    assert all(decode(whole[:n]) == Malformed(1077, "too_short") for n in range(2, len(whole)))


def test_an_epoch_before_the_week_is_malformed() -> None:
    """A receiver once wrote BeiDou's 14 s before the week as an unsigned number."""
    with pytest.raises(ContractError):
        encode_observations(MsmHeader(System.BEIDOU, 7, 0, -14_000), **_rows(System.BEIDOU, [6], ["2I"]))
    (payload,) = encode_observations(
        MsmHeader(System.BEIDOU, 7, 0, 2**30 - 14_000), **_rows(System.BEIDOU, [6], ["2I"])
    )
    assert decode(payload) == Malformed(1127, "epoch_out_of_range")


def test_rows_of_another_system_or_doubled_break_the_contract() -> None:
    rows = _rows(System.GPS, [1], ["1C"])
    with pytest.raises(ContractError):
        encode_observations(MsmHeader(System.GALILEO, 7, 0, 0), **rows)
    doubled = {name: np.concatenate((column, column)) for name, column in rows.items()}
    with pytest.raises(ContractError):
        encode_observations(MsmHeader(System.GPS, 7, 0, 0), **doubled)


@pytest.mark.parametrize("calendar", [(2018, 7, 14, 23, 59, 59), (2018, 7, 15, 0, 0, 5), (2026, 2, 6, 21, 0, 18)])
def test_an_epoch_goes_through_messages_of_every_system(calendar: tuple[int, ...]) -> None:
    year, month, day, hour, minute, second = calendar
    t_gps_ns = gps_ns_from_calendar(year, month, day, hour, minute, second * 10**9)
    parts = [_rows(s, [2, 7], [c]) for s, c in zip(System, ("1C", "2P", "5Q", "1C", "2L", "6I", "5A"), strict=True)]
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    channel = whole["glonass_channel"]
    frequency = np.array([carrier_frequency_hz(int(s), int(c)) for s, c in zip(whole["signal"], channel, strict=True)])
    cycles = whole["phase_range_m"] * frequency / SPEED_OF_LIGHT_M_S
    doppler = -whole["phase_range_rate_m_s"] * frequency / SPEED_OF_LIGHT_M_S
    epoch = Epoch(
        t_gps_ns, t_gps_ns, whole["satellite"], whole["signal"], whole["pseudorange_m"], cycles, doppler,
        whole["cn0_db_hz"], whole["lock_time_s"], whole["half_cycle_ambiguous"], channel,
    )  # fmt: skip
    messages = [_decoded(payload) for payload in encode_epoch(epoch, 7, 12)]
    assert [m.system for m in messages] == list(System)
    assert [m.multiple_message for m in messages] == [True] * 6 + [False]
    near = t_gps_ns + 170 * 10**9
    assert [m.t_gps_ns(near) for m in messages] == [t_gps_ns] * 7
    np.testing.assert_allclose(np.concatenate([m.carrier_phase_cycles for m in messages]), cycles, rtol=0, atol=5e-4)
    glonass, beidou = messages[System.GLONASS], messages[System.BEIDOU]
    assert resolve_glonass_ms(glonass.day_of_week, glonass.epoch_ms, near) == t_gps_ns
    assert resolve_bdt_tow_ms(beidou.epoch_ms, near) == resolve_tow_ms(messages[0].epoch_ms, near) == t_gps_ns
