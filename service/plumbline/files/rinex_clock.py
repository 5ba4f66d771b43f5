"""RINEX clock files → precise clocks (RINEX clock 3.04), and the wide-lane satellite biases of GRG's header comments.

GRG's clocks are integer-recovery clocks (Loyer and others, 2012): with the wide-lane biases of the same file, wide-lane
and then narrow-lane ambiguities of satellite differences are integers.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from plumbline.files.calendar_time import fractional_second_ns, gps_ns_of_calendar
from plumbline.files.text import LineSource
from plumbline.records import PreciseClocks
from plumbline.signals import satellite_of_name


@dataclass(frozen=True, slots=True)
class ClockFiles:
    """Clocks of one or more files."""

    clocks: PreciseClocks
    wide_lane_cycles: Mapping[int, float]  # satellite id → fractional bias of the wide lane, cycles
    antenna_model: str  # ANTEX file that the clocks were computed with, as the header names it


def read_clocks(paths: Sequence[Path | str]) -> ClockFiles:
    """Satellite clocks (AS records) of files merged in time; the later path wins. Raises FileFormatError."""
    table: dict[int, dict[int, float]] = {}
    wide_lanes: dict[int, float] = {}
    model = ""
    for path in paths:
        source = LineSource(path)
        scale, file_model = _read_header(source, wide_lanes)
        model = file_model or model
        _read_records(source, scale, table)
    times = sorted(table)
    satellites = sorted({satellite for values in table.values() for satellite in values})
    column = {satellite: k for k, satellite in enumerate(satellites)}
    clock_s = np.full((len(times), len(satellites)), np.nan)
    for row, t_gps_ns in enumerate(times):
        for satellite, value in table[t_gps_ns].items():
            clock_s[row, column[satellite]] = value
    clocks = PreciseClocks(np.array(satellites, np.int16), np.array(times, np.int64), clock_s)
    return ClockFiles(clocks, wide_lanes, model)


def _read_header(source: LineSource, wide_lanes: dict[int, float]) -> tuple[str, str]:
    """Time scale and antenna model; wide-lane biases are put into ``wide_lanes``."""
    scale, model = "GPS", ""
    for number, raw in enumerate(source):
        line = raw.decode("ascii", "replace")
        if number == 0 and ("RINEX VERSION / TYPE" not in line or "CLOCK" not in line[20:45].upper()):
            raise source.error("not a RINEX clock file")
        if "TIME SYSTEM ID" in line:
            scale = line[:9].strip() or "GPS"
        elif "SYS / PCVS APPLIED" in line:
            model = line[20:60].strip()
        elif line.startswith("WL ") and "COMMENT" in line:
            parts = line.split()
            wide_lanes[satellite_of_name(parts[1])] = float(parts[9])
        elif "END OF HEADER" in line:
            return scale, model
    raise source.error("no RINEX header")


def _read_records(source: LineSource, scale: str, table: dict[int, dict[int, float]]) -> None:
    satellites: dict[bytes, int] = {}
    last_time, values = b"", dict[int, float]()
    for line in source:
        if not line.startswith(b"AS "):
            continue
        try:
            parts = line.split()
            time = b" ".join(parts[2:8])
            if time != last_time:
                values = table.setdefault(_time(parts[2:8], scale), {})
                last_time = time
            name = parts[1]
            if name not in satellites:
                satellites[name] = satellite_of_name(name.decode("ascii"))
            clock_s = float(parts[9].replace(b"D", b"E"))
            if math.isfinite(clock_s):
                values[satellites[name]] = clock_s
        except (ValueError, IndexError) as error:
            raise source.error(f"damaged record: {error}") from error


def _time(parts: list[bytes], scale: str) -> int:
    year, month, day, hour, minute = (int(part) for part in parts[:5])
    return gps_ns_of_calendar(scale, year, month, day, hour, minute, fractional_second_ns(parts[5].decode("ascii")))
