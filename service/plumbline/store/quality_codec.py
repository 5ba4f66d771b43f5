"""A quality report as bytes: what is one number an epoch as JSON, what is one an observation as float32 columns, zlib.

Layout before zlib: length of the JSON (uint32), the JSON in UTF-8, then each column little-endian one after another.
"""

import json
import struct
import zlib
from typing import Any, Final

import numpy as np

from plumbline.records import QualityReport

#: Columns (m,) or (m, k): field, stored type, record's type, k.
_COLUMNS: Final = (
    ("satellite", "<i2", np.int16, 1),
    ("is_phase", "|b1", np.bool_, 1),
    ("signals", "<i2", np.int16, 2),
    *((name, "<f4", np.float64, 1) for name in ("residual_m", "sigma_m", "redundancy", "mdb_m", "w")),
    ("external_enu_m", "<f4", np.float64, 3),
    *((name, "<f4", np.float64, 1) for name in ("qdop", "elevation_rad", "azimuth_rad")),
    ("verdict", "|i1", np.int8, 1),
)
_SCALARS: Final = ("hdop", "vdop", "pdop", "protection_horizontal_m", "protection_vertical_m", "integrity_risk")


def encode(report: QualityReport) -> bytes:
    """The report's content; station and times are the row's key."""
    head = {
        "m": int(report.satellite.size),
        "tests": dict(sorted(report.tests.items())),
        "events": list(report.events),
        **{name: getattr(report, name) for name in _SCALARS},
    }
    text = json.dumps(head).encode()
    columns = [np.ascontiguousarray(getattr(report, name), dtype).tobytes() for name, dtype, _, _ in _COLUMNS]
    return zlib.compress(struct.pack("<I", len(text)) + text + b"".join(columns), 1)


def decode(station: str, t_gps_ns: int, t_receive_ns: int, data: bytes) -> QualityReport:
    """The report of a row."""
    raw = zlib.decompress(data)
    (length,) = struct.unpack_from("<I", raw)
    head: dict[str, Any] = json.loads(raw[4 : 4 + length])
    m, offset = head.pop("m"), 4 + length
    columns: dict[str, Any] = {}
    for name, stored, wanted, k in _COLUMNS:
        column: Any = np.frombuffer(raw, stored, m * k, offset).astype(wanted)
        columns[name] = column.reshape(m, k) if k > 1 else column
        offset += m * k * np.dtype(stored).itemsize
    events = tuple(head.pop("events"))
    return QualityReport(station, t_gps_ns, t_receive_ns, events=events, **head, **columns)
