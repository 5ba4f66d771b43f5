"""Inertial samples in an RTCM frame: this project's devices' own message (4001 unless a station says otherwise).

Big-endian bit fields::

    uint12 message number | uint12 station (DF003) | uint4 sensor | uint4 kind: 0 accelerometer, 1 and gyroscope
    uint30 GPS time of week of the first sample, ms (DF004) | uint10 its µs | uint20 sample interval, µs
    uint8 number of samples N | int12 temperature, 0.1 °C (−2048: none)
    N × (3 × int24 specific force, 1e-5 m/s²), each followed, for kind 1, by 3 × int24 angular rate, 1e-6 rad/s
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plumbline.errors import ContractError
from plumbline.gps_time import resolve_tow_ms
from plumbline.records import Floats, InertialBlock
from plumbline.rtcm3.bits import BitReader, BitWriter
from plumbline.rtcm3.fields import Malformed
from plumbline.rtcm3.framing import MAX_PAYLOAD_BYTES
from plumbline.rtcm3.msm_layout import LEAP_SECOND_MS, WEEK_MS

DEFAULT_INERTIAL_NUMBER: Final = 4001
FORCE_STEP_M_S2: Final = 1e-5
RATE_STEP_RAD_S: Final = 1e-6
TEMPERATURE_STEP_C: Final = 0.1
_NO_TEMPERATURE: Final = -2048
_HEADER_BYTES: Final = 14
_MAX_INT24: Final = (1 << 23) - 1
_AXES: Final = {0: 3, 1: 6}


@dataclass(frozen=True, slots=True)
class InertialMessage:
    """Evenly spaced samples of one sensor, in its own axes; time of week in GPS time."""

    number: int
    station: int
    sensor: int
    tow_ms: int
    tow_us: int  # 0…999, on top of tow_ms
    interval_us: int
    temperature_c: float | None
    specific_force_m_s2: Floats  # (n, 3)
    angular_rate_rad_s: Floats | None = None  # (n, 3); None for an accelerometer alone

    def block(self, t_near_gps_ns: int, t_receive_ns: int) -> InertialBlock:
        """The samples with their full time, the one nearest to ``t_near_gps_ns``."""
        return InertialBlock(
            resolve_tow_ms(self.tow_ms, t_near_gps_ns) + self.tow_us * 1000,
            t_receive_ns,
            self.interval_us * 1000,
            self.specific_force_m_s2,
            self.angular_rate_rad_s,
            self.sensor,
            self.temperature_c,
        )


def max_samples(with_gyroscope: bool) -> int:
    """Samples that one frame holds at most: 112 of an accelerometer, 56 with a gyroscope."""
    return min((MAX_PAYLOAD_BYTES - _HEADER_BYTES) // (18 if with_gyroscope else 9), 255)


def decode_inertial(payload: bytes) -> InertialMessage | Malformed:
    """Decode an inertial payload, whatever its number."""
    reader = BitReader(payload)
    number = reader.unsigned(12)
    if len(payload) < _HEADER_BYTES:
        return Malformed(number, "too_short")
    station, sensor, kind = (reader.unsigned(bits) for bits in (12, 4, 4))
    tow_ms, tow_us, interval_us, n = (reader.unsigned(bits) for bits in (30, 10, 20, 8))
    temperature = reader.signed(12)
    if kind not in _AXES:
        return Malformed(number, "unknown_kind")
    if tow_ms > WEEK_MS + LEAP_SECOND_MS or tow_us > 999:
        return Malformed(number, "epoch_out_of_range")
    if n > 1 and interval_us == 0:
        return Malformed(number, "no_interval")
    axes = _AXES[kind]
    size = 3 * axes * n
    if len(payload) < _HEADER_BYTES + size:
        return Malformed(number, "too_short")
    samples = _integers(np.frombuffer(payload, np.uint8, size, _HEADER_BYTES)).reshape(n, axes)
    return InertialMessage(
        number,
        station,
        sensor,
        tow_ms,
        tow_us,
        interval_us,
        None if temperature == _NO_TEMPERATURE else temperature * TEMPERATURE_STEP_C,
        samples[:, :3] * FORCE_STEP_M_S2,
        samples[:, 3:] * RATE_STEP_RAD_S if axes == 6 else None,
    )


def encode_inertial(message: InertialMessage) -> bytes:
    """The payload of a message; samples beyond the fields' range (±83.9 m/s², ±8.4 rad/s) saturate as a sensor does.

    Raises :class:`ContractError` for more samples than a frame holds, for NaN, and for a field that does not fit.
    """
    samples = np.asarray(message.specific_force_m_s2) / FORCE_STEP_M_S2
    gyroscope = message.angular_rate_rad_s is not None
    if gyroscope:
        samples = np.hstack((samples, np.asarray(message.angular_rate_rad_s) / RATE_STEP_RAD_S))
    n = samples.shape[0]
    if n > max_samples(gyroscope) or not np.isfinite(samples).all():
        raise ContractError(f"{n} samples: at most {max_samples(gyroscope)}, and all finite")
    writer = BitWriter()
    for value, bits in (
        (message.number, 12),
        (message.station, 12),
        (message.sensor, 4),
        (int(gyroscope), 4),
        (message.tow_ms, 30),
        (message.tow_us, 10),
        (message.interval_us, 20),
        (n, 8),
    ):
        writer.unsigned(value, bits)
    celsius = message.temperature_c
    writer.signed(_NO_TEMPERATURE if celsius is None else round(celsius / TEMPERATURE_STEP_C), 12)
    integers = np.clip(np.rint(samples), -_MAX_INT24, _MAX_INT24).astype(">i4")
    return writer.to_bytes() + integers.reshape(-1, 1).view(np.uint8)[:, 1:].tobytes()


def _integers(octets: NDArray[np.uint8]) -> Floats:
    """Big-endian 24-bit two's complement integers."""
    parts = octets.reshape(-1, 3).astype(np.int64)
    values = (parts[:, 0] << 16) | (parts[:, 1] << 8) | parts[:, 2]
    return (values - ((values >> 23) << 24)).astype(np.float64)
