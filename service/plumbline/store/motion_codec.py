"""A motion block's samples as bytes: quantised, differenced, packed at the width they need, compressed.

Quanta are 10 µm, 10 µm/s, 10 µm/s², for sigmas 10 µm, and 1 µrad for angles: far below what GNSS and an IMU resolve.
Layout before zlib: version (1 byte), then for each channel the width w in bytes of its differences (1 byte each), then
for each channel its first value (int64), then for each channel (n − 1) × w bytes of zigzag differences, the least
significant bytes of all samples first. Version 1 has 12 channels, version 2 has 18: the attitude and its sigmas too.
All little-endian. A missing value is a NaN outside and −2^52 inside.
"""

import zlib
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plumbline.records import Floats, Motion

QUANTUM: Final = 1.0e-5
ANGLE_QUANTUM_RAD: Final = 1.0e-6
N_CHANNELS: Final = 12  # that every block has
_N_WITH_ATTITUDE: Final = 18
_QUANTA: Final = np.repeat([QUANTUM, ANGLE_QUANTUM_RAD], [N_CHANNELS, _N_WITH_ATTITUDE - N_CHANNELS])
_CHANNELS_OF_VERSION: Final = {1: N_CHANNELS, 2: _N_WITH_ATTITUDE}
_VERSION_OF_CHANNELS: Final = {n: version for version, n in _CHANNELS_OF_VERSION.items()}
_MISSING: Final = -(2**52)


@dataclass(frozen=True, slots=True)
class Samples:
    """A block's samples, each (n, 3); the attitude's NaN where the block has none."""

    displacement_enu_m: Floats
    velocity_enu_m_s: Floats
    acceleration_enu_m_s2: Floats
    sigma_displacement_enu_m: Floats
    attitude_rad: Floats
    sigma_attitude_rad: Floats


def quantised(motion: Motion) -> NDArray[np.int64]:
    """The block as whole quanta, (12, n): displacement, velocity, acceleration, sigma, each east, north, up.

    With an attitude (18, n): roll, pitch, heading and their sigmas too.
    """
    parts = [
        motion.displacement_enu_m,
        motion.velocity_enu_m_s,
        motion.acceleration_enu_m_s2,
        motion.sigma_displacement_enu_m,
    ]
    if motion.attitude_rad is not None and motion.sigma_attitude_rad is not None:
        parts += [motion.attitude_rad, motion.sigma_attitude_rad]
    values = np.hstack(parts).T
    scaled = np.rint(values / _QUANTA[: len(values), None])
    missing = ~(np.abs(scaled) < -_MISSING)  # NaN and what no structure can do
    return np.where(missing, _MISSING, scaled).astype(np.int64)


def encode(quanta: NDArray[np.int64]) -> bytes:
    """Bytes of quanta (12 or 18, n), n ≥ 1."""
    differences = np.diff(quanta, axis=1)
    zigzag = ((differences << 1) ^ (differences >> 63)).view(np.uint64)
    largest = zigzag.max(axis=1, initial=0)
    widths = [(int(value).bit_length() + 7) // 8 for value in largest]
    planes = np.ascontiguousarray(zigzag, dtype="<u8").view(np.uint8).reshape(*zigzag.shape, 8)
    body = b"".join(planes[i, :, :width].T.tobytes() for i, width in enumerate(widths))
    return zlib.compress(
        bytes([_VERSION_OF_CHANNELS[len(quanta)], *widths]) + quanta[:, 0].astype("<i8").tobytes() + body, 1
    )


def decode(data: bytes, n: int) -> NDArray[np.int64]:
    """Quanta (12 or 18, n) of bytes from :func:`encode`; raises ``ValueError`` when the bytes are no such thing."""
    raw = zlib.decompress(data)
    if not raw or raw[0] not in _CHANNELS_OF_VERSION:
        raise ValueError("a motion block of an unknown version")
    n_channels = _CHANNELS_OF_VERSION[raw[0]]
    widths = raw[1 : 1 + n_channels]
    zigzag = np.zeros((n_channels, n - 1), dtype="<u8")
    planes = zigzag.view(np.uint8).reshape(n_channels, n - 1, 8)
    at = 1 + n_channels + 8 * n_channels
    for i, width in enumerate(widths):
        size = width * (n - 1)
        planes[i, :, :width] = np.frombuffer(raw, np.uint8, size, at).reshape(width, n - 1).T
        at += size
    quanta = np.empty((n_channels, n), dtype=np.int64)
    quanta[:, 0] = np.frombuffer(raw, "<i8", n_channels, 1 + n_channels)
    differences = (zigzag >> np.uint64(1)).view(np.int64) ^ -(zigzag & np.uint64(1)).view(np.int64)
    np.cumsum(differences, axis=1, out=quanta[:, 1:])
    quanta[:, 1:] += quanta[:, :1]
    return quanta


def values(quanta: NDArray[np.int64]) -> Floats:
    """Quanta (12 or 18, n) in SI units, NaN where missing."""
    return np.where(quanta == _MISSING, np.nan, quanta * _QUANTA[: len(quanta), None])


def samples(quanta: NDArray[np.int64]) -> Samples:
    """Quanta (12 or 18, n) as the arrays of a motion block."""
    columns = np.full((quanta.shape[1], _N_WITH_ATTITUDE), np.nan)
    columns[:, : len(quanta)] = values(quanta).T
    return Samples(*(columns[:, i : i + 3] for i in range(0, _N_WITH_ATTITUDE, 3)))
