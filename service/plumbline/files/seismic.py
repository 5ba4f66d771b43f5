"""Series of displacement or acceleration from SAC, MiniSEED or CSV files.

Counts of a seismic sensor become m/s² with the sensitivity of its SAC pole-zero file: a sensor is flat where structures
move, so a constant gain serves. SAC and MiniSEED carry UTC.
"""

import csv
import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import obspy

from plumbline.errors import FileFormatError
from plumbline.files.text import LineSource
from plumbline.gps_time import GPS_EPOCH_UNIX_NS, NS_PER_S, gps_ns_from_unix_ns
from plumbline.records import Floats

_SUFFIXES_OF_TABLES = (".csv", ".txt", ".csv.gz", ".txt.gz")
_UNITS: Final = {"m": "m", "mm": "m", "cm": "m", "m/s2": "m/s2", "m/s^2": "m/s2", "m/s²": "m/s2", "g": "m/s2"}
_SCALES: Final = {"mm": 1e-3, "cm": 1e-2, "g": 9.80665}
_NUMBER = r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?"
_EVENNESS = 0.25  # a sample may be off the even grid by this part of the interval


@dataclass(frozen=True, slots=True)
class Series:
    """Evenly spaced samples, NaN where missing; ``values`` (n, components)."""

    t_first_gps_ns: int
    interval_ns: int
    values: Floats
    unit: str  # "m", "m/s2", "counts", or "" where the file does not say
    components: tuple[str, ...]

    @property
    def t_gps_ns(self) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """Time of each sample, (n,)."""
        return self.t_first_gps_ns + self.interval_ns * np.arange(len(self.values), dtype=np.int64)


def read_series(path: Path | str, pole_zero_path: Path | str | None = None) -> Series:
    """Read a series; with a pole-zero file, counts become m/s². Raises FileFormatError.

    A CSV has a first column of time (named ``t_unix_s`` or ``t_utc_s``: POSIX time; else seconds of GPS time since
    1980-01-06) and a column per component; a unit may stand in a column's name after the last ``_`` or in brackets:
    ``e_mm``, ``z_m/s2``, ``up [m]``.
    """
    path = Path(path)
    series = _read_table(path) if path.name.lower().endswith(_SUFFIXES_OF_TABLES) else _read_seismogram(path)
    if pole_zero_path is None:
        return series
    return replace(series, values=series.values / read_sensitivity(pole_zero_path), unit="m/s2")


def read_components(
    paths: "list[Path | str] | tuple[Path | str, ...]", pole_zero_paths: "tuple[Path | str, ...]" = ()
) -> Series:
    """Several one-component files as one series on the common time span; same interval, starts within half of it."""
    parts = [read_series(path, pole_zero_paths[k] if pole_zero_paths else None) for k, path in enumerate(paths)]
    interval_ns = parts[0].interval_ns
    if any(part.interval_ns != interval_ns or part.unit != parts[0].unit for part in parts):
        raise FileFormatError(f"{paths[0]} and its companions differ in sampling interval or unit")
    first_ns = max(part.t_first_gps_ns for part in parts)
    starts = [round((first_ns - part.t_first_gps_ns) / interval_ns) for part in parts]
    length = min(len(part.values) - start for part, start in zip(parts, starts, strict=True))
    if length <= 0:
        raise FileFormatError(f"{paths[0]} and its companions do not overlap in time")
    values = np.hstack([part.values[start : start + length] for part, start in zip(parts, starts, strict=True)])
    return Series(
        first_ns, interval_ns, values, parts[0].unit, tuple(name for part in parts for name in part.components)
    )


def read_sensitivity(path: Path | str) -> float:
    """Counts per m/s² of a SAC pole-zero file: its SENSITIVITY comment, else its gain at frequency zero."""
    try:
        text = Path(path).read_text(encoding="ascii", errors="replace")
    except OSError as error:
        raise FileFormatError(f"cannot read {path}: {error.strerror}") from error
    comment = re.search(rf"SENSITIVITY\s*:\s*({_NUMBER})\s*\((\S+)\)", text)
    if comment and comment[2].upper() in ("M/S**2", "M/S/S", "M/S^2"):
        return float(comment[1])
    constant = re.search(rf"^CONSTANT\s+({_NUMBER})", text, re.MULTILINE)
    if not constant:
        raise FileFormatError(f"{path}: no CONSTANT: not a SAC pole-zero file")
    gain = float(constant[1]) * _product(text, "ZEROS") / _product(text, "POLES")
    if not math.isfinite(gain.real) or gain.real == 0.0:
        raise FileFormatError(f"{path}: not an accelerometer: its gain at frequency zero is {gain.real:g}")
    return gain.real


