"""Ephemeris and SSR fields, frame by frame, against pyrtcm's decoding of the recordings."""

from pathlib import Path

import pytest

from plumbline.rtcm3 import Message, decode, scan_frames
from plumbline.rtcm3.fields import Group, Row, table_of

pyrtcm = pytest.importorskip("pyrtcm")
PYRTCM_FIELDS = pytest.importorskip("pyrtcm.rtcmtypes_core").RTCM_DATA_FIELDS

FRAMES_PER_TYPE = 25
#: pyrtcm does not know phase biases, reads 1258's draft layout as the standard's and 1264's layers one too few.
UNREADABLE = {1258, 1264, *range(1265, 1271)}
FILES = {
    "has-idd-2023-229/idd2023229c.rtc": {1019, 1046, 1059, 1060, 1242, 1243},
    "madoca-2025-091/madocalib_2025091A.204.rtcm3": {
        *(1057, 1058, 1059, 1061, 1063, 1064, 1065, 1067, 1240, 1241, 1242, 1244),
        *(1246, 1247, 1248, 1250, 1259, 1260, 1262),
    },
    "str-2018-195/week-rollover-STR17.rtcm3": {1019, 1020, 1044, 1045},
    "str-2018-195/week-rollover-STR24.rtcm3": {1019, 1020, 1042, 1044, 1045, 1046},
    "sc134-2026-037/SSRTEST_20260206_CORR.bin": {
        *(1019, 1046, 1057, 1058, 1059, 1063, 1064, 1065, 1240, 1241, 1242),
    },
}  # fmt: skip


def raw(row: Row, value) -> int:
    """The integer on the wire that a decoded value stands for, signed as the row is."""
    return round(value / row.scale) - row.offset if row.scale is not None else int(value) - row.offset


def peers_raw(parsed, df: str, suffix: str) -> int:
    """The integer that pyrtcm has scaled."""
    resolution = PYRTCM_FIELDS[df][2]
    return round(getattr(parsed, df + suffix) / (resolution if resolution not in (0, 1) else 1))


def compare(rows, fields, parsed, suffix=""):
    """Every row's raw value against pyrtcm's attribute of the same data field; returns the number compared."""
    n = 0
    for row in rows:
        if isinstance(row, Group):
            for k, repeat in enumerate(fields[row.name], start=1):
                n += compare(row.rows, repeat, parsed, f"{suffix}_{k:02d}")
        elif row.df not in ("DF001", "DF002"):
            assert raw(row, fields[row.name]) == peers_raw(parsed, row.df, suffix), (row.df, suffix)
            n += 1
    return n


@pytest.mark.realdata
@pytest.mark.parametrize("file", FILES)
def test_fields_agree_with_pyrtcm(data_dir: Path, file: str):
    data = (data_dir / file).read_bytes()
    seen: dict[int, int] = {}
    compared = 0
    for frame in scan_frames(data).frames:
        message = decode(frame.payload)
        if not isinstance(message, Message) or message.number in UNREADABLE or message.number not in FILES[file]:
            continue
        seen[message.number] = seen.get(message.number, 0) + 1
        if seen[message.number] > FRAMES_PER_TYPE:
            continue
        parsed = pyrtcm.RTCMMessage(payload=frame.payload)
        compared += compare(table_of(message.number).rows, message.fields, parsed)
    assert set(seen) == FILES[file]
    assert compared > 1000
