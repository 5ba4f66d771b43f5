"""Legacy observations, 1001–1004 (GPS) and 1009–1012 (GLONASS), as tables and as arrays (RTCM 10403.3, section 3.5.1).

The L1 pseudorange comes modulo a light-millisecond (GLONASS: two); the extended messages (1002, 1004, 1010, 1012) add
the number of those. Everything else is a difference to it: the phases, which jump by 1500 cycles where the difference
would leave its field (see :func:`plumbline.rtcm3.observations.unroll_legacy_phase`), and the L2 pseudorange.
"""

import math
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from plumbline.constants import LIGHT_MILLISECOND_M, SPEED_OF_LIGHT_M_S
from plumbline.errors import ContractError
from plumbline.records import UNKNOWN_CHANNEL, Floats
from plumbline.rtcm3.fields import (
    Fields,
    Group,
    Item,
    Malformed,
    Table,
    decode_table,
    encode_table,
    flag,
    signed,
    unsigned,
)
from plumbline.rtcm3.msm_layout import DAY_MS, LEAP_SECOND_MS, WEEK_MS
from plumbline.rtcm3.observations import Observations
from plumbline.signals import (
    CHANNEL_STEP_HZ,
    FREQUENCY_HZ,
    System,
    number_of,
    satellite_id,
    signal_code,
    signal_id,
    system_of,
)

_NO_PHASE: Final = -(1 << 19)  # DF012, DF018; the L1 pseudorange is then not valid either
_NO_DIFFERENCE: Final = -(1 << 13)  # DF017
_SBAS_OFFSET: Final = 39  # PRN 120 is satellite 40 here and 1 in MSM
_CODES: Final[dict[tuple[System, int], tuple[str, ...]]] = {  # RINEX codes of the code indicators of L1 and L2
    (System.GPS, 1): ("1C", "1P"),
    (System.GPS, 2): ("2X", "2P", "2W", "2W"),  # C/A or L2C, P(Y) direct, cross-correlated, correlated
    (System.GLONASS, 1): ("1C", "1P"),
    (System.GLONASS, 2): ("2C", "2P"),
}
_INDICATORS: Final = {
    "1C": 0, "1P": 1, "1W": 1, "1S": 0, "1L": 0, "1X": 0, "2C": 0, "2S": 0, "2L": 0, "2X": 0, "2P": 1, "2W": 3,
}  # fmt: skip


def _table(number: int) -> Table:
    glonass = number >= 1009
    kind = number - (1009 if glonass else 1001)  # bit 0: extended, bit 1: L2 too
    rows: list[Item] = [unsigned("DF038" if glonass else "DF009", "satellite", 6), unsigned("DF010", "code_1", 1)]
    if glonass:
        rows.append(unsigned("DF040", "channel", 5, offset=-7))
    rows += [
        unsigned("DF041" if glonass else "DF011", "pseudorange_1_m", 25 if glonass else 24, 0.02),
        signed("DF012", "phase_1_m", 20, 0.0005, sentinel=_NO_PHASE),
        unsigned("DF013", "lock_1", 7),
    ]
    if kind & 1:
        rows.append(unsigned("DF044" if glonass else "DF014", "ambiguity", 7 if glonass else 8))
        rows.append(unsigned("DF015", "cn0_1_db_hz", 8, 0.25, sentinel=0))
    if kind & 2:
        rows += [
            unsigned("DF016", "code_2", 2),
            signed("DF017", "difference_2_m", 14, 0.02, sentinel=_NO_DIFFERENCE),
            signed("DF018", "phase_2_m", 20, 0.0005, sentinel=_NO_PHASE),
            unsigned("DF019", "lock_2", 7),
        ]
        if kind & 1:
            rows.append(unsigned("DF020", "cn0_2_db_hz", 8, 0.25, sentinel=0))
    header: tuple[Item, ...] = (
        unsigned("DF003", "station", 12),
        unsigned("DF034" if glonass else "DF004", "epoch_ms", 27 if glonass else 30),
        flag("DF005", "multiple_message"),
        unsigned("DF006", "n_satellites", 5),
        flag("DF007", "smoothing"),
        unsigned("DF008", "smoothing_interval", 3),
    )
    return Table(number, "legacy observations", (*header, Group("satellites", "n_satellites", tuple(rows))))


LEGACY_TABLES: Final = {number: _table(number) for number in (*range(1001, 1005), *range(1009, 1013))}
_COLUMNS: Final = 5  # pseudorange, phase range, carrier to noise, lock, channel


def _system(number: int) -> System:
    return System.GLONASS if number >= 1009 else System.GPS


