"""SSR records → messages, for the converter and the simulator: the inverse of :mod:`plumbline.epochs.translate_ssr`.

A record of several systems gives messages of each; one that would outgrow a frame is split, all parts but the last
saying that more follows.
"""

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from plumbline.constants import BDT_BEHIND_GPST_S, GLONASS_TIME_AHEAD_OF_UTC_S
from plumbline.errors import ContractError
from plumbline.gps_time import DAY_NS, NS_PER_S, WEEK_NS, utc_ns_from_gps
from plumbline.records import (
    Booleans,
    SsrClock,
    SsrCodeBias,
    SsrCorrection,
    SsrHeader,
    SsrOrbit,
    SsrPhaseBias,
    SsrUra,
    SsrVtec,
)
from plumbline.rtcm3 import igs_ssr
from plumbline.rtcm3.fields import Message
from plumbline.rtcm3.ssr import MESSAGES, UPDATE_INTERVALS_S, VTEC, SsrKind
from plumbline.rtcm3.ssr_signals import identifier_of_signal
from plumbline.signals import SATELLITES_PER_SYSTEM, System, number_of

_FRAME_BITS: Final = 8 * 1023
_HEADER_BITS: Final = 96
_MOST_SATELLITES: Final = 63
#: Upper bounds of a satellite's bits by kind, and of a bias's.
_SATELLITE_BITS: Final = {
    SsrKind.ORBIT: 160,
    SsrKind.CLOCK: 76,
    SsrKind.COMBINED: 230,
    SsrKind.URA: 12,
    SsrKind.HIGH_RATE_CLOCK: 28,
    SsrKind.CODE_BIAS: 11,
    SsrKind.PHASE_BIAS: 28,
}
_BIAS_BITS: Final = {SsrKind.CODE_BIAS: 19, SsrKind.PHASE_BIAS: 32}
_NUMBERS: Final = {meaning: number for number, meaning in MESSAGES.items()}
_SUBTYPES: Final = {meaning: subtype for subtype, meaning in igs_ssr.SUBTYPES.items()}

_Row = dict[str, Any]


def messages_from_correction(correction: SsrCorrection, *, igs: bool = False) -> list[Message]:
    """The messages that carry a correction, RTCM's or (``igs``) 4076; raises ContractError for what no field can hold.

    Biases of signals without an identifier in that format are left out.
    """
    if isinstance(correction, SsrVtec):
        return [_vtec_message(correction, igs=igs)]
    messages = []
    for system in System:
        mask = correction.satellite // SATELLITES_PER_SYSTEM == system
        if np.any(mask):
            kind, rows = _rows(correction, mask, igs=igs)
            messages += _messages(system, kind, correction.header, rows, _header_extras(correction), igs=igs)
    return messages


