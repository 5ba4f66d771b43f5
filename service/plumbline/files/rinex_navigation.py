"""RINEX 3 and 4 navigation files → ephemerides (RINEX 3.05, tables A5–A15; RINEX 4.00, section 5).

RINEX 4 keeps the layout of RINEX 3 for LNAV, FDMA, INAV, FNAV, D1 and D2; its other messages, and SBAS, are skipped and
counted. ``t_receive_ns`` is the transmission time that the record gives. Where it gives none (or one further than a day
from the reference time) it is the time from which the set is sure to be on the air: two hours before the reference time
for GPS, QZSS and NavIC, a quarter of an hour before it for GLONASS, the reference time itself for Galileo and BeiDou.
"""

import math
from bisect import bisect_left
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from plumbline.constants import BDT_BEHIND_GPST_S
from plumbline.files.calendar_time import glonass_issue, gps_ns_of_calendar
from plumbline.files.text import LineSource, fortran_float
from plumbline.gps_time import DAY_NS, NS_PER_S, WEEK_NS, gps_minus_utc_s, nearest_ns, utc_ns_from_gps
from plumbline.records import Ephemeris, GlonassEphemeris, KeplerEphemeris
from plumbline.signals import System, satellite_of_name, system_of

_SKIPPED_LETTERS = "S"
_TIME_SCALES: Final = {System.GLONASS: "GLO", System.BEIDOU: "BDT"}
_LEAD_NS: Final = {System.GPS: 7200, System.QZSS: 7200, System.NAVIC: 7200, System.GLONASS: 900}
_UNKNOWN = 0.999e9  # GLONASS fields that are not known are written as .999999999999E+09
_GEO_NUMBERS = frozenset({1, 2, 3, 4, 5, 59, 60, 61, 62, 63})
_V4_MESSAGES = frozenset({"LNAV", "FDMA", "INAV", "FNAV", "D1", "D2", "D1D2"})
_FNAV_CLOCK_BIT, _FNAV_BIT = 1 << 8, 1 << 1  # Galileo data sources
_URA_M: Final = [2.4, 3.4, 4.85, 6.85, 9.65, 13.65, 24.0, 48.0, 96.0, 192.0, 384.0, 768.0, 1536.0, 3072.0, 6144.0]


@dataclass(frozen=True, slots=True)
class Navigation:
    """Ephemerides in file order, and what was left out by reason."""

    ephemerides: tuple[Ephemeris, ...]
    skipped: Counter[str]


def read_navigation(path: Path | str) -> Navigation:
    """Read a navigation file; raises FileFormatError where it is none."""
    source = LineSource(path)
    _read_header(source)
    ephemerides: list[Ephemeris] = []
    skipped: Counter[str] = Counter()
    for record in _records(source, skipped):
        try:
            ephemerides.append(_ephemeris(record))
        except (ValueError, IndexError, OverflowError):
            skipped["damaged record"] += 1
    return Navigation(tuple(ephemerides), skipped)


def _read_header(source: LineSource) -> None:
    first = next(iter(source), b"")
    if first[60:80].strip() != b"RINEX VERSION / TYPE" or first[20:21] != b"N":
        raise source.error("not a RINEX navigation file")
    if not 3.0 <= float(first[:9]) < 5.0:
        raise source.error(f"RINEX version {first[:9].decode().strip()} of navigation files is not supported")
    for line in source:
        if line[60:80].strip() == b"END OF HEADER":
            return
    raise source.error("no end of header")


def _records(source: LineSource, skipped: Counter[str]) -> list[list[str]]:
    """Records as lists of lines; a record begins with a satellite's name and goes on in indented lines."""
    records: list[list[str]] = []
    wanted = True
    for raw in source:
        line = raw.decode("ascii", "replace")
        if line.startswith(">"):  # RINEX 4: > EPH G01 LNAV
            parts = line.split()
            wanted = parts[1:2] == ["EPH"] and parts[3:4] != [] and parts[3] in _V4_MESSAGES
            skipped["other message"] += not wanted
        elif not wanted:
            continue
        elif line[:1] == " " and records:
            records[-1].append(line)
        elif line.strip():
            records.append([line])
    skipped["SBAS"] += sum(record[0][0] in _SKIPPED_LETTERS for record in records)
    return [record for record in records if record[0][0] not in _SKIPPED_LETTERS]


