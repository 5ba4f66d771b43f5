"""SSR messages → records, and back, for RTCM's own numbers and for the IGS's 4076.

Reading is stateful in one thing only: BeiDou's messages come in two dialects (see
:func:`plumbline.rtcm3.ssr.beidou_orbit_is_draft`), which only orbit messages give away. Until one has been seen, the
other BeiDou messages of a stream wait: they say nothing without an orbit anyway.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from plumbline.constants import BDT_BEHIND_GPST_S
from plumbline.epochs.translate_ephemeris import Rejected
from plumbline.gps_time import NS_PER_S, WEEK_NS, nearest_ns, resolve_glonass_ms
from plumbline.records import (
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
from plumbline.rtcm3.fields import Fields, Message
from plumbline.rtcm3.ssr import MESSAGES, UPDATE_INTERVALS_S, VTEC, SsrKind, beidou_orbit_is_draft
from plumbline.rtcm3.ssr_signals import signal_of_identifier
from plumbline.signals import SATELLITES_PER_SYSTEM, System, satellite_id

NUMBERS: Final = frozenset({*MESSAGES, VTEC.number, igs_ssr.NUMBER})
_SBAS_NUMBER_OFFSET: Final = 1  # RTCM: identifier 0 is PRN 120, which is satellite 1 here
_STALE_BIAS_NS: Final = 1800 * NS_PER_S
_URA_FLOOR_M: Final = 0.001

Translated = list[SsrCorrection] | Rejected


@dataclass(slots=True)
class SsrTranslator:
    """Reads one stream's SSR messages; picklable. ``skipped`` counts rows left out, by reason."""

    beidou_is_draft: bool | None = None
    skipped: dict[str, int] = field(default_factory=dict)

    def translate(self, message: Message, t_receive_ns: int, t_near_gps_ns: int | None = None) -> Translated:
        """Records of a message: an orbit and a clock for combined messages, else one.

        ``t_near_gps_ns``: the stream's own time where it is known to differ from the receive time (a recording).
        """
        near_ns = t_receive_ns if t_near_gps_ns is None else t_near_gps_ns
        meaning = self._meaning(message)
        if isinstance(meaning, Rejected):
            return meaning
        header = _header(message.fields, meaning, t_receive_ns, near_ns)
        if meaning.kind is SsrKind.VTEC:
            return [_vtec(message.fields, header)]
        rows = self._numbered(meaning, message.fields["satellites"])
        return _READERS[meaning.kind](self, meaning, header, message.fields, rows)

    def _meaning(self, message: Message) -> "_Meaning | Rejected":
        igs = message.number == igs_ssr.NUMBER
        if message.number == VTEC.number or (igs and message.subtype == igs_ssr.VTEC_SUBTYPE):
            return _Meaning(System.GPS, SsrKind.VTEC, igs)
        found = igs_ssr.SUBTYPES.get(message.subtype or 0) if igs else MESSAGES.get(message.number)
        if found is None:
            return Rejected("not_an_ssr_message")
        system, kind = found
        if system is not System.BEIDOU or igs:
            return _Meaning(system, kind, igs)
        if kind in (SsrKind.ORBIT, SsrKind.COMBINED):
            told = beidou_orbit_is_draft(message)
            self.beidou_is_draft = self.beidou_is_draft if told is None else told
        if self.beidou_is_draft is None:
            return Rejected("beidou_dialect_unknown")
        return _Meaning(system, kind, igs, self.beidou_is_draft)

    def _numbered(self, meaning: "_Meaning", satellites: Sequence[Fields]) -> list[tuple[int, Fields]]:
        """(satellite id, fields) of the rows whose satellite number exists; a satellite's later row wins."""
        rows: dict[int, Fields] = {}
        for satellite in satellites:
            number = satellite["satellite"] + meaning.number_offset
            if 1 <= number <= SATELLITES_PER_SYSTEM:
                rows[satellite_id(meaning.system, number)] = satellite
            else:
                self.skip("satellite_out_of_range")
        return sorted(rows.items())

    def skip(self, reason: str) -> None:
        """Count a row that is left out."""
        self.skipped[reason] = self.skipped.get(reason, 0) + 1


