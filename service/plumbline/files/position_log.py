"""Positions that a receiver or RTKLIB has logged: RTKLIB's solution files (.pos), with or without velocities.

Columns are named by the file's own header line (RTKLIB manual 2.4.2, appendix B.1). Standard deviations of covariances
keep their sign: ``sdne`` is the signed root of the covariance.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from plumbline.constants import EARTH_ECCENTRICITY_SQUARED, EARTH_SEMI_MAJOR_AXIS_M
from plumbline.errors import FileFormatError
from plumbline.files.text import LineSource
from plumbline.gps_time import NS_PER_S, gps_ns, gps_ns_from_calendar, gps_ns_from_utc_ns
from plumbline.records import Floats, Solution, Status

_QUALITY: Final = {1: Status.RTK_FIXED, 2: Status.RTK_FLOAT, 3: Status.SINGLE_POINT, 4: Status.RTK_FLOAT,
                   5: Status.SINGLE_POINT, 6: Status.PPP_FLOAT}  # fmt: skip
_NAMES: Final = {"latitude(deg)": "lat", "longitude(deg)": "lon", "height(m)": "h"}


@dataclass(frozen=True, slots=True)
class _Columns:
    """Where the fields are."""

    index: dict[str, int]
    utc: bool

    def numbers(self, cells: list[str], names: tuple[str, ...]) -> Floats | None:
        """Values of columns; None where the file has not all of them."""
        if any(name not in self.index or self.index[name] >= len(cells) for name in names):
            return None
        return np.array([float(cells[self.index[name]]) for name in names])


def read_position_log(path: Path, station: str = "log") -> list[Solution]:
    """Solutions of a .pos file in latitude, longitude, height; raises FileFormatError for any other."""
    return list(_solutions(path, station))


def _solutions(path: Path, station: str) -> Iterator[Solution]:
    columns: _Columns | None = None
    for number, line in enumerate(LineSource(path), 1):
        text = line.decode("ascii", "replace").strip()
        if text.startswith("%"):
            columns = _header(text) or columns
        elif text:
            if columns is None:
                raise FileFormatError(f"{path}: no header line with latitude(deg), longitude(deg), height(m)")
            try:
                yield _solution(text.split(), columns, station)
            except (ValueError, IndexError) as error:
                raise FileFormatError(f"{path}, line {number}: {error}") from error


def _header(text: str) -> _Columns | None:
    names = text.lstrip("%").split()
    if "latitude(deg)" not in names or names[0] not in ("GPST", "UTC"):
        return None
    fields = [_NAMES.get(name, name.partition("(")[0]) for name in names[1:]]
    return _Columns({name: i + 2 for i, name in enumerate(fields)}, names[0] == "UTC")  # time takes two columns


def _solution(cells: list[str], columns: _Columns, station: str) -> Solution:
    place = columns.numbers(cells, ("lat", "lon", "h"))
    if place is None:
        raise ValueError("no position")
    t_ns = _time(cells[0], cells[1], columns.utc)
    quality = columns.numbers(cells, ("Q", "ns"))
    spread = columns.numbers(cells, ("sde", "sdn", "sdu", "sdne", "sdeu", "sdun"))
    velocity = columns.numbers(cells, ("ve", "vn", "vu"))
    velocity_spread = columns.numbers(cells, ("sdve", "sdvn", "sdvu"))
    names = ("sigma_ve_m_s", "sigma_vn_m_s", "sigma_vu_m_s")
    known = velocity_spread is not None and (velocity_spread > 0).all()
    extras = dict(zip(names, velocity_spread.tolist(), strict=True)) if known and velocity_spread is not None else {}
    return Solution(
        station=station,
        t_gps_ns=t_ns,
        t_receive_ns=t_ns,
        status=_QUALITY.get(int(quality[0]), Status.SINGLE_POINT) if quality is not None else Status.SINGLE_POINT,
        reason="",
        n_satellites=int(quality[1]) if quality is not None else 0,
        position_ecef_m=_ecef(np.radians(place[0]), np.radians(place[1]), place[2]),
        covariance_enu_m2=None if spread is None else _covariance(spread),
        velocity_enu_m_s=velocity,
        extras=extras,
    )


def _time(date: str, clock: str, utc: bool) -> int:
    """Time of ``YYYY/MM/DD hh:mm:ss.sss`` or ``week tow``, ns, exact to what is written."""
    if "/" not in date:
        return gps_ns(int(date), float(clock))
    year, month, day = (int(part) for part in date.split("/"))
    hour, minute, second = clock.split(":")
    whole, _, decimals = second.partition(".")
    second_ns = int(whole) * NS_PER_S + int((decimals + "0" * 9)[:9])
    t_ns = gps_ns_from_calendar(year, month, day, int(hour), int(minute), second_ns)
    return gps_ns_from_utc_ns(t_ns) if utc else t_ns


def _covariance(spread: Floats) -> Floats:
    """ENU covariance (3, 3) of sde, sdn, sdu, sdne, sdeu, sdun."""
    squared = np.sign(spread) * spread**2
    e, n, u, ne, eu, un = squared
    return np.array([[e, ne, eu], [ne, n, un], [eu, un, u]])


def _ecef(latitude_rad: float, longitude_rad: float, height_m: float) -> Floats:
    """Earth-fixed position; readers stand beside the physics and do not import it."""
    sine, cosine = np.sin(latitude_rad), np.cos(latitude_rad)
    n = EARTH_SEMI_MAJOR_AXIS_M / np.sqrt(1.0 - EARTH_ECCENTRICITY_SQUARED * sine * sine)
    level = (n + height_m) * cosine
    return np.array(
        [
            level * np.cos(longitude_rad),
            level * np.sin(longitude_rad),
            (n * (1.0 - EARTH_ECCENTRICITY_SQUARED) + height_m) * sine,
        ]
    )
