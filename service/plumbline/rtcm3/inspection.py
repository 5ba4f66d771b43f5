"""What a recording holds: by message type how many frames, when, satellites and signals; and the bytes in no frame."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from plumbline.rtcm3.fields import Malformed, Message, subtype_of, table_of
from plumbline.rtcm3.framing import scan_frames
from plumbline.rtcm3.igs_ssr import SUBTYPES
from plumbline.rtcm3.inertial import DEFAULT_INERTIAL_NUMBER, InertialMessage
from plumbline.rtcm3.legacy import LEGACY_TABLES
from plumbline.rtcm3.messages import DecodedMessage, decode
from plumbline.rtcm3.msm_layout import MSM_NUMBERS
from plumbline.rtcm3.observations import Observations
from plumbline.rtcm3.ssr import DIALECTS, SsrKind, beidou_orbit_is_draft
from plumbline.rtcm3.ssr_signals import IGS_CODES, RTCM_CODES
from plumbline.signals import System, satellite_id, satellite_name, signal_code

_SYSTEMS: Final = {
    1019: System.GPS, 1020: System.GLONASS, 1041: System.NAVIC, 1042: System.BEIDOU, 1044: System.QZSS,
    1045: System.GALILEO, 1046: System.GALILEO,
} | {
    number: dialect.system
    for dialect in DIALECTS
    for number in (*(dialect.base + kind for kind in SsrKind if kind < SsrKind.PHASE_BIAS), dialect.phase_bias)
}  # fmt: skip
_BEIDOU_ORBITS: Final = (1258, 1261)
_BEIDOU_SSR: Final = frozenset((*range(1258, 1264), 1270))
_DAYS: Final = ("Sun", "Mon", "Tue", "Wed", "Thu", "Fri", "Sat")
_DAY_S: Final = 86_400
_WEEK_SCALES: Final = {System.BEIDOU: "BDT", System.GALILEO: "GST"}

Moment = tuple[float, str]  # seconds of the week or, for GLONASS, of the day; and the time scale


@dataclass(slots=True)
class TypeSummary:
    """One message type's share of a recording; times in the order of the file, each in its message's own scale."""

    title: str
    frames: int = 0
    first: Moment | None = None
    last: Moment | None = None
    satellites: set[str] = field(default_factory=set)
    signals: set[str] = field(default_factory=set)
    malformed: Counter[str] = field(default_factory=Counter)


@dataclass(frozen=True, slots=True)
class Inspection:
    """A recording in numbers. Types are message numbers as text, with ``_021`` and the like behind a 4076."""

    file: str
    n_bytes: int
    messages: Mapping[str, TypeSummary]
    rejected_bytes: Mapping[str, int]

    def to_dict(self) -> dict[str, Any]:
        """The JSON form: plain types, sorted."""
        return {
            "file": self.file,
            "bytes": self.n_bytes,
            "messages": {key: _summary_dict(summary) for key, summary in self.messages.items()},
            "rejected_bytes": dict(self.rejected_bytes),
        }

    def to_json(self) -> str:
        """One JSON object on one line."""
        return json.dumps(self.to_dict())

    def to_text(self) -> str:
        """A table for people."""
        frames = sum(summary.frames for summary in self.messages.values())
        lines = [f"{self.file}: {self.n_bytes} bytes, {frames} frames"]
        lines += [line for key, summary in self.messages.items() for line in _summary_lines(key, summary)]
        rejected = ", ".join(f"{n} {reason}" for reason, n in self.rejected_bytes.items()) or "none"
        return "\n".join([*lines, f"  bytes in no frame: {rejected}"])


def inspect_bytes(data: bytes, file: str, inertial_number: int = DEFAULT_INERTIAL_NUMBER) -> Inspection:
    """Inspect a whole recording."""
    scan = scan_frames(data)
    return Inspection(
        file,
        len(data),
        summarise(
            (decode(own.payload, inertial_number), own.number, subtype_of(own.number, own.payload))
            for own in scan.frames
        ),
        scan.rejected_bytes,
    )


def summarise(messages: Iterable[tuple[DecodedMessage, int, int | None]]) -> dict[str, TypeSummary]:
    """Summaries by message type of decoded messages, each with its number and subtype; sorted by number."""
    found: dict[tuple[int, int], TypeSummary] = {}
    decoded = list(messages)
    orbits = (m for m, _, _ in decoded if isinstance(m, Message) and m.number in _BEIDOU_ORBITS)
    counts_from_zero = _BEIDOU_SSR if any(beidou_orbit_is_draft(orbit) for orbit in orbits) else frozenset()
    for message, number, subtype in decoded:
        key = (number, -1 if subtype is None else subtype)
        if key not in found:
            found[key] = TypeSummary(_title(message, number, subtype))
        _add(found[key], message, 1 if number in counts_from_zero else 0)
    return {
        f"{number}" if subtype < 0 else f"{number}_{subtype:03d}": found[number, subtype]
        for number, subtype in sorted(found)
    }


def _add(summary: TypeSummary, message: DecodedMessage, number_shift: int) -> None:
    summary.frames += 1
    if isinstance(message, Malformed):
        summary.malformed[message.reason] += 1
        return
    moment = _moment(message)
    if moment is not None:
        summary.first = summary.first or moment
        summary.last = moment
    if isinstance(message, Observations):
        summary.satellites |= {satellite_name(s) for s in set(message.satellite.tolist())}
        signals = {(s, signal_code(s)) for s in set(message.signal.tolist())}
        summary.signals |= {code or f"signal {s % 32 + 1}" for s, code in signals}
    elif isinstance(message, Message):
        _add_table_message(summary, message, number_shift)


def _add_table_message(summary: TypeSummary, message: Message, number_shift: int) -> None:
    system = _system(message)
    if system is None:
        return
    codes = (RTCM_CODES if message.subtype is None else IGS_CODES).get(system, {})
    for own in message.fields.get("satellites", (message.fields,)):
        summary.satellites.add(_name(system, own["satellite"] + number_shift))
        biases = own.get("biases", ())
        summary.signals |= {codes.get(bias["signal"], f"identifier {bias['signal']}") for bias in biases}


def _name(system: System, number: int) -> str:
    """RINEX name; a number that the system does not have is shown as it is."""
    if system is System.SBAS and number >= 120:
        number -= 119
    return satellite_name(satellite_id(system, number)) if 1 <= number <= 64 else f"{system.letter}?{number}"


def _system(message: Message) -> System | None:
    if message.subtype is not None:
        return SUBTYPES[message.subtype][0] if message.subtype in SUBTYPES else None
    return _SYSTEMS.get(message.number)


def _title(message: DecodedMessage, number: int, subtype: int | None) -> str:
    if isinstance(message, InertialMessage):
        return "inertial samples"
    if number in MSM_NUMBERS:
        kind, _, system = MSM_NUMBERS[number]
        return f"{system.name} MSM{kind} observations"
    if number in LEGACY_TABLES:
        return f"{'GPS' if number < 1009 else 'GLONASS'} legacy observations"
    table = table_of(number, subtype)
    return "not decoded here" if table is None else table.title


def _moment(message: DecodedMessage) -> Moment | None:
    if isinstance(message, Observations):
        return _observation_moment(message)
    if isinstance(message, InertialMessage):
        return message.tow_ms * 1e-3 + message.tow_us * 1e-6, "GPST"
    if not isinstance(message, Message):
        return None
    if "epoch_s" in message.fields:
        glonass = _system(message) is System.GLONASS
        return float(message["epoch_s"]), "UTC+3h, day unknown" if glonass else "of the correction"
    return (float(message["toe_s"]), "toe") if "toe_s" in message.fields else None


def _observation_moment(message: Observations) -> Moment:
    seconds = message.epoch_ms * 1e-3
    if message.system is not System.GLONASS:
        return seconds, _WEEK_SCALES.get(message.system, "GPST")
    if message.day_of_week is None:
        return seconds, "UTC+3h, day unknown"
    return message.day_of_week * _DAY_S + seconds, "UTC+3h"


def _moment_text(moment: Moment) -> str:
    seconds, scale = moment
    day, second = divmod(round(seconds * 1000), _DAY_S * 1000)
    minute, ms = divmod(second, 60_000)
    clock = f"{minute // 60:02d}:{minute % 60:02d}:{ms // 1000:02d}.{ms % 1000:03d}"
    return f"{clock} {scale}" if "day unknown" in scale else f"{_DAYS[day % 7]} {clock} {scale}"


def _summary_dict(summary: TypeSummary) -> dict[str, Any]:
    entry: dict[str, Any] = {"frames": summary.frames, "title": summary.title}
    if summary.first is not None and summary.last is not None:
        entry |= {"first": _moment_text(summary.first), "last": _moment_text(summary.last)}
        entry |= {"first_s": round(summary.first[0], 6), "last_s": round(summary.last[0], 6)}
    if summary.satellites:
        entry["satellites"] = sorted(summary.satellites)
    if summary.signals:
        entry["signals"] = sorted(summary.signals)
    if summary.malformed:
        entry["malformed"] = dict(sorted(summary.malformed.items()))
    return entry


def _summary_lines(key: str, summary: TypeSummary) -> list[str]:
    lines = [f"  {key:>8}  {summary.frames:7d}  {summary.title}"]
    if summary.first is not None and summary.last is not None:
        lines.append(f"{'':21}{_moment_text(summary.first)} … {_moment_text(summary.last)}")
    if summary.satellites:
        lines.append(f"{'':21}{len(summary.satellites)} satellites: {' '.join(sorted(summary.satellites))}")
    if summary.signals:
        lines.append(f"{'':21}signals: {' '.join(sorted(summary.signals))}")
    if summary.malformed:
        reasons = ", ".join(f"{n} {reason}" for reason, n in sorted(summary.malformed.items()))
        lines.append(f"{'':21}malformed: {reasons}")
    return lines
