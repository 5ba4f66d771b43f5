"""Frames that the device side's tests send."""

import numpy as np

from plumbline.rtcm3 import InertialMessage, MsmHeader, encode, encode_observations, frame
from plumbline.signals import System, satellite_id, signal_id


def msm(system: System, epoch_ms: int, day: int | None = None) -> bytes:
    """An MSM7 of one satellite and signal."""
    satellite = np.array([satellite_id(system, 5)], np.int16)
    signal = np.array([signal_id(system, "2I" if system is System.BEIDOU else "1C")], np.int16)
    one, no = np.array([21e6]), np.zeros(1, bool)
    header = MsmHeader(system, 7, 1, epoch_ms, day)
    rows = (one, one, one * 0, one * 0 + 40, one * 0 + 10, no, np.zeros(1, np.int8))
    return b"".join(frame(payload) for payload in encode_observations(header, satellite, signal, *rows))


def inertial(tow_ms: int) -> bytes:
    """Three samples of an accelerometer at rest in free fall."""
    return frame(encode(InertialMessage(4001, 1, 0, tow_ms, 0, 10_000, None, np.zeros((3, 3)))))
