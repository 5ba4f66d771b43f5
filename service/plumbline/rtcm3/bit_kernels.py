"""Bit fields inside Numba kernels: the compiled relatives of :mod:`plumbline.rtcm3.bits`, without its bounds checks."""

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True)
def read_unsigned(data: NDArray[np.uint8], at: int, bits: int) -> int:
    """Unsigned integer of ``bits`` ≤ 56 bits at bit ``at``; the caller has checked that it is there."""
    first, end = at >> 3, at + bits
    last = (end + 7) >> 3
    value = 0
    for i in range(first, last):
        value = (value << 8) | int(data[i])
    return (value >> (8 * last - end)) & ((1 << bits) - 1)


@njit(cache=True)
def read_signed(data: NDArray[np.uint8], at: int, bits: int) -> int:
    """Two's complement integer of ``bits`` ≤ 56 bits at bit ``at``; the caller has checked that it is there."""
    value = read_unsigned(data, at, bits)
    return value - ((value >> (bits - 1)) << bits)


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
