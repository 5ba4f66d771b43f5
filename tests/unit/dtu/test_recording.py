"""A recording's pieces: all of its bytes, in order, due when its own frames say."""

from pathlib import Path

import pytest
from tests.unit.dtu.frames import inertial, msm

from plumbline.epochs.recording import merge, read_recording
from plumbline.gps_time import NS_PER_S
from plumbline.rtcm3 import frame
from plumbline.signals import System

WEEK_S = 604_800


def seconds(path: Path, data: bytes) -> list[float]:
    path.write_bytes(data)
    pieces = read_recording(path, "s")
    assert b"".join(piece.data for piece in pieces) == data
    return [(piece.t_ns - pieces[0].t_ns) / NS_PER_S for piece in pieces]


def test_times_of_all_kinds(tmp_path: Path) -> None:
    """Oracle: the times that were encoded; BeiDou's 14 s behind; what has no time waits with its neighbour."""
    data = b"boot\r\n" + frame(bytes((0x3F, 0xC0, 1))) + msm(System.GPS, 100_000) + msm(System.BEIDOU, 86_000)
    data += inertial(100_500) + msm(System.GALILEO, 101_000) + b"\r\ntail"
    assert seconds(tmp_path / "r", data) == [0.0, 0.0, 0.0, 0.5, 1.0, 1.0]


def test_week_rolls_over(tmp_path: Path) -> None:
    """Oracle: two seconds pass from the last to the first second of a week."""
    data = msm(System.GPS, (WEEK_S - 1) * 1000) + msm(System.GPS, 1000)
    assert seconds(tmp_path / "r", data) == [0.0, 2.0]


def test_a_wild_time_is_not_waited_for(tmp_path: Path) -> None:
    """Oracle: one frame hours ahead leaves the pace alone; three in agreement are a real gap."""
    wild = msm(System.GPS, 100_000) + msm(System.BEIDOU, 90_000_000) + msm(System.GPS, 101_000)
    assert seconds(tmp_path / "wild", wild) == [0.0, 0.0, 1.0]
    gap = msm(System.GPS, 100_000) + b"".join(msm(System.GPS, 7_300_000 + k * 1000) for k in range(4))
    assert seconds(tmp_path / "gap", gap) == [0.0, 0.0, 0.0, 7202.0, 7203.0]


def test_glonass_alone_has_a_pace(tmp_path: Path) -> None:
    """Oracle: its own milliseconds of the day, midnight included."""
    data = msm(System.GLONASS, 86_399_000, 2) + msm(System.GLONASS, 0, 3) + msm(System.GLONASS, 2_000, 3)
    assert seconds(tmp_path / "r", data) == [0.0, 1.0, 3.0]


def test_recordings_are_merged_in_time_and_in_the_order_given(tmp_path: Path) -> None:
    """Oracle: sorted by time, ties by the order of the files, across the end of a week."""
    (tmp_path / "a").write_bytes(msm(System.GPS, (WEEK_S - 1) * 1000) + msm(System.GPS, 0))
    (tmp_path / "b").write_bytes(msm(System.GPS, (WEEK_S - 1) * 1000) + msm(System.GPS, 0))
    first = read_recording(tmp_path / "a", "a")
    second = read_recording(tmp_path / "b", "b", t_near_ns=first[0].t_ns)
    assert [piece.stream for piece in merge([first, second])] == ["a", "b", "a", "b"]


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("name", "span_s"),
    [
        ("str-2018-195/week-rollover-STR17.rtcm3", (1100, 1300)),
        ("sc134-2026-037/SSRTEST_20260206_CORR.bin", (2500, 3000)),
        ("has-idd-2023-229/idd2023229c.rtc", (3500, 3700)),
        ("madoca-2025-091/madocalib_2025091A.204.rtcm3", (3500, 3700)),
    ],
)
def test_recordings_have_the_span_that_their_description_says(
    data_dir: Path, name: str, span_s: tuple[int, int]
) -> None:
    """Oracle: the recordings' description: minutes and hours; no byte is lost."""
    pieces = read_recording(data_dir / name, "s")
    assert sum(len(piece.data) for piece in pieces) == (data_dir / name).stat().st_size
    assert span_s[0] <= (pieces[-1].t_ns - pieces[0].t_ns) / NS_PER_S <= span_s[1]
