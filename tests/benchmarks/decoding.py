"""RTCM3 decoding: frames per second on a four-system MSM7 recording, against pyrtcm and RTKLIB's C decoder.

Run as ``python -m tests.benchmarks.decoding``. All read the same file in the same run. RTKLIB reads it by itself
(``input_rtcm3f``: no Python loop over bytes burdens it); here the file goes through the streaming reader in pieces as
they come from a socket, and every frame becomes a message object.
"""

import os
import time
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import pyrtklib5 as rtklib
from pyrtcm import RTCMReader
from tests.benchmarks.table import Row, format_rows, rate_row

from plumbline.rtcm3 import FrameReader, decode, frame, scan_frames, warm_up

RECORDING = "str-2018-195/week-rollover-STR17.rtcm3"
FOUR_SYSTEMS = (1077, 1087, 1097, 1127)
SEGMENT_BYTES = 4096
REPEATS = 7
PYRTCM_FRAMES = 400
END_OF_FILE = -2


def _data_dir() -> Path:
    return Path(os.environ.get("PLUMBLINE_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))


def _ours(data: bytes) -> None:
    reader = FrameReader()
    for at in range(0, len(data), SEGMENT_BYTES):
        reader.receive_data(data[at : at + SEGMENT_BYTES])
        while (found := reader.next_frame()) is not None:
            decode(found.payload)


def _rtklib(path: str) -> None:
    decoder = rtklib.rtcm_t()
    rtklib.init_rtcm(decoder)
    stream = rtklib.FileWrapper(path, "rb")
    while rtklib.input_rtcm3f(decoder, stream) != END_OF_FILE:
        pass


def _pyrtcm(data: bytes) -> None:
    for _ in RTCMReader(BytesIO(data)):
        pass


def _seconds(job: Callable[[], None]) -> float:
    start = time.perf_counter()
    job()
    return time.perf_counter() - start


def _measure(name: str, data: bytes, path: str, targets: tuple[float | None, float | None]) -> list[Row]:
    """Rows of one input; the contestants take turns so that a disturbance hits all."""
    frames = scan_frames(data).frames
    turns = [(_seconds(lambda: _ours(data)), _seconds(lambda: _rtklib(path))) for _ in range(REPEATS)]
    ours, theirs = (len(frames) / median(column) for column in zip(*turns, strict=True))
    beginning = data[: frames[min(len(frames), PYRTCM_FRAMES) - 1].end]
    slow = min(len(frames), PYRTCM_FRAMES) / median([_seconds(lambda: _pyrtcm(beginning)) for _ in range(3)])
    return [
        rate_row(name, "RTKLIB EX, C", ours, theirs, "frames/s", targets[0]),
        rate_row(name, "pyrtcm", ours, slow, "frames/s", targets[1]),
    ]


def run() -> list[Row]:
    """Measure; empty where the recordings are not there."""
    path = _data_dir() / RECORDING
    if not path.is_file():
        return []
    warm_up()
    data = path.read_bytes()
    msm7 = b"".join(frame(found.payload) for found in scan_frames(data).frames if found.number in FOUR_SYSTEMS)
    with TemporaryDirectory() as folder:
        cut = Path(folder) / "msm7.rtcm3"
        cut.write_bytes(msm7)
        rows = _measure("RTCM3 decoding, four-system MSM7", msm7, str(cut), (1.0, 100.0))
    return rows + _measure("RTCM3 decoding, the whole recording", data, str(path), (None, None))


if __name__ == "__main__":
    print(format_rows(run()))
