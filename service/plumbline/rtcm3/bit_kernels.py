"""Bit fields inside Numba kernels: the compiled relatives of :mod:`plumbline.rtcm3.bits`, without its bounds checks."""

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True)
def _word(data: NDArray[np.uint8], at: int) -> np.uint64:
    """The eight bytes from bit ``at``'s byte on: the compiler makes one load of it, given unsigned indices."""
    i = np.uint64(at) >> np.uint64(3)
    return (
        (np.uint64(data[i]) << np.uint64(56))
        | (np.uint64(data[i + np.uint64(1)]) << np.uint64(48))
        | (np.uint64(data[i + np.uint64(2)]) << np.uint64(40))
        | (np.uint64(data[i + np.uint64(3)]) << np.uint64(32))
        | (np.uint64(data[i + np.uint64(4)]) << np.uint64(24))
        | (np.uint64(data[i + np.uint64(5)]) << np.uint64(16))
        | (np.uint64(data[i + np.uint64(6)]) << np.uint64(8))
        | np.uint64(data[i + np.uint64(7)])
    )


@njit(cache=True)
def padded(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A copy with the eight bytes behind it that the readers may touch."""
    copy = np.zeros(data.size + 8, dtype=np.uint8)
    copy[: data.size] = data
    return copy


@njit(cache=True)
def read_unsigned(data: NDArray[np.uint8], at: int, bits: int) -> int:
    """Unsigned integer of 1…57 bits at bit ``at``; eight bytes have to stand from the field's first one on."""
    word = _word(data, at) << np.uint64(at & 7)
    return int(np.int64(word >> np.uint64(64 - bits)))


@njit(cache=True)
def read_signed(data: NDArray[np.uint8], at: int, bits: int) -> int:
    """Two's complement integer of 1…57 bits at bit ``at``; eight bytes have to stand from the field's first one on."""
    word = _word(data, at) << np.uint64(at & 7)
    return int(np.int64(word) >> np.int64(64 - bits))


@njit(cache=True)
def write_bits(data: NDArray[np.uint8], at: int, bits: int, value: int) -> int:
    """Write the lowest ``bits`` ≤ 56 bits of ``value`` at bit ``at`` of zeroed bytes; returns the bit behind them."""
    end = at + bits
    last = (end + 7) >> 3
    shifted = (value & ((1 << bits) - 1)) << (8 * last - end)
    for i in range(last - 1, (at >> 3) - 1, -1):
        data[i] |= np.uint8(shifted & 0xFF)
        shifted >>= 8
    return end
