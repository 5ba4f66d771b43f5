"""A motion block's samples as bytes: quantised, differenced, packed at the width they need, compressed.

Quanta are 10 µm, 10 µm/s, 10 µm/s² and, for sigmas, 10 µm: far below what GNSS and an accelerometer resolve. Layout
before zlib: version (1 byte), then for each of 12 channels the width w in bytes of its differences (12 bytes), then
for each channel its first value (int64), then for each channel (n − 1) × w bytes of zigzag differences, the least
significant bytes of all samples first. All little-endian. A missing value is a NaN outside and −2^52 inside.
"""

import zlib
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plumbline.records import Floats, Motion

QUANTUM: Final = 1.0e-5
N_CHANNELS: Final = 12
_VERSION: Final = 1
_MISSING: Final = -(2**52)
_HEAD_BYTES: Final = 1 + N_CHANNELS + 8 * N_CHANNELS


@dataclass(frozen=True, slots=True)
class Samples:
    """A block's samples, each (n, 3)."""

    displacement_enu_m: Floats
    velocity_enu_m_s: Floats
    acceleration_enu_m_s2: Floats
    sigma_displacement_enu_m: Floats


def quantised(motion: Motion) -> NDArray[np.int64]:
    """The block as whole quanta, (12, n): displacement, velocity, acceleration, sigma, each east, north, up."""
    values = np.hstack(
        (
            motion.displacement_enu_m,
            motion.velocity_enu_m_s,
            motion.acceleration_enu_m_s2,
            motion.sigma_displacement_enu_m,
        )
    ).T
    scaled = np.rint(values / QUANTUM)
    missing = ~(np.abs(scaled) < -_MISSING)  # NaN and what no structure can do
    return np.where(missing, _MISSING, scaled).astype(np.int64)


def encode(quanta: NDArray[np.int64]) -> bytes:
    """Bytes of quanta (12, n), n ≥ 1."""
    differences = np.diff(quanta, axis=1)
    zigzag = ((differences << 1) ^ (differences >> 63)).view(np.uint64)
    largest = zigzag.max(axis=1, initial=0)
    widths = [(int(value).bit_length() + 7) // 8 for value in largest]
    planes = np.ascontiguousarray(zigzag, dtype="<u8").view(np.uint8).reshape(*zigzag.shape, 8)
    body = b"".join(planes[i, :, :width].T.tobytes() for i, width in enumerate(widths))
    return zlib.compress(bytes([_VERSION, *widths]) + quanta[:, 0].astype("<i8").tobytes() + body, 1)


def decode(data: bytes, n: int) -> NDArray[np.int64]:
    """Quanta (12, n) of bytes from :func:`encode`; raises ``ValueError`` when the bytes are no such thing."""
    raw = zlib.decompress(data)
    if not raw or raw[0] != _VERSION:
        raise ValueError("a motion block of an unknown version")
    widths = raw[1 : 1 + N_CHANNELS]
    zigzag = np.zeros((N_CHANNELS, n - 1), dtype="<u8")
    planes = zigzag.view(np.uint8).reshape(N_CHANNELS, n - 1, 8)
    at = _HEAD_BYTES
    for i, width in enumerate(widths):
        size = width * (n - 1)
        planes[i, :, :width] = np.frombuffer(raw, np.uint8, size, at).reshape(width, n - 1).T
        at += size
    quanta = np.empty((N_CHANNELS, n), dtype=np.int64)
    quanta[:, 0] = np.frombuffer(raw, "<i8", N_CHANNELS, 1 + N_CHANNELS)
    differences = (zigzag >> np.uint64(1)).view(np.int64) ^ -(zigzag & np.uint64(1)).view(np.int64)
    np.cumsum(differences, axis=1, out=quanta[:, 1:])
    quanta[:, 1:] += quanta[:, :1]
    return quanta


def values(quanta: NDArray[np.int64]) -> Floats:
    """Quanta (12, n) in SI units, (12, n), NaN where missing."""
    return np.where(quanta == _MISSING, np.nan, quanta * QUANTUM)


def samples(quanta: NDArray[np.int64]) -> Samples:
    """Quanta (12, n) as the arrays of a motion block."""
    columns = np.ascontiguousarray(values(quanta).T)
    return Samples(columns[:, 0:3], columns[:, 3:6], columns[:, 6:9], columns[:, 9:12])
