"""SP3-a, -c and -d files → precise orbits and the clocks they carry (Hilton and others, SP3-d, 2016)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from plumbline.files.calendar_time import fractional_second_ns, gps_ns_of_calendar
from plumbline.files.text import LineSource
from plumbline.records import PreciseClocks, PreciseOrbits
from plumbline.signals import satellite_of_name

_BAD_CLOCK_US: Final = 999999.0
_Record = tuple[float, float, float, float]  # m, m, m, s


def read_sp3(paths: Sequence[Path | str]) -> tuple[PreciseOrbits, PreciseClocks]:
    """Orbits and clocks of one or more files merged in time; where files overlap, the later path in the list wins.

    Raises FileFormatError.
    """
    table: dict[int, dict[int, _Record]] = {}
    for path in paths:
        for t_gps_ns, records in _read(LineSource(path)).items():
            table.setdefault(t_gps_ns, {}).update(records)
    times = sorted(table)
    satellites = sorted({satellite for records in table.values() for satellite in records})
    column = {satellite: k for k, satellite in enumerate(satellites)}
    values = np.full((len(times), len(satellites), 4), np.nan)
    for row, t_gps_ns in enumerate(times):
        for satellite, record in table[t_gps_ns].items():
            values[row, column[satellite]] = record
    ids, t = np.array(satellites, np.int16), np.array(times, np.int64)
    return PreciseOrbits(ids, t, values[:, :, :3].copy()), PreciseClocks(ids, t, values[:, :, 3].copy())


def _read(source: LineSource) -> dict[int, dict[int, _Record]]:
    first = next(iter(source), b"")
    if first[:1] != b"#" or first[1:2] not in b"abcd" or first[2:3] not in b"PV":
        raise source.error("not an SP3 file")
    scale, epochs, records = "", dict[int, dict[int, _Record]](), dict[int, _Record]()
    for raw in source:
        line = raw.decode("ascii", "replace")
        try:
            if line.startswith("%c") and not scale:
                scale = line[9:12].strip().replace("ccc", "GPS")
            elif line.startswith("* "):
                records = epochs.setdefault(_time(line, scale), {})
            elif line.startswith("P"):
                _add(line, records)
        except ValueError as error:
            raise source.error(f"damaged record: {error}") from error
    return epochs


def _time(line: str, scale: str) -> int:
    year, month, day, hour, minute = (
        int(part) for part in (line[3:7], line[8:10], line[11:13], line[14:16], line[17:19])
    )
    return gps_ns_of_calendar(scale, year, month, day, hour, minute, fractional_second_ns(line[20:31]))


def _add(line: str, records: dict[int, _Record]) -> None:
    name = line[1:4]
    if name[0] not in "GRECJI ":
        return  # LEO and SBAS satellites
    x, y, z, clock = (float(line[4 + 14 * k : 18 + 14 * k].strip() or "nan") for k in range(4))
    if x == y == z == 0.0:  # SP3: a missing position
        x = y = z = np.nan
    clock_s = np.nan if abs(clock) >= _BAD_CLOCK_US else clock * 1e-6
    records[satellite_of_name(name.replace(" ", "G", 1) if name[0] == " " else name)] = (
        x * 1e3, y * 1e3, z * 1e3, clock_s,
    )  # fmt: skip
