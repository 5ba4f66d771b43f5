"""Oracle: pyrtcm, an independent decoder, frame by frame on every recording: which frames there are and their fields.

pyrtcm is given one payload at a time, since its own reader loses the frames behind a false preamble.
"""

import math
import os
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyrtcm import RTCMMessage, calc_crc24q
from pyrtcm.rtcmtypes_core import RTCM_DATA_FIELDS

from plumbline.constants import LIGHT_MILLISECOND_M
from plumbline.rtcm3 import Frame, Malformed, Message, Observations, decode, scan_frames
from plumbline.rtcm3.fields import Fields, Group, Item, Row, Table, Text, Values, table_of
from plumbline.rtcm3.msm_layout import least_lock_ms
from plumbline.rtcm3.ssr import beidou_orbit_is_draft
from plumbline.signals import System, number_of, signal_code

pytestmark = pytest.mark.realdata

FILES = (
    "str-2018-195/week-rollover-STR17.rtcm3",
    "str-2018-195/week-rollover-STR24.rtcm3",
    "sc134-2026-037/ROMAMSG.bin",
    "sc134-2026-037/ROVRMSG.bin",
    "sc134-2026-037/SSRTEST_20260206_CORR.bin",
    "has-idd-2023-229/idd2023229c.rtc",
    "madoca-2025-091/madocalib_2025091A.204.rtcm3",
)
# Frames a type whose fields are compared, evenly spread over a file; a great number compares all (some minutes).
FRAMES_A_TYPE = int(os.environ.get("PLUMBLINE_ORACLE_FRAMES", "25"))


@cache
def _scan(path: Path) -> tuple[bytes, tuple[Frame, ...], dict[str, int]]:
    data = path.read_bytes()
    scan = scan_frames(data)
    return data, scan.frames, scan.rejected_bytes


