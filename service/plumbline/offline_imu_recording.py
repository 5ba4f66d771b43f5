"""Samples of an IMU that an RTCM3 recording holds, as the table that other readers give."""

from pathlib import Path

import numpy as np

from plumbline.epochs.recording import read_recording
from plumbline.epochs.stream import StreamDecoder
from plumbline.errors import FileFormatError
from plumbline.files.imu import ImuSeries, read_imu
from plumbline.records import InertialBlock
from plumbline.rtcm3 import InertialMessage

RECORDINGS = (".rtcm3", ".rtcm", ".rtc", ".bin")


def series_of(path: Path, form: str = "auto") -> ImuSeries:
    """Samples of a recording or of a table; raises FileFormatError where it is neither."""
    return recorded_series(path) if path.suffix.lower() in RECORDINGS else read_imu(path, form)


def recorded_series(path: Path) -> ImuSeries:
    """Samples of the first sensor of a recording, those that repeat or go back left out."""
    blocks: list[InertialBlock] = []
    decoder = StreamDecoder()
    for piece in read_recording(path, path.name):
        for message in decoder.receive(piece.data):
            if isinstance(message, InertialMessage):
                block = message.block(piece.t_ns, piece.t_ns)
                if not blocks or (block.sensor == blocks[0].sensor and block.t_first_gps_ns > _end_ns(blocks[-1])):
                    blocks.append(block)
    if not blocks:
        raise FileFormatError(f"{path}: no inertial samples")
    rates = [
        np.full_like(b.specific_force_m_s2, np.nan) if b.angular_rate_rad_s is None else b.angular_rate_rad_s
        for b in blocks
    ]
    return ImuSeries(
        np.concatenate([b.t_first_gps_ns + b.interval_ns * np.arange(len(b.specific_force_m_s2)) for b in blocks]),
        np.concatenate([b.specific_force_m_s2 for b in blocks]),
        np.concatenate(rates),
    )


def _end_ns(block: InertialBlock) -> int:
    return block.t_first_gps_ns + block.interval_ns * (len(block.specific_force_m_s2) - 1)