def _product(text: str, keyword: str) -> complex:
    """Product of −root over the roots listed after ``keyword``: the factor's value at s = 0."""
    match = re.search(rf"^{keyword}\s+(\d+)", text, re.MULTILINE)
    if not match:
        return 1.0 + 0.0j
    after = text[match.end() :].partition("CONSTANT")[0]
    listed = re.findall(rf"^\s+({_NUMBER})\s+({_NUMBER})\s*$", after, re.MULTILINE)
    count = int(match[1])
    roots = [complex(float(re_part), float(im_part)) for re_part, im_part in listed[:count]]
    roots += [0j] * (count - len(roots))  # SAC: roots that are not listed are zero
    return complex(np.prod([-root for root in roots])) if roots else 1.0 + 0.0j


def _read_seismogram(path: Path) -> Series:
    try:
        stream = obspy.read(str(path))
    except (TypeError, ValueError, OSError) as error:
        raise FileFormatError(f"{path}: neither SAC nor MiniSEED nor CSV ({error})") from error
    stream.merge(fill_value=None)
    traces = sorted(stream, key=lambda trace: str(trace.stats.channel))
    first, last = max(t.stats.starttime for t in traces), min(t.stats.endtime for t in traces)
    cut = [trace.slice(first, last) for trace in traces]
    length = min(len(trace.data) for trace in cut)
    values: Floats = np.column_stack([np.ma.filled(np.ma.asarray(trace.data[:length], float), np.nan) for trace in cut])
    integer_or_counts = any(np.issubdtype(trace.data.dtype, np.integer) for trace in traces)
    return Series(
        t_first_gps_ns=gps_ns_from_unix_ns(int(cut[0].stats.starttime.ns)),
        interval_ns=round(float(f"{cut[0].stats.delta:.9g}") * NS_PER_S),
        values=values,
        unit="counts" if integer_or_counts else "",
        components=tuple(str(trace.stats.channel) for trace in cut),
    )


def _read_table(path: Path) -> Series:
    rows = list(csv.reader(line.decode("utf-8", "replace") for line in LineSource(path) if not line.startswith(b"#")))
    if not rows or len(rows[0]) < 2:
        raise FileFormatError(f"{path}: no table of a time and components")
    header = [name.strip() for name in rows[0]] if not _is_number(rows[0][0]) else []
    try:
        table = np.array([[float(cell or "nan") for cell in row] for row in rows[bool(header) :] if row], float)
    except ValueError as error:
        raise FileFormatError(f"{path}: {error}") from error
    if table.ndim != 2 or len(table) < 2:
        raise FileFormatError(f"{path}: rows of different lengths, or less than two")
    times = [_nanoseconds(row[0]) for row in rows[bool(header) :] if row]
    if header and header[0].lower() in ("t_unix_s", "t_utc_s", "unix", "utc"):
        times = [gps_ns_from_unix_ns(t) for t in times]
    elif times[0] > GPS_EPOCH_UNIX_NS * 5:  # nobody's GPS seconds before 2030
        raise FileFormatError(f"{path}: the first column is no GPS time; name it t_unix_s if it is POSIX time")
    names = header[1:] or [f"c{k}" for k in range(1, table.shape[1])]
    units = [_unit_of(name) for name in names]
    values = table[:, 1:] * [_SCALES.get(unit, 1.0) for unit in units]
    return _on_even_grid(path, times, values, _UNITS.get(units[0], ""), tuple(names))


def _on_even_grid(path: Path, times: list[int], values: Floats, unit: str, names: tuple[str, ...]) -> Series:
    """Put samples on an even grid, NaN in its gaps; raises where they are not near one."""
    t = np.array(times, np.int64)
    steps = np.diff(t)
    if (steps <= 0).any():
        raise FileFormatError(f"{path}: times do not increase")
    counts = np.rint(steps / np.quantile(steps, 0.5, method="lower")).astype(np.int64)
    if (counts < 1).any():
        raise FileFormatError(f"{path}: samples are not evenly spaced")
    interval_ns = round(float(steps.sum() / counts.sum()))
    index = np.concatenate([[0], np.cumsum(counts)])
    if np.abs(t - t[0] - index * interval_ns).max() > _EVENNESS * interval_ns:
        raise FileFormatError(f"{path}: samples are not evenly spaced")
    grid = np.full((index[-1] + 1, values.shape[1]), np.nan)
    grid[index] = values
    return Series(int(t[0]), interval_ns, grid, unit, names)


def _nanoseconds(text: str) -> int:
    """Decimal seconds as integer ns, exactly (a float of GPS seconds holds only 0.2 µs)."""
    text = text.strip()
    if "e" in text.lower():
        return round(float(text) * NS_PER_S)
    negative = text.startswith("-")
    whole, _, decimals = text.lstrip("+-").partition(".")
    value = int(whole or 0) * NS_PER_S + int((decimals + "0" * 9)[:9])
    return -value if negative else value


def _is_number(text: str) -> bool:
    return re.fullmatch(_NUMBER, text.strip()) is not None


def _unit_of(name: str) -> str:
    bracketed = re.search(r"[\[(]([^\])]+)[\])]\s*$", name)
    unit = bracketed[1].strip() if bracketed else name.rpartition("_")[2]
    if not bracketed and name.endswith(("_m_s2", "_m_s_2")):
        return "m/s2"
    return unit if unit in _UNITS else ""
