"""What RINEX 2.11 writes differently: types of two characters, wrapped records, satellites in the epoch line."""

from collections import Counter
from collections.abc import Iterator
from typing import Final

from plumbline.files.calendar_time import fractional_second_ns, gps_ns_of_calendar
from plumbline.files.rinex_header import RinexObservationHeader
from plumbline.files.text import LineSource
from plumbline.signals import System

_FIELDS_PER_LINE = 5
_CYCLE_SLIPS = 6


def _types(signals: dict[str, str]) -> dict[str, str]:
    """RINEX 3 types of RINEX 2's: ``{"1": "1C", "P2": "2W"}`` names the signal of a band's phases, and of a code."""
    types = {}
    for key, signal in signals.items():
        if key[0] in "CP":
            types[key] = "C" + signal
        else:
            types |= {kind + key: kind + signal for kind in "LDS"}
    return types


#: RINEX 2.11 type → RINEX 3 type. A band's phase is given to the code that a geodetic receiver tracks it with.
TYPES_V2: Final[dict[System, dict[str, str]]] = {
    System.GPS: _types({"C1": "1C", "1": "1C", "P1": "1W", "P2": "2W", "2": "2W", "C2": "2X", "C5": "5X", "5": "5X"}),
    System.GLONASS: _types({"C1": "1C", "1": "1C", "P1": "1P", "P2": "2P", "2": "2P", "C2": "2C"}),
    System.GALILEO: _types(
        {"C1": "1X", "1": "1X", "C5": "5X", "5": "5X", "C7": "7X", "7": "7X", "C6": "6X", "6": "6X"}
    ),
    System.SBAS: _types({"C1": "1C", "1": "1C", "C5": "5X", "5": "5X"}),
}


def epoch_lines_v2(
    source: LineSource, header: RinexObservationHeader, skipped: Counter[str]
) -> Iterator[tuple[int, int, list[bytes]]]:
    """Time, epoch flag and records, as RINEX 3 would write them, of each epoch (RINEX 2.11, table A2)."""
    lines_per_satellite = -(-len(header.observation_types_v2) // _FIELDS_PER_LINE)
    for line in source:
        try:
            flag, count = int(line[28:29] or b"0"), int(line[29:32])
        except ValueError:
            skipped["damaged epoch line"] += 1
            continue
        if 2 <= flag < _CYCLE_SLIPS:
            _skip(source, count)
            skipped["event record"] += 1
            continue
        names = _satellites(line, count, source)
        records = [name + _record(source, lines_per_satellite) for name in names]
        if flag == _CYCLE_SLIPS:
            skipped["event record"] += 1
            continue
        try:
            yield _epoch_time(line.decode("ascii", "replace"), header.time_scale), flag, records
        except ValueError:
            skipped["damaged epoch line"] += 1


def _skip(source: LineSource, count: int) -> None:
    for _ in zip(range(count), source, strict=False):
        pass


def _satellites(line: bytes, count: int, source: LineSource) -> list[bytes]:
    """Names of an epoch's satellites, which go on in the next lines' same columns; a blank system means GPS."""
    text = line[32:68]
    while len(text) < 3 * count:
        text = text.ljust(-(-len(text) // 36) * 36) + next(source, b"")[32:68].ljust(36)
    names = [text[3 * k : 3 * k + 3] for k in range(count)]
    return [b"G" + name[1:] if name[:1] == b" " else name for name in names]


def _record(source: LineSource, n_lines: int) -> bytes:
    return b"".join(next(source, b"").ljust(80)[:80] for _ in range(n_lines))


def _epoch_time(text: str, scale: str) -> int:
    """GPS time of an epoch line, two-digit year 80…79; raises ``ValueError``."""
    year, month, day, hour, minute = (int(text[i : i + 3]) for i in range(0, 15, 3))
    year += 1900 if year >= 80 else 2000
    return gps_ns_of_calendar(scale, year, month, day, hour, minute, fractional_second_ns(text[15:26]))
