"""CRC-24Q (RTCM 10403.3, section 4.2; polynomial 0x1864CFB, initial value 0), eight bytes at a step."""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

POLYNOMIAL: Final = 0x1864CFB
CRC_BYTES: Final = 3


def _tables() -> NDArray[np.uint32]:
    """``[k, b]``: the CRC of byte b followed by k zero bytes."""
    tables = np.zeros((8, 256), dtype=np.uint32)
    for byte in range(256):
        crc = byte << 16
        for _ in range(8):
            crc = crc << 1 ^ (POLYNOMIAL if crc & 0x800000 else 0)
        tables[0, byte] = crc & 0xFFFFFF
    for k in range(1, 8):
        before = tables[k - 1]
        tables[k] = (before << np.uint32(8) ^ tables[0][before >> np.uint32(16)]) & np.uint32(0xFFFFFF)
    return tables


_TABLES: Final = _tables()


@njit(cache=True)
def crc24q_of(data: NDArray[np.uint8], start: int, end: int) -> int:
    """CRC-24Q of ``data[start:end]``."""
    crc = np.uint32(0)
    at = start
    while at + 8 <= end:
        crc = (
            _TABLES[7, data[at] ^ (crc >> np.uint32(16))]
            ^ _TABLES[6, data[at + 1] ^ ((crc >> np.uint32(8)) & np.uint32(0xFF))]
            ^ _TABLES[5, data[at + 2] ^ (crc & np.uint32(0xFF))]
            ^ _TABLES[4, data[at + 3]]
            ^ _TABLES[3, data[at + 4]]
            ^ _TABLES[2, data[at + 5]]
            ^ _TABLES[1, data[at + 6]]
            ^ _TABLES[0, data[at + 7]]
        )
        at += 8
    while at < end:
        crc = ((crc << np.uint32(8)) & np.uint32(0xFFFFFF)) ^ _TABLES[0, data[at] ^ (crc >> np.uint32(16))]
        at += 1
    return int(crc)


def crc24q(data: bytes) -> int:
    """CRC-24Q of a byte string."""
    return int(crc24q_of(np.frombuffer(data, dtype=np.uint8), 0, len(data)))
