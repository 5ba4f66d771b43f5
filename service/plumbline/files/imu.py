"""IMU records in tables: a time, three specific forces, three angular rates.

Forms (``--imu-format``): ``plain`` has no header and the columns t (POSIX s), force in g, rate in rad/s, and what
comes after is left alone (the logger of rtklibexplorer); ``plain-gps`` is the same with GPS time written as if it were
POSIX time, no leap seconds; ``named`` has a header that names its columns and their units;
``dot`` is Movella DOT's export (header lines, then ``Acc_X``… m/s², ``Gyr_X``… °/s, a sample counter at 120 Hz).

A logger stamps samples with the time at which they were read, to the millisecond or worse, while the sensor samples
evenly: ``even_times`` fits the even grid that the stamps scatter about.
"""

import csv
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from plumbline.constants import STANDARD_GRAVITY_M_S2
from plumbline.errors import FileFormatError
from plumbline.files.text import LineSource
from plumbline.gps_time import GPS_EPOCH_UNIX_NS, NS_PER_S, gps_ns_from_unix_ns
from plumbline.records import Floats, Ints

FORMATS: Final = ("auto", "plain", "plain-gps", "named", "dot")
_FORCE_SCALE: Final = {"g": STANDARD_GRAVITY_M_S2, "mg": 1e-3 * STANDARD_GRAVITY_M_S2, "m/s2": 1.0, "": 1.0}
_RATE_SCALE: Final = {"deg/s": np.pi / 180.0, "dps": np.pi / 180.0, "rad/s": 1.0, "mrad/s": 1e-3, "": 1.0}
_DOT_INTERVAL_NS: Final = NS_PER_S // 120
_EVEN_WINDOW: Final = 400  # samples
_FORCE_NAMES: Final = re.compile(r"^(?:acc|accel|accelerometer|f|force|specific_force)[_ ]?([xyz])(.*)$", re.IGNORECASE)
_RATE_NAMES: Final = re.compile(r"^(?:gyr|gyro|gyroscope|w|omega|rate|angular_rate)[_ ]?([xyz])(.*)$", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class ImuSeries:
    """Samples in the sensor's own axes. ``angular_rate_rad_s`` is NaN where the file has none."""

    t_gps_ns: Ints  # (n,) ascending; a file without a date counts from zero
    specific_force_m_s2: Floats  # (n, 3)
    angular_rate_rad_s: Floats  # (n, 3)

    @property
    def interval_s(self) -> float:
        """Mean sample interval."""
        return float(self.t_gps_ns[-1] - self.t_gps_ns[0]) / NS_PER_S / max(self.t_gps_ns.size - 1, 1)


def read_imu(path: Path, form: str = "auto") -> ImuSeries:
    """Samples of a table, plain or gzip; raises FileFormatError where it is not one of the forms."""
    rows = list(csv.reader(line.decode("utf-8", "replace") for line in LineSource(path)))
    rows = [row for row in rows if row and any(cell.strip() for cell in row)]
    if form == "auto":
        form = _form_of(rows)
    if not rows or form not in FORMATS:
        raise FileFormatError(f"{path}: not an IMU table")
    try:
        series = _plain(rows, form == "plain") if form.startswith("plain") else _named(rows, path)
    except (ValueError, IndexError) as error:
        raise FileFormatError(f"{path}: {error}") from error
    if (np.diff(series.t_gps_ns) <= 0).any():
        raise FileFormatError(f"{path}: times do not increase")
    return series


def even_times(t_gps_ns: Ints) -> Ints:
    """Times (n,) of an even grid about which stamps scatter, drifting slowly: a running straight-line fit.

    Stamps with gaps (longer than 1.8 intervals) are taken apart at the gaps.
    """
    steps = np.diff(t_gps_ns)
    usual = float(np.median(steps)) if steps.size else 1.0
    cuts = np.flatnonzero(steps > 1.8 * usual) + 1
    parts = [_smoothed(part) for part in np.split(t_gps_ns, cuts)]
    times: Ints = np.concatenate(parts)
    return times if (np.diff(times) > 0).all() else t_gps_ns


def _smoothed(t_gps_ns: Ints) -> Ints:
    """Straight lines fitted to overlapping windows, blended."""
    n = t_gps_ns.size
    if n < 16:
        return t_gps_ns
    origin, index = int(t_gps_ns[0]), np.arange(n)
    t = (t_gps_ns - origin).astype(float)
    fitted, weight = np.zeros(n), np.zeros(n)
    half = max(min(_EVEN_WINDOW, n) // 2, 8)
    for begin in range(0, max(n - half, 1), half):
        part = slice(begin, min(begin + 2 * half, n))
        line = np.polynomial.Polynomial.fit(index[part], t[part], 1)
        hat = np.minimum(index[part] - part.start + 1, part.stop - index[part]).astype(float)
        fitted[part] += hat * line(index[part])
        weight[part] += hat
    times: Ints = origin + np.rint(fitted / weight).astype(np.int64)
    return times


def _form_of(rows: list[list[str]]) -> str:
    if rows and _number(rows[0][0]) is not None:
        return "plain"
    return (
        "dot"
        if any("SampleTimeFine" in cell or "PacketCounter" in cell for row in rows[:20] for cell in row)
        else "named"
    )


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def _plain(rows: list[list[str]], posix: bool) -> ImuSeries:
    table = np.array([[float(cell) for cell in row[1:7]] for row in rows])
    stamps = [_nanoseconds(row[0]) for row in rows]
    times = [gps_ns_from_unix_ns(t) if posix else t - GPS_EPOCH_UNIX_NS for t in stamps]
    return ImuSeries(np.array(times, np.int64), table[:, 0:3] * STANDARD_GRAVITY_M_S2, table[:, 3:6])


def _named(rows: list[list[str]], path: Path) -> ImuSeries:
    at = next(
        (i for i, row in enumerate(rows) if sum(bool(_FORCE_NAMES.match(cell.strip())) for cell in row) == 3), None
    )
    if at is None:
        raise FileFormatError(f"{path}: no header that names three specific forces")
    header = [cell.strip() for cell in rows[at]]
    body = [row for row in rows[at + 1 :] if len(row) >= len(header) - 1]
    dot = "PacketCounter" in header or "SampleTimeFine" in header
    force = _three(header, body, _FORCE_NAMES, _FORCE_SCALE, "m/s2")
    rate = _three(header, body, _RATE_NAMES, _RATE_SCALE, "deg/s" if dot else "rad/s")
    if force is None:
        raise FileFormatError(f"{path}: no specific force")
    return ImuSeries(_times(header, body, dot), force, np.full_like(force, np.nan) if rate is None else rate)


def _three(
    header: list[str], body: list[list[str]], names: "re.Pattern[str]", scales: dict[str, float], usual: str
) -> Floats | None:
    """Three columns, x, y, z, in SI."""
    found = {match[1].lower(): (i, match[2]) for i, cell in enumerate(header) if (match := names.match(cell))}
    if sorted(found) != ["x", "y", "z"]:
        return None
    unit = re.sub(r"[\[\]()_ ]", "", found["x"][1]).replace("^", "").replace("²", "2").replace("ms2", "m/s2")
    scale = scales.get(unit, scales[usual]) if unit else scales[usual]
    values: Floats = scale * np.array([[float(row[found[axis][0]]) for axis in "xyz"] for row in body])
    return values


def _times(header: list[str], body: list[list[str]], dot: bool) -> Ints:
    """Times of a named table: GPS or POSIX seconds, or none (a counter at the sensor's rate)."""
    lowered = [name.lower() for name in header]
    for name, posix in (("t_gps_s", False), ("t_unix_s", True), ("t_utc_s", True), ("unix", True), ("t_s", False)):
        if name in lowered:
            times = [_nanoseconds(row[lowered.index(name)]) for row in body]
            return np.array([gps_ns_from_unix_ns(t) for t in times] if posix else times, np.int64)
    if not dot:
        raise ValueError("no time column: name it t_gps_s, t_unix_s or t_s")
    counter = np.arange(len(body), dtype=np.int64)
    if "packetcounter" in lowered:
        counter = np.array([int(float(row[lowered.index("packetcounter")])) for row in body], np.int64)
    grid: Ints = (counter - counter[0]) * _DOT_INTERVAL_NS
    return grid


def _nanoseconds(text: str) -> int:
    """Decimal seconds as integer ns, exactly."""
    whole, _, decimals = text.strip().partition(".")
    return int(whole) * NS_PER_S + int((decimals + "0" * 9)[:9])