@dataclass(frozen=True, slots=True)
class _Meaning:
    system: System
    kind: SsrKind
    igs: bool
    draft: bool = False

    @property
    def number_offset(self) -> int:
        """Satellite number less the identifier sent."""
        if self.igs:
            return 0
        return _SBAS_NUMBER_OFFSET if self.system is System.SBAS else int(self.draft)

    @property
    def issue_rule(self) -> str:
        """How the issue names an ephemeris (:class:`plumbline.records.SsrOrbit`)."""
        if self.system is not System.BEIDOU:
            return "issue"
        return "toe_720s" if self.igs else "toe_8s"


# --------------------------------------------------------------------------------------------- header


def _header(f: Fields, meaning: _Meaning, t_receive_ns: int, near_ns: int) -> SsrHeader:
    t_gps_ns = _epoch_gps_ns(f["epoch_s"], meaning, near_ns)
    stale = abs(t_gps_ns - near_ns) > _STALE_BIAS_NS
    if stale and meaning.kind in (SsrKind.CODE_BIAS, SsrKind.PHASE_BIAS):
        t_gps_ns = near_ns  # services exist that never renew the epoch of their biases (has-idd-2023-229)
    code = f["update_interval"]
    return SsrHeader(
        t_gps_ns=t_gps_ns,
        t_receive_ns=t_receive_ns,
        update_interval_s=float(UPDATE_INTERVALS_S[code]) if code else 0.0,  # DF391: code 0 refers to the epoch itself
        iod_ssr=f["iod_ssr"],
        provider=f["provider"],
        solution=f["solution"],
        regional_datum=f.get("regional_datum", False),
    )


def _epoch_gps_ns(epoch_s: int, meaning: _Meaning, near_ns: int) -> int:
    """GPS time of an SSR epoch: GLONASS (RTCM) in seconds of the day in UTC + 3 h, BeiDou (RTCM) in BDT."""
    if not meaning.igs and meaning.system is System.GLONASS:
        return resolve_glonass_ms(None, epoch_s * 1000, near_ns)
    bdt = meaning.system is System.BEIDOU and not meaning.igs and not meaning.draft
    return nearest_ns((epoch_s + (BDT_BEHIND_GPST_S if bdt else 0)) * NS_PER_S, WEEK_NS, near_ns)


# --------------------------------------------------------------------------------------------- kinds

_Rows = list[tuple[int, Fields]]


def _ids(rows: _Rows) -> Any:
    return np.array([satellite for satellite, _ in rows], dtype=np.int16)


def _columns(rows: _Rows, *names: str) -> Any:
    return np.array([[f[name] for name in names] for _, f in rows], dtype=np.float64).reshape(len(rows), len(names))


def _orbit(meaning: _Meaning, header: SsrHeader, rows: _Rows) -> SsrOrbit:
    issue = "toe_modulo" if meaning.system is System.BEIDOU and not meaning.igs else "iod"
    if meaning.system is System.SBAS and not meaning.igs:
        issue = "iod_crc"
    return SsrOrbit(
        header=header,
        satellite=_ids(rows),
        issue=np.array([f[issue] for _, f in rows], dtype=np.int64),
        delta_rac_m=_columns(rows, "radial_m", "along_m", "cross_m"),
        delta_rate_rac_m_s=_columns(rows, "radial_rate_m_s", "along_rate_m_s", "cross_rate_m_s"),
        issue_rule=meaning.issue_rule,
    )


def _clock(header: SsrHeader, rows: _Rows) -> SsrClock:
    return SsrClock(header, _ids(rows), _columns(rows, "c0_m", "c1_m_s", "c2_m_s2"))


def _high_rate_clock(header: SsrHeader, rows: _Rows) -> SsrClock:
    polynomial_m = np.zeros((len(rows), 3))
    polynomial_m[:, :1] = _columns(rows, "high_rate_m")
    return SsrClock(header, _ids(rows), polynomial_m, high_rate=True)


def _biases(translator: SsrTranslator, meaning: _Meaning, rows: _Rows) -> list[tuple[int, int, Fields, Fields]]:
    """(satellite, signal, satellite's fields, bias's fields), sorted; signals without an id are left out."""
    found: dict[tuple[int, int], tuple[Fields, Fields]] = {}
    for satellite, f in rows:
        for bias in f["biases"]:
            signal = signal_of_identifier(meaning.system, bias["signal"], igs=meaning.igs)
            if signal is None:
                translator.skip("unknown_signal")
            else:
                found[satellite, signal] = (f, bias)
    return [(*key, *fields) for key, fields in sorted(found.items(), key=lambda item: item[0])]


