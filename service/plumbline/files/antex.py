"""ANTEX 1.4 → antenna calibrations (Rothacher and Schmid, ANTEX 1.4, 2010)."""

from pathlib import Path

import numpy as np

from plumbline.files.calendar_time import fractional_second_ns, gps_ns_of_calendar
from plumbline.files.text import LineSource
from plumbline.records import AntennaCalibration, AntennaPattern
from plumbline.signals import satellite_of_name

_MM = 1e-3


def read_antex(path: Path | str) -> tuple[AntennaCalibration, ...]:
    """All antennas of a file, in its order. Raises FileFormatError."""
    source = LineSource(path)
    first = next(iter(source), b"")
    if b"ANTEX VERSION / SYST" not in first:
        raise source.error("not an ANTEX file")
    antennas: list[AntennaCalibration] = []
    block: list[str] | None = None
    for raw in source:
        line = raw.decode("ascii", "replace")
        label = line[60:].strip()
        if label == "START OF ANTENNA":
            block = []
        elif label == "END OF ANTENNA" and block is not None:
            try:
                antennas.append(_antenna(block))
            except (ValueError, IndexError) as error:
                raise source.error(f"damaged antenna before this line: {error}") from error
            block = None
        elif block is not None:
            block.append(line)
    return tuple(antennas)


def _antenna(lines: list[str]) -> AntennaCalibration:
    by_label = {line[60:].strip(): line[:60] for line in lines}
    antenna_type = by_label["TYPE / SERIAL NO"][:20].rstrip()
    serial = by_label["TYPE / SERIAL NO"][20:40].strip()
    zenith_1, zenith_2, step = (float(part) for part in by_label["ZEN1 / ZEN2 / DZEN"].split())
    return AntennaCalibration(
        antenna_type=antenna_type,
        serial=serial,
        zenith_grid_rad=np.radians(zenith_1 + step * np.arange(round((zenith_2 - zenith_1) / step) + 1)),
        patterns=_patterns(lines, float(by_label["DAZI"])),
        satellite=_satellite(serial),
        valid_from_gps_ns=_time(by_label.get("VALID FROM")),
        valid_until_gps_ns=_time(by_label.get("VALID UNTIL")),
    )


def _satellite(serial: str) -> int | None:
    """Satellite id of a serial that is a RINEX name; None for a receiver's antenna."""
    if len(serial) != 3 or not serial[1:].strip().isdigit():
        return None
    try:
        return satellite_of_name(serial)
    except ValueError:
        return None


def _patterns(lines: list[str], azimuth_step_deg: float) -> tuple[AntennaPattern, ...]:
    patterns: list[AntennaPattern] = []
    frequency, offset, plain, by_azimuth = "", (0.0, 0.0, 0.0), [0.0], list[list[float]]()
    inside = False
    for line in lines:
        label = line[60:].strip()
        if label == "START OF FREQUENCY":
            frequency, by_azimuth, inside = line[3:6], [], True
        elif label == "NORTH / EAST / UP" and inside:
            north, east, up = (float(part) * _MM for part in line[:60].split())
            offset = (north, east, up)
        elif label == "END OF FREQUENCY":
            azimuths = np.array(by_azimuth) * _MM if azimuth_step_deg and by_azimuth else None
            patterns.append(AntennaPattern(frequency, offset, np.array(plain) * _MM, azimuths))
            inside = False
        elif inside and line[3:8] == "NOAZI":
            plain = [float(part) for part in line[8:].split()]
        elif inside:
            by_azimuth.append([float(part) for part in line[8:].split()])
    return tuple(patterns)


def _time(text: str | None) -> int | None:
    if not text or not text.strip():
        return None
    year, month, day, hour, minute = (int(text[k : k + 6]) for k in range(0, 30, 6))
    return gps_ns_of_calendar("GPS", year, month, day, hour, minute, fractional_second_ns(text[30:43]))