def _sample(frames: tuple[Frame, ...]) -> list[Frame]:
    by_number: dict[int, list[Frame]] = {}
    for frame in frames:
        by_number.setdefault(frame.number, []).append(frame)
    return [f for own in by_number.values() for f in own[:: max(len(own) // FRAMES_A_TYPE, 1)]]


@pytest.mark.parametrize("name", FILES)
def test_every_byte_is_a_frames_or_rejected_and_every_frame_has_pyrtcms_crc(data_dir: Path, name: str) -> None:
    data, frames, rejected = _scan(data_dir / name)
    assert sum(len(f.payload) + 6 for f in frames) + sum(rejected.values()) == len(data)
    for frame in _sample(frames):
        assert calc_crc24q(data[frame.offset : frame.end]) == 0
        assert frame.number == int(RTCMMessage(payload=frame.payload).identity[:4])


@pytest.mark.parametrize("name", FILES)
def test_no_frame_that_pyrtcm_finds_is_missing(data_dir: Path, name: str) -> None:
    """The plainest search, with pyrtcm's CRC, of every place between the frames where another could begin."""
    data, frames, _ = _scan(data_dir / name)
    ends = 0
    for frame in [*frames, None]:
        gap_end = len(data) if frame is None else frame.offset
        at = data.find(b"\xd3", ends, gap_end)
        while at >= 0:
            length = int.from_bytes(data[at + 1 : at + 3], "big")
            complete = at + 6 + length <= len(data) and length < 1024
            assert not complete or calc_crc24q(data[at : at + 6 + length]) != 0
            at = data.find(b"\xd3", at + 1, gap_end)
        ends = gap_end if frame is None else frame.end


@pytest.mark.parametrize("name", FILES)
def test_fields_agree_with_pyrtcm(data_dir: Path, name: str) -> None:
    compared: Counter[int] = Counter()
    for frame in _sample(_scan(data_dir / name)[1]):
        theirs = RTCMMessage(payload=frame.payload)
        ours = decode(frame.payload)
        if isinstance(ours, Observations):
            _compare_observations(ours, theirs)
        elif isinstance(ours, Message):
            table = table_of(ours.number, ours.subtype)
            assert table is not None
            if not _is_draft(ours):  # a layout that pyrtcm does not know
                _compare_tables(table, ours, theirs)
        elif isinstance(ours, Malformed):
            assert (ours.reason, theirs.DF427 >= 604_800_000) == ("epoch_out_of_range", True)
        compared[frame.number] += 1
    assert compared.total() > 70


def _is_draft(message: Message) -> bool:
    return message.number in (1258, 1261) and bool(beidou_orbit_is_draft(message))


def _compare_observations(ours: Observations, theirs: RTCMMessage) -> None:
    epoch_field = {System.GLONASS: "DF034", System.GALILEO: "DF248", System.QZSS: "DF428", System.BEIDOU: "DF427"}
    assert ours.epoch_ms == getattr(theirs, epoch_field.get(ours.system, "DF004"))
    if ours.system is System.GLONASS:
        assert (7 if ours.day_of_week is None else ours.day_of_week) == theirs.DF416
    header = (ours.station, ours.multiple_message, ours.iods, ours.clock_steering, ours.external_clock)
    assert header == (theirs.DF003, theirs.DF393, theirs.DF409, theirs.DF411, theirs.DF412)
    assert (ours.smoothing, ours.smoothing_interval) == (theirs.DF417, theirs.DF418)
    assert ours.n_rows == theirs.NCell
    satellites = [number for number in range(1, 65) if theirs.DF394 >> (64 - number) & 1]
    for i in range(ours.n_rows):
        _compare_cell(ours, i, theirs, satellites, f"_{i + 1:02d}")


def _compare_cell(ours: Observations, i: int, theirs: RTCMMessage, satellites: list[int], suffix: str) -> None:
    def field(*names: str) -> Any:
        return next((getattr(theirs, name + suffix) for name in names if hasattr(theirs, name + suffix)), None)

    number = number_of(int(ours.satellite[i]))
    offset = {System.SBAS: 119, System.QZSS: 192}.get(ours.system, 0)
    assert field("CELLPRN") in (f"{number + offset:03d}", "N/A")  # pyrtcm knows no GLONASS slot above 24
    if signal_code(int(ours.signal[i])):
        assert field("CELLSIG") == signal_code(int(ours.signal[i]))
    own = f"_{satellites.index(number) + 1:02d}"
    whole, modulo = getattr(theirs, "DF397" + own), getattr(theirs, "DF398" + own)
    rough_m = math.nan if whole == 255 else (whole + modulo) * LIGHT_MILLISECOND_M
    fine_code, fine_phase = field("DF405", "DF400"), field("DF406", "DF401")
    no_code = -(2.0**-10)  # both widths: the most negative value
    no_phase = -(2.0**-8)
    code_m = math.nan if fine_code == no_code else rough_m + fine_code * LIGHT_MILLISECOND_M
    phase_m = math.nan if fine_phase == no_phase else rough_m + fine_phase * LIGHT_MILLISECOND_M
    np.testing.assert_allclose(ours.pseudorange_m[i], code_m, rtol=0, atol=1e-7)
    np.testing.assert_allclose(ours.phase_range_m[i], phase_m, rtol=0, atol=1e-7)
    cn0 = field("DF408", "DF403")
    np.testing.assert_equal(ours.cn0_db_hz[i], cn0 or math.nan)
    assert ours.half_cycle_ambiguous[i] == field("DF420")
    bits = 10 if hasattr(theirs, "DF407" + suffix) else 4
    assert ours.lock_time_s[i] == pytest.approx(least_lock_ms(field("DF407", "DF402"), bits) * 1e-3)
    fine_rate = field("DF404")
    if fine_rate is not None:
        rough_rate = getattr(theirs, "DF399" + own)
        missing = rough_rate == -8192 or fine_rate == -16384 * 1e-4
        expected = math.nan if missing else rough_rate + fine_rate
        np.testing.assert_allclose(ours.phase_range_rate_m_s[i], expected, rtol=0, atol=1e-9)
    if ours.system is System.GLONASS and hasattr(theirs, "DF419" + own):
        assert ours.glonass_channel[i] == getattr(theirs, "DF419" + own) - 7


def _compare_tables(table: Table, ours: Message, theirs: RTCMMessage) -> None:
    """Every row whose DF number pyrtcm has: their values, unscaled by neither, mean the same number."""
    for row, value, suffix in _walk(table, ours):
        name = row.df + suffix
        if isinstance(row, Text):
            expected = _text(theirs, row.df)
            assert expected is None or value == expected
        elif value is not None and hasattr(theirs, name) and not isinstance(getattr(theirs, name), str):
            _compare_number(row, value, getattr(theirs, name))


def _text(theirs: RTCMMessage, df: str) -> str | None:
    characters = [value for name, value in vars(theirs).items() if name == df or name.startswith(df + "_")]
    return "".join(characters) if characters and all(isinstance(c, str) for c in characters) else None


def _compare_number(row: Row, ours: float, theirs: float) -> None:
    """pyrtcm leaves angles in semicircles and some lengths in mm or km: what must agree is the integer on the wire."""
    raw = (round(ours / row.scale) if row.scale else int(ours)) - row.offset
    resolution = RTCM_DATA_FIELDS[row.df][2] or 1
    assert math.isclose(theirs, raw * resolution, rel_tol=1e-12), (row, ours, theirs)


def _walk(table: Table, message: Message) -> Iterator[tuple[Row | Text, Any, str]]:
    def visit(rows: tuple[Item, ...], fields: Fields, suffix: str) -> Iterator[tuple[Row | Text, Any, str]]:
        for row in rows:
            if isinstance(row, Group):
                for i, own in enumerate(fields[row.name], 1):
                    yield from visit(row.rows, own, f"{suffix}_{i:02d}")
            elif isinstance(row, Values):
                continue
            elif row.name in fields:
                yield row, fields[row.name], suffix

    yield from visit(table.rows, message.fields, "")