def _code_bias(t: SsrTranslator, meaning: _Meaning, header: SsrHeader, f: Fields, rows: _Rows) -> Translated:
    del f
    biases = _biases(t, meaning, rows)
    return [
        SsrCodeBias(
            header=header,
            satellite=np.array([b[0] for b in biases], dtype=np.int16),
            signal=np.array([b[1] for b in biases], dtype=np.int16),
            bias_m=np.array([b[3]["bias_m"] for b in biases], dtype=np.float64),
        )
    ]


def _phase_bias(t: SsrTranslator, meaning: _Meaning, header: SsrHeader, f: Fields, rows: _Rows) -> Translated:
    biases = _biases(t, meaning, rows)
    return [
        SsrPhaseBias(
            header=header,
            satellite=np.array([b[0] for b in biases], dtype=np.int16),
            signal=np.array([b[1] for b in biases], dtype=np.int16),
            bias_m=np.array([b[3]["bias_m"] for b in biases], dtype=np.float64),
            integer=np.array([b[3]["integer"] for b in biases], dtype=np.bool_),
            wide_lane_integer=np.array([b[3]["wide_lane_integer"] for b in biases], dtype=np.int64),
            discontinuity=np.array([b[3]["discontinuity"] for b in biases], dtype=np.int64),
            yaw_angle_rad=np.array([b[2]["yaw_angle_rad"] for b in biases], dtype=np.float64),
            yaw_rate_rad_s=np.array([b[2]["yaw_rate_rad_s"] for b in biases], dtype=np.float64),
            dispersive_bias_consistent=f["dispersive_bias_consistent"],
            mw_consistent=f["mw_consistent"],
        )
    ]


def ura_m(code: int) -> float:
    """User range accuracy of its 6-bit code, m: 3^class (1 + value/4) − 1 mm (DF389); NaN for 0, unknown."""
    if code == 0:
        return float("nan")
    return max((3.0 ** (code >> 3) * (1.0 + (code & 7) / 4.0) - 1.0) * 1e-3, _URA_FLOOR_M)


def _ura(header: SsrHeader, rows: _Rows) -> SsrUra:
    return SsrUra(header, _ids(rows), np.array([ura_m(f["ura"]) for _, f in rows], dtype=np.float64))


_Reader = Callable[[SsrTranslator, _Meaning, SsrHeader, Fields, _Rows], Translated]
_READERS: Final[dict[SsrKind, _Reader]] = {
    SsrKind.ORBIT: lambda t, meaning, header, f, rows: [_orbit(meaning, header, rows)],
    SsrKind.CLOCK: lambda t, meaning, header, f, rows: [_clock(header, rows)],
    SsrKind.COMBINED: lambda t, meaning, header, f, rows: [_orbit(meaning, header, rows), _clock(header, rows)],
    SsrKind.HIGH_RATE_CLOCK: lambda t, meaning, header, f, rows: [_high_rate_clock(header, rows)],
    SsrKind.CODE_BIAS: _code_bias,
    SsrKind.PHASE_BIAS: _phase_bias,
    SsrKind.URA: lambda t, meaning, header, f, rows: [_ura(header, rows)],
}


def _vtec(f: Fields, header: SsrHeader) -> SsrVtec:
    layers = f["layers"]
    return SsrVtec(
        header=header,
        quality_tecu=f["quality_tecu"],
        layer_height_km=tuple(layer["height_km"] for layer in layers),
        cosine_tecu=tuple(_triangle(layer, "cosine_tecu", 0) for layer in layers),
        sine_tecu=tuple(_triangle(layer, "sine_tecu", 1) for layer in layers),
    )


def _triangle(layer: Fields, name: str, first_order: int) -> Any:
    """Coefficients as a matrix (degree + 1, order + 1) from their sequence by order, then degree."""
    degree, order = layer["degree"], layer["order"]
    matrix = np.zeros((degree + 1, order + 1))
    coefficients = iter(layer[name])
    for m in range(first_order, min(order, degree) + 1):
        for n in range(m, degree + 1):
            matrix[n, m] = next(coefficients)
    return matrix
