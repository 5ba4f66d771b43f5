"""Inspection. Oracle: a stream made here, of which everything is known; and the recordings' own counts."""

import json
from pathlib import Path

import numpy as np
import pytest

from plumbline.rtcm3 import Message, MsmHeader, encode, encode_observations, frame, scan_frames, warm_up
from plumbline.rtcm3 import crc24q as crc_module
from plumbline.rtcm3.framing import _scan
from plumbline.rtcm3.inspection import inspect_bytes
from plumbline.rtcm3.msm import _decode
from plumbline.rtcm3.msm_encoder import _encode
from plumbline.signals import System, satellite_id, signal_id


def _msm(tow_ms: int, number: int) -> bytes:
    row = np.array([2.2e7])
    ids = np.array([satellite_id(System.GALILEO, number)], dtype=np.int16)
    signals = np.array([signal_id(System.GALILEO, "5Q")], dtype=np.int16)
    none, channel = np.zeros(1, dtype=np.bool_), np.zeros(1, dtype=np.int8)
    header = MsmHeader(System.GALILEO, 7, 1, tow_ms)
    return frame(encode_observations(header, ids, signals, row, row, row * 0, row * 0, row * 0, none, channel)[0])


def _stream() -> bytes:
    descriptor = frame(encode(Message(1007, {"station": 1, "antenna_type": "X", "antenna_setup": 0})))
    bad_epoch = _msm(2**30 - 1, 9)
    return (
        b"$$"
        + _msm(86_400_500, 3)
        + descriptor
        + _msm(86_401_500, 11)
        + bad_epoch
        + frame(b"\xfe\xc2\x2a\x00")
        + b"\xd3"
    )


def test_json_form() -> None:
    entry = json.loads(inspect_bytes(_stream(), "a.rtcm3").to_json())
    assert entry["file"] == "a.rtcm3"
    assert entry["bytes"] == len(_stream())
    assert entry["rejected_bytes"] == {"noise": 2, "truncated": 1}
    assert {key: own["frames"] for key, own in entry["messages"].items()} == {"1007": 1, "1097": 3, "4076_021": 1}
    assert entry["messages"]["1097"] == {
        "frames": 3,
        "title": "GALILEO MSM7 observations",
        "first": "Mon 00:00:00.500 GST",
        "last": "Mon 00:00:01.500 GST",
        "first_s": 86_400.5,
        "last_s": 86_401.5,
        "satellites": ["E03", "E11"],
        "signals": ["5Q"],
        "malformed": {"epoch_out_of_range": 1},
    }
    assert entry["messages"]["4076_021"]["malformed"] == {"too_short": 1}


def test_text_form() -> None:
    text = inspect_bytes(_stream(), "a.rtcm3").to_text()
    for part in ("a.rtcm3", "1097        3  GALILEO MSM7", "2 satellites: E03 E11", "2 noise, 1 truncated"):
        assert part in text
    assert "bytes in no frame: none" in inspect_bytes(b"", "empty").to_text()


def test_titles_do_not_depend_on_which_frame_comes_first() -> None:
    broken_first = _msm(2**30 - 1, 9) + _msm(0, 9)
    assert inspect_bytes(broken_first, "").messages["1097"].title == "GALILEO MSM7 observations"


@pytest.mark.realdata
def test_counts_of_a_recording(data_dir: Path) -> None:
    data = (data_dir / "str-2018-195" / "week-rollover-STR17.rtcm3").read_bytes()
    inspection = inspect_bytes(data, "STR17")
    assert inspection.rejected_bytes == {"noise": 46}
    assert inspection.messages["1077"].frames == 1126
    assert inspection.messages["1127"].malformed == {"epoch_out_of_range": 14}
    assert inspection.messages["1019"].satellites <= inspection.messages["1077"].satellites


@pytest.mark.realdata
def test_after_warming_up_nothing_is_compiled(data_dir: Path) -> None:
    """A second signature of a kernel would compile at some station's first epoch."""
    warm_up()
    kernels = (_scan, _decode, _encode, crc_module.__globals__["crc24q_of"])
    before = [len(kernel.signatures) for kernel in kernels]
    for name in ("str-2018-195/week-rollover-STR24.rtcm3", "sc134-2026-037/ROVRMSG.bin"):
        data = (data_dir / name).read_bytes()[:200_000]
        assert scan_frames(data).frames
        inspect_bytes(data, name)
    _msm(5, 5)
    assert [len(kernel.signatures) for kernel in kernels] == before