def _modulus_m(system: System) -> float:
    return LIGHT_MILLISECOND_M * (2 if system is System.GLONASS else 1)


def _is_extended(number: int) -> bool:
    return number in (1002, 1004, 1010, 1012)


def least_lock_s(code: int) -> int:
    """The least lock time, s, of the legacy indicator (DF013, table 3.4-2)."""
    for first, factor, offset in (
        (24, 1, 0),
        (48, 2, 24),
        (72, 4, 120),
        (96, 8, 408),
        (120, 16, 1176),
        (127, 32, 3096),
    ):
        if code < first:
            return code * factor - offset
    return 937


def _lock_code(lock_s: float) -> int:
    return max((code for code in range(128) if least_lock_s(code) <= lock_s), default=0)


def decode_legacy(number: int, payload: bytes) -> Observations | Malformed:
    """Decode a payload whose number is one of :data:`LEGACY_TABLES`."""
    message = decode_table(LEGACY_TABLES[number], payload)
    if isinstance(message, Malformed):
        return message
    fields = message.fields
    system = _system(number)
    if fields["epoch_ms"] > (DAY_MS if system is System.GLONASS else WEEK_MS) + LEAP_SECOND_MS:
        return Malformed(number, "epoch_out_of_range")
    rows = sorted(row for satellite in fields["satellites"] for row in _rows_of(number, system, satellite))
    satellite = np.array([row[0] for row in rows], dtype=np.int16)
    signal = np.array([row[1] for row in rows], dtype=np.int16)
    if np.any((np.diff(satellite) == 0) & (np.diff(signal) == 0)):
        return Malformed(number, "repeated_satellite")
    values = np.array([row[2:] for row in rows], dtype=np.float64).reshape(-1, _COLUMNS).T
    return _observations(number, system, fields, satellite, signal, values)


def _rows_of(number: int, system: System, fields: Fields) -> Iterator[tuple[float, ...]]:
    """Rows of one satellite: ids, then the columns. None for satellites that the numbering does not define."""
    satellite = _satellite(system, fields["satellite"])
    phase_1, base = fields["phase_1_m"], fields["pseudorange_1_m"]
    if satellite is None:
        return
    if _is_extended(number):
        base += fields["ambiguity"] * _modulus_m(system)
    own = system_of(satellite)
    channel = fields.get("channel", 0)
    if phase_1 is not None:
        code = _CODES[system, 1][fields["code_1"]] if own is system else "1C"
        yield _row(satellite, own, code, base, base + phase_1, fields.get("cn0_1_db_hz"), fields["lock_1"], channel)
    if own is not system or "lock_2" not in fields or fields["code_2"] >= len(_CODES[system, 2]):
        return
    difference, phase_2 = fields["difference_2_m"], fields["phase_2_m"]
    if difference is None and phase_2 is None:
        return
    code_m = math.nan if difference is None else base + difference
    phase_m = math.nan if phase_2 is None else base + phase_2
    code = _CODES[system, 2][fields["code_2"]]
    yield _row(satellite, own, code, code_m, phase_m, fields.get("cn0_2_db_hz"), fields["lock_2"], channel)


def _row(
    satellite: int, system: System, code: str, code_m: float, phase_m: float, cn0: float | None, lock: int, channel: int
) -> tuple[float, ...]:
    signal = signal_id(system, code)
    assert signal is not None
    known = channel if -7 <= channel <= 6 else UNKNOWN_CHANNEL
    return satellite, signal, code_m, phase_m, math.nan if cn0 is None else cn0, least_lock_s(lock), known


def _satellite(system: System, number: int) -> int | None:
    if 1 <= number <= 32:
        return satellite_id(system, number)
    if system is System.GPS and 40 <= number <= 58:
        return satellite_id(System.SBAS, number - _SBAS_OFFSET)
    return None


def _observations(
    number: int, system: System, fields: Fields, satellite: Any, signal: Any, values: Floats
) -> Observations:
    code, phase, cn0, lock, channel = values
    known = np.where(channel == UNKNOWN_CHANNEL, np.nan, channel)
    frequency_hz = FREQUENCY_HZ[signal] + np.where(CHANNEL_STEP_HZ[signal] > 0, CHANNEL_STEP_HZ[signal] * known, 0.0)
    missing = np.full(satellite.size, np.nan)
    ambiguous = not _is_extended(number)
    return Observations(
        number=number,
        system=system,
        station=fields["station"],
        epoch_ms=fields["epoch_ms"],
        day_of_week=None,
        multiple_message=fields["multiple_message"],
        iods=0,
        clock_steering=0,
        external_clock=0,
        smoothing=fields["smoothing"],
        smoothing_interval=fields["smoothing_interval"],
        satellite=satellite,
        signal=signal,
        pseudorange_m=missing if ambiguous else code,
        phase_range_m=missing if ambiguous else phase,
        carrier_phase_cycles=missing if ambiguous else phase * (frequency_hz / SPEED_OF_LIGHT_M_S),
        phase_range_rate_m_s=missing,
        doppler_hz=missing,
        cn0_db_hz=cn0,
        lock_time_s=lock,
        half_cycle_ambiguous=np.zeros(satellite.size, dtype=np.bool_),
        glonass_channel=channel.astype(np.int8),
        range_modulus_m=_modulus_m(system) if ambiguous else 0.0,
        pseudorange_modulo_m=code if ambiguous else None,
        phase_range_modulo_m=phase if ambiguous else None,
    )