def _ephemeris(lines: list[str]) -> Ephemeris:
    satellite = satellite_of_name(lines[0][:3])
    system = system_of(satellite)
    year, month, day, hour, minute, second = (int(part) for part in lines[0][3:23].split())
    scale = _TIME_SCALES.get(system, "GPS")
    toc_gps_ns = gps_ns_of_calendar(scale, year, month, day, hour, minute, second * NS_PER_S)
    values = [_field(lines[0], 23, k) for k in range(3)]
    for line in lines[1:]:
        values += [_field(line, 4, k) for k in range(4)]
    values += [math.nan] * (31 - len(values))
    if system is System.GLONASS:
        return _glonass(satellite, toc_gps_ns, values)
    return _kepler(satellite, system, toc_gps_ns, values)


def _field(line: str, start: int, k: int) -> float:
    return fortran_float(line[start + 19 * k : start + 19 * (k + 1)])


def _whole(value: float, default: int = 0) -> int:
    return default if math.isnan(value) else round(value)


def _kepler(satellite: int, system: System, toc_gps_ns: int, v: list[float]) -> KeplerEphemeris:
    """A record in Keplerian elements; ``v``: the 31 values in the order of the tables."""
    offset_ns = BDT_BEHIND_GPST_S * NS_PER_S if system is System.BEIDOU else 0
    toe_gps_ns = nearest_ns(round(v[11] * NS_PER_S) + offset_ns, WEEK_NS, toc_gps_ns)
    message = _message(satellite, system, v)
    health, accuracy_m, delays = _whole(v[24]), v[23], (v[25], v[26])
    issue, issue_clock = _whole(v[3]), _whole(v[26])
    fit = 0.0 if math.isnan(v[28]) else v[28]
    if system in (System.GPS, System.QZSS):
        delays = v[25], 0.0
    elif system is System.GALILEO:
        issue_clock, fit, health = issue, 0.0, _galileo_health(health, message)
    elif system is System.BEIDOU:
        issue_clock, fit = _whole(v[28]), 0.0
    else:  # NavIC
        issue_clock, fit, delays = issue, 0.0, (v[25], 0.0)
    return KeplerEphemeris(
        satellite=satellite,
        message=message,
        t_receive_ns=_on_air(system, toe_gps_ns, v[27], offset_ns),
        toe_gps_ns=toe_gps_ns,
        toc_gps_ns=toc_gps_ns,
        issue=issue,
        issue_clock=issue_clock,
        clock_bias_s=_finite(v[0]),
        clock_drift_s_s=_finite(v[1]),
        clock_drift_rate_s_s2=_finite(v[2]),
        sqrt_semi_major_axis_sqrt_m=_finite(v[10]),
        eccentricity=_finite(v[8]),
        mean_anomaly_rad=_finite(v[6]),
        mean_motion_difference_rad_s=_finite(v[5]),
        inclination_rad=_finite(v[15]),
        inclination_rate_rad_s=_finite(v[19]),
        ascending_node_rad=_finite(v[13]),
        ascending_node_rate_rad_s=_finite(v[18]),
        argument_of_perigee_rad=_finite(v[17]),
        cuc_rad=_finite(v[7]),
        cus_rad=_finite(v[9]),
        crc_m=_finite(v[16]),
        crs_m=_finite(v[4]),
        cic_rad=_finite(v[12]),
        cis_rad=_finite(v[14]),
        group_delay_s=(float(np.nan_to_num(delays[0])), float(np.nan_to_num(delays[1]))),
        health=health,
        accuracy_index=_sisa_index(accuracy_m) if system is System.GALILEO else ura_index(accuracy_m),
        fit_interval_h=fit,
    )


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError("a blank element")
    return value