def combined_messages(orbit: SsrOrbit, clock: SsrClock, *, igs: bool = False) -> list[Message]:
    """Combined orbit and clock messages (1060 and kin) of the satellites that both records hold."""
    messages = []
    of_clock = {int(s): k for k, s in enumerate(clock.satellite)}
    for system in System:
        mask = (orbit.satellite // SATELLITES_PER_SYSTEM == system) & np.isin(orbit.satellite, clock.satellite)
        if not np.any(mask):
            continue
        rows = [row | _clock_row(clock, of_clock[row["id"]]) for row in _orbit_rows(orbit, mask, igs=igs)]
        messages += _messages(system, SsrKind.COMBINED, orbit.header, rows, _header_extras(orbit), igs=igs)
    return messages


# --------------------------------------------------------------------------------------------- rows


def _rows(correction: SsrCorrection, mask: Booleans, *, igs: bool) -> tuple[SsrKind, list[_Row]]:
    """Rows of one system's satellites, each with its satellite id under ``id``."""
    if isinstance(correction, SsrOrbit):
        return SsrKind.ORBIT, _orbit_rows(correction, mask, igs=igs)
    if isinstance(correction, SsrCodeBias | SsrPhaseBias):
        kind = SsrKind.CODE_BIAS if isinstance(correction, SsrCodeBias) else SsrKind.PHASE_BIAS
        return kind, _bias_rows(correction, mask, igs=igs)
    assert not isinstance(correction, SsrVtec)
    indices = [int(k) for k in np.flatnonzero(mask)]
    ids = [int(correction.satellite[k]) for k in indices]
    if isinstance(correction, SsrUra):
        codes = [_ura_code(float(correction.ura_m[k])) for k in indices]
        return SsrKind.URA, [{"id": s, "ura": code} for s, code in zip(ids, codes, strict=True)]
    if correction.high_rate:
        values = [float(correction.polynomial_m[k, 0]) for k in indices]
        return SsrKind.HIGH_RATE_CLOCK, [{"id": s, "high_rate_m": v} for s, v in zip(ids, values, strict=True)]
    return SsrKind.CLOCK, [{"id": s} | _clock_row(correction, k) for s, k in zip(ids, indices, strict=True)]


def _clock_row(clock: SsrClock, k: int) -> _Row:
    c0, c1, c2 = (float(value) for value in clock.polynomial_m[k])
    return {"c0_m": c0, "c1_m_s": c1, "c2_m_s2": c2}


def _orbit_rows(orbit: SsrOrbit, mask: Booleans, *, igs: bool) -> list[_Row]:
    rows = []
    for k in np.flatnonzero(mask):
        radial, along, cross = (float(value) for value in orbit.delta_rac_m[k])
        radial_rate, along_rate, cross_rate = (float(value) for value in orbit.delta_rate_rac_m_s[k])
        rows.append(
            {
                "id": int(orbit.satellite[k]),
                **_issue_fields(int(orbit.satellite[k]), int(orbit.issue[k]), orbit.issue_rule, igs=igs),
                "radial_m": radial,
                "along_m": along,
                "cross_m": cross,
                "radial_rate_m_s": radial_rate,
                "along_rate_m_s": along_rate,
                "cross_rate_m_s": cross_rate,
            }
        )
    return rows


def _issue_fields(satellite: int, issue: int, rule: str, *, igs: bool) -> _Row:
    system = System(satellite // SATELLITES_PER_SYSTEM)
    if system is System.BEIDOU:
        wanted = "toe_720s" if igs else "toe_8s"
        if rule != wanted:
            raise ContractError(f"BeiDou issues by {rule!r}, the message wants {wanted!r}")
        return {"iod": issue} if igs else {"toe_modulo": issue, "iod": issue & 0xFF}
    if system is System.SBAS and not igs:
        return {"t0_modulo": 0, "iod_crc": issue}
    return {"iod": issue & 0xFF if igs else issue}


def _bias_rows(correction: SsrCodeBias | SsrPhaseBias, mask: Booleans, *, igs: bool) -> list[_Row]:
    rows: dict[int, _Row] = {}
    for k in np.flatnonzero(mask):
        identifier = identifier_of_signal(int(correction.signal[k]), igs=igs)
        if identifier is None:
            continue
        satellite = int(correction.satellite[k])
        row = rows.setdefault(satellite, {"id": satellite, "biases": []})
        bias: _Row = {"signal": identifier, "bias_m": float(correction.bias_m[k])}
        if isinstance(correction, SsrPhaseBias):
            row["yaw_angle_rad"] = float(correction.yaw_angle_rad[k]) % (2.0 * math.pi)
            row["yaw_rate_rad_s"] = float(correction.yaw_rate_rad_s[k])
            bias["integer"] = bool(correction.integer[k])
            bias["wide_lane_integer"] = int(correction.wide_lane_integer[k])
            bias["discontinuity"] = int(correction.discontinuity[k])
        row["biases"].append(bias)
    return [rows[satellite] for satellite in sorted(rows)]


def _ura_code(ura_m: float) -> int:
    """Code of the least accuracy class that holds a user range accuracy (DF389); 0 for NaN."""
    if math.isnan(ura_m):
        return 0
    for code in range(1, 64):
        if ura_m * 1e3 <= 3.0 ** (code >> 3) * (1.0 + (code & 7) / 4.0) - 1.0 + 1e-9:
            return code
    return 63


# --------------------------------------------------------------------------------------------- messages


def _messages(
    system: System, kind: SsrKind, header: SsrHeader, rows: list[_Row], extras: _Row, *, igs: bool
) -> list[Message]:
    meanings = _SUBTYPES if igs else _NUMBERS
    if (system, kind) not in meanings:
        raise ContractError(f"no message carries {kind.name} of {system.name}")
    parts = _parts(kind, rows)
    messages = []
    for place, part in enumerate(parts):
        fields = _header_fields(header, system, igs=igs) | extras
        fields["more_follows"] = place + 1 < len(parts)
        fields["satellites"] = tuple(_numbered(row, system, igs=igs) for row in part)
        number, subtype = (igs_ssr.NUMBER, meanings[system, kind]) if igs else (meanings[system, kind], None)
        messages.append(Message(number, fields, subtype))
    return messages


def _numbered(row: _Row, system: System, *, igs: bool) -> _Row:
    offset = 1 if system is System.SBAS and not igs else 0
    biases = {"biases": tuple(row["biases"])} if "biases" in row else {}
    return {**row, **biases, "satellite": number_of(row["id"]) - offset}


def _parts(kind: SsrKind, rows: list[_Row]) -> list[list[_Row]]:
    parts: list[list[_Row]] = [[]]
    bits = _HEADER_BITS
    for row in rows:
        size = _SATELLITE_BITS[kind] + _BIAS_BITS.get(kind, 0) * len(row.get("biases", ()))
        if bits + size > _FRAME_BITS or len(parts[-1]) == _MOST_SATELLITES:
            parts.append([])
            bits = _HEADER_BITS
        parts[-1].append(row)
        bits += size
    return parts


def _header_extras(correction: SsrCorrection) -> _Row:
    if isinstance(correction, SsrOrbit):
        return {"regional_datum": correction.header.regional_datum}
    if isinstance(correction, SsrPhaseBias):
        return {
            "dispersive_bias_consistent": correction.dispersive_bias_consistent,
            "mw_consistent": correction.mw_consistent,
        }
    return {}


def _header_fields(header: SsrHeader, system: System, *, igs: bool) -> _Row:
    fields: _Row = {
        "epoch_s": _epoch_s(header.t_gps_ns, system, igs=igs),
        "update_interval": _update_interval_code(header.update_interval_s),
        "more_follows": False,
        "iod_ssr": header.iod_ssr,
        "provider": header.provider,
        "solution": header.solution,
    }
    return fields | ({"version": 1} if igs else {})


def _epoch_s(t_gps_ns: int, system: System, *, igs: bool) -> int:
    if system is System.GLONASS and not igs:
        return (utc_ns_from_gps(t_gps_ns) + GLONASS_TIME_AHEAD_OF_UTC_S * NS_PER_S) % DAY_NS // NS_PER_S
    if system is System.BEIDOU and not igs:
        t_gps_ns -= BDT_BEHIND_GPST_S * NS_PER_S
    return t_gps_ns % WEEK_NS // NS_PER_S


def _update_interval_code(interval_s: float) -> int:
    codes: Sequence[int] = [k for k, seconds in enumerate(UPDATE_INTERVALS_S) if k and seconds >= interval_s]
    return 0 if interval_s == 0.0 else codes[0] if codes else len(UPDATE_INTERVALS_S) - 1


def _vtec_message(vtec: SsrVtec, *, igs: bool) -> Message:
    layers = []
    for height_km, cosine, sine in zip(vtec.layer_height_km, vtec.cosine_tecu, vtec.sine_tecu, strict=True):
        degree, order = cosine.shape[0] - 1, cosine.shape[1] - 1
        orders = range(min(order, degree) + 1)
        layers.append(
            {
                "height_km": height_km,
                "degree": degree,
                "order": order,
                "cosine_tecu": tuple(float(cosine[n, m]) for m in orders for n in range(m, degree + 1)),
                "sine_tecu": tuple(float(sine[n, m]) for m in orders[1:] for n in range(m, degree + 1)),
            }
        )
    fields = _header_fields(vtec.header, System.GPS, igs=igs)
    fields |= {"quality_tecu": vtec.quality_tecu, "layers": tuple(layers)}
    return Message(igs_ssr.NUMBER, fields, igs_ssr.VTEC_SUBTYPE) if igs else Message(VTEC.number, fields)