# --------------------------------------------------------------------------------------------- encoding


def encode_legacy(message: Observations) -> bytes:
    """The payload of legacy observations; raises :class:`ContractError` for what the message cannot hold.

    A satellite needs its L1 code: without it, and for L1 rows without a phase, the format has no place.
    """
    system = _system(message.number)
    ambiguous = message.pseudorange_modulo_m is not None and message.phase_range_modulo_m is not None
    code = message.pseudorange_modulo_m if ambiguous else message.pseudorange_m
    phase = message.phase_range_modulo_m if ambiguous else message.phase_range_m
    assert code is not None
    assert phase is not None
    satellites: dict[int, dict[str, Any]] = {}
    for i in np.lexsort((message.signal, message.satellite)).tolist():
        satellite = int(message.satellite[i])
        own = satellites.setdefault(satellite, _empty_satellite(satellite, system, int(message.glonass_channel[i])))
        row = {"lock": _lock_code(float(message.lock_time_s[i])), "cn0_db_hz": float(message.cn0_db_hz[i]) or None}
        _put_row(own, signal_code(int(message.signal[i])), float(code[i]), float(phase[i]), row)
    header = {"station": message.station, "epoch_ms": message.epoch_ms, "multiple_message": message.multiple_message}
    smoothing = {"smoothing": message.smoothing, "smoothing_interval": message.smoothing_interval}
    entries = tuple(_differences(own, message.number, system) for own in satellites.values())
    return encode_table(LEGACY_TABLES[message.number], {**header, **smoothing, "satellites": entries})


def _empty_satellite(satellite: int, system: System, channel: int) -> dict[str, Any]:
    own = system_of(satellite)
    if own not in (system, System.SBAS) or (own is System.SBAS and system is System.GLONASS):
        raise ContractError(f"a satellite of {own.name} in a legacy message of {system.name}")
    number = number_of(satellite) + (_SBAS_OFFSET if own is System.SBAS else 0)
    return {
        "satellite": number,
        "channel": 13 if channel == UNKNOWN_CHANNEL else channel,
        **{"code_1": 0, "phase_1_m": None, "lock_1": 0, "cn0_1_db_hz": None},
        **{"code_2": 0, "difference_2_m": None, "phase_2_m": None, "lock_2": 0, "cn0_2_db_hz": None},
    }


def _put_row(own: dict[str, Any], code: str, code_m: float, phase_m: float, row: Fields) -> None:
    band = code[:1]
    if code not in _INDICATORS or f"absolute_{band}" in own:
        raise ContractError(f"no place for signal {code!r} in a legacy message")
    own[f"absolute_{band}"] = (code_m, phase_m)
    own[f"code_{band}"] = _INDICATORS[code]
    own[f"lock_{band}"] = row["lock"]
    own[f"cn0_{band}_db_hz"] = row["cn0_db_hz"]


def _differences(own: dict[str, Any], number: int, system: System) -> dict[str, Any]:
    """Absolute ranges to the message's own terms."""
    code_1, phase_1 = own.get("absolute_1", (math.nan, math.nan))
    code_2, phase_2 = own.get("absolute_2", (math.nan, math.nan))
    base = code_1 if math.isfinite(code_1) else code_2
    if not math.isfinite(base):
        raise ContractError(f"satellite {own['satellite']} has no pseudorange")
    own["ambiguity"] = math.floor(base / _modulus_m(system)) if _is_extended(number) else 0
    own["pseudorange_1_m"] = base - own["ambiguity"] * _modulus_m(system)
    base = round(own["pseudorange_1_m"] / 0.02) * 0.02 + own["ambiguity"] * _modulus_m(system)
    own["phase_1_m"] = phase_1 - base if math.isfinite(code_1) else None
    own["difference_2_m"] = code_2 - base
    own["phase_2_m"] = phase_2 - base
    if system is System.GLONASS and own["code_2"] == 3:
        own["code_2"] = 1
    return own