def _message(satellite: int, system: System, v: list[float]) -> str:
    if system is System.GALILEO:
        sources = _whole(v[20])
        return "FNAV" if sources & _FNAV_CLOCK_BIT or sources & 0x307 == _FNAV_BIT else "INAV"
    if system is System.BEIDOU:
        return "D2" if satellite % 64 + 1 in _GEO_NUMBERS else "D1"
    return "LNAV"


def _on_air(system: System, t_reference_gps_ns: int, transmission_tow_s: float, offset_ns: int) -> int:
    """Transmission time as GPS time, or the fallback of this module's docstring."""
    fallback_ns = t_reference_gps_ns - _LEAD_NS.get(system, 0) * NS_PER_S
    if math.isnan(transmission_tow_s) or abs(transmission_tow_s) >= _UNKNOWN:
        return fallback_ns
    t_ns = nearest_ns(round(transmission_tow_s * NS_PER_S) + offset_ns, WEEK_NS, t_reference_gps_ns)
    return t_ns if abs(t_ns - t_reference_gps_ns) <= DAY_NS else fallback_ns


def _glonass(satellite: int, toe_gps_ns: int, v: list[float]) -> GlonassEphemeris:
    """A state vector; clock bias is −tau_n already, positions km, and 3.05's fourth line may be missing."""
    toe_utc_ns = utc_ns_from_gps(toe_gps_ns)
    toe_gps_ns -= toe_utc_ns % (900 * NS_PER_S)  # some writers put the frame's time where t_b belongs
    x, vx, ax, health, y, vy, ay, channel, z, vz, az, age = (_finite(value) for value in v[3:15])
    delay_s = v[16]
    return GlonassEphemeris(
        satellite=satellite,
        t_receive_ns=_on_air(System.GLONASS, toe_gps_ns, v[2], gps_minus_utc_s(toe_gps_ns) * NS_PER_S),
        toe_gps_ns=toe_gps_ns,
        issue=glonass_issue(utc_ns_from_gps(toe_gps_ns)),
        frequency_channel=_glonass_channel(round(channel)),
        position_pz90_m=(x * 1e3, y * 1e3, z * 1e3),
        velocity_pz90_m_s=(vx * 1e3, vy * 1e3, vz * 1e3),
        acceleration_pz90_m_s2=(ax * 1e3, ay * 1e3, az * 1e3),
        clock_bias_s=_finite(v[0]),
        frequency_bias=_finite(v[1]),
        group_delay_s=0.0 if math.isnan(delay_s) or abs(delay_s) >= _UNKNOWN else delay_s,
        health=round(health),
        age_days=round(age),
    )


def _glonass_channel(channel: int) -> int:
    """Channel −7…+6: some writers code the negative ones as 249…255."""
    return channel - 256 if channel > 128 else channel


def _galileo_health(bits: int, message: str) -> int:
    """Health as 1045 (DF314 status, DF315 validity) and 1046 (DF316, DF317 status, DF287, DF288 validity) code it.

    RINEX: bit 0 E1B validity, 1–2 E1B status, 3 E5a validity, 4–5 E5a status, 6 E5b validity, 7–8 E5b status.
    """
    if message == "FNAV":
        return (bits >> 4 & 3) << 1 | bits >> 3 & 1
    return (bits >> 7 & 3) << 4 | (bits >> 6 & 1) << 3 | (bits >> 1 & 3) << 1 | bits & 1


def ura_index(accuracy_m: float) -> int:
    """Index 0…15 of a user range accuracy, m (IS-GPS-200, 20.3.3.3.1.3): the least whose upper limit holds it."""
    if math.isnan(accuracy_m) or accuracy_m < 0:
        return 15
    return bisect_left(_URA_M, accuracy_m)


def _sisa_index(accuracy_m: float) -> int:
    """Index of a signal-in-space accuracy, m (Galileo OS SIS ICD, table 77); 255: no prediction available."""
    if math.isnan(accuracy_m) or not 0.0 <= accuracy_m <= 6.0:
        return 255
    for first, start_m, step_m in ((100, 2.0, 0.16), (75, 1.0, 0.04), (50, 0.5, 0.02)):
        if accuracy_m >= start_m:
            return first + round((accuracy_m - start_m) / step_m)
    return round(accuracy_m / 0.01)
