"""RTCM 10403 both ways, without input or output: bytes → frames → messages, and back.

::

    reader = FrameReader()
    reader.receive_data(chunk)                      # any cut of the stream
    while (frame := reader.next_frame()) is not None:
        message = decode(frame.payload)             # never raises

:func:`decode` answers with :class:`Observations` (MSM1–7, 1001–1004, 1009–1012), :class:`InertialMessage`, a
table-driven :class:`Message` (stations, ephemerides, SSR), :class:`Malformed` with a reason, or :class:`Unknown`.
:func:`encode` and :func:`frame` go back.
"""

import numpy as np

from plumbline.rtcm3 import ephemeris as _ephemeris
from plumbline.rtcm3 import igs_ssr as _igs_ssr
from plumbline.rtcm3 import ssr as _ssr
from plumbline.rtcm3 import station as _station
from plumbline.rtcm3.crc24q import crc24q
from plumbline.rtcm3.fields import Malformed, Message, Unknown
from plumbline.rtcm3.framing import Frame, FrameReader, FrameScan, frame, message_number, scan_frames
from plumbline.rtcm3.inertial import DEFAULT_INERTIAL_NUMBER, InertialMessage
from plumbline.rtcm3.messages import DecodedMessage, Encodable, decode, encode
from plumbline.rtcm3.msm import decode_msm
from plumbline.rtcm3.msm_encoder import MsmHeader, encode_epoch, encode_observations
from plumbline.rtcm3.observations import Observations
from plumbline.rtcm3.phase_alignment import PhaseAligner
from plumbline.signals import System

__all__ = [
    "DEFAULT_INERTIAL_NUMBER", "DecodedMessage", "Encodable", "Frame", "FrameReader", "FrameScan", "InertialMessage",
    "Malformed", "Message", "MsmHeader", "Observations", "PhaseAligner", "Unknown", "crc24q", "decode", "encode",
    "encode_epoch", "encode_observations", "frame", "message_number", "scan_frames", "warm_up",
]  # fmt: skip

#: Modules whose tables are known by their being imported.
TABLE_MODULES = (_station, _ephemeris, _ssr, _igs_ssr)


def warm_up() -> None:
    """Compile every kernel of this package into Numba's cache."""
    row = np.array([21_000_000.0])
    ids = np.zeros(1, dtype=np.int16)
    no, channel = np.zeros(1, dtype=np.bool_), np.zeros(1, dtype=np.int8)
    for kind in (4, 7):
        header = MsmHeader(System.GPS, kind, 0, 0)
        for payload in encode_observations(header, ids, ids, row, row, row * 0.0, row * 0.0, row * 0.0, no, channel):
            scan_frames(frame(payload))
            decode_msm(message_number(payload), payload)
