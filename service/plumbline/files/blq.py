"""Ocean loading coefficients in BLQ format (IERS Conventions 2010, section 7.1.2)."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from plumbline.files.text import LineSource
from plumbline.records import Floats

#: The columns: main tides in BLQ's order.
TIDES: Final = ("M2", "S2", "N2", "K2", "K1", "O1", "P1", "Q1", "MF", "MM", "SSA")
_ROWS = 6


@dataclass(frozen=True, slots=True)
class OceanLoading:
    """Amplitudes, m, and Greenwich phase lags, rad, both (3, 11): rows radial, west, south; columns ``TIDES``."""

    amplitude_m: Floats
    phase_rad: Floats


def read_blq(path: Path | str) -> Mapping[str, OceanLoading]:
    """Coefficients by station name, upper case. Raises FileFormatError."""
    source = LineSource(path)
    stations: dict[str, OceanLoading] = {}
    name, rows = "", list[list[float]]()
    for raw in source:
        line = raw.decode("ascii", "replace")
        if line.startswith("$$") or not line.strip():
            continue
        if not rows and not _is_row(line):
            name = line.strip().upper()
            continue
        try:
            rows.append([float(part) for part in line.split()])
        except ValueError as error:
            raise source.error(f"damaged coefficients of {name!r}: {error}") from error
        if len(rows[-1]) != len(TIDES) or not name:
            raise source.error("not ocean loading coefficients in BLQ format")
        if len(rows) == _ROWS:
            table = np.array(rows)
            stations[name] = OceanLoading(table[:3], np.radians(table[3:]))
            name, rows = "", []
    if rows or not stations:
        raise source.error("not ocean loading coefficients in BLQ format")
    return stations


def _is_row(line: str) -> bool:
    parts = line.split()
    return len(parts) == len(TIDES) and all(part.lstrip("-+").replace(".", "", 1).isdigit() for part in parts)
