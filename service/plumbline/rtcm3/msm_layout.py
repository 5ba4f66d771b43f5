"""The Multiple Signal Messages' layout, shared by decoder and encoder (RTCM 10403.3, section 3.5.16).

After the header (169 bits) come the cell mask, the satellites' fields column by column, then the cells' fields column
by column. What a message's kind (1–7) decides is which columns there are and how wide.
"""

from typing import Final

import numpy as np
from numba import njit

from plumbline.constants import LIGHT_MILLISECOND_M
from plumbline.signals import System

FIRST_MSM_NUMBER: Final = 1070
HEADER_BITS: Final = 169
MAX_CELLS: Final = 64

# Columns of COLUMN_BITS, the satellites' first: DF397, extended information (GLONASS: DF419), DF398, DF399; then the
# cells': fine pseudorange, fine phase range, lock time, half-cycle, carrier to noise, fine rate.
WHOLE_MS, EXTENDED, MODULO_MS, ROUGH_RATE, FINE_CODE, FINE_PHASE, LOCK, HALF_CYCLE, CN0, FINE_RATE = range(10)
N_SATELLITE_COLUMNS: Final = 4
COLUMN_BITS: Final = np.array(
    [
        [0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
        [0, 0, 10, 0, 15, 0, 0, 0, 0, 0],
        [0, 0, 10, 0, 0, 22, 4, 1, 0, 0],
        [0, 0, 10, 0, 15, 22, 4, 1, 0, 0],
        [8, 0, 10, 0, 15, 22, 4, 1, 6, 0],
        [8, 4, 10, 14, 15, 22, 4, 1, 6, 15],
        [8, 0, 10, 0, 20, 24, 10, 1, 10, 0],
        [8, 4, 10, 14, 20, 24, 10, 1, 10, 15],
    ],
    dtype=np.int64,
)

# Header fields after DF002 and up to the masks: station, epoch, multiple message, IODS (seven reserved bits follow),
# clock steering, external clock, smoothing, smoothing interval.
IODS: Final = 3
HEADER_FIELD_BITS: Final = np.array([12, 30, 1, 3, 2, 2, 1, 3], dtype=np.int64)
RESERVED_BITS_AFTER_IODS: Final = 7

INVALID_WHOLE_MS: Final = 255  # DF397
FINEST_CODE_M: Final = LIGHT_MILLISECOND_M * 2.0**-29  # DF405; DF400 is 2⁵ times coarser
FINEST_PHASE_M: Final = LIGHT_MILLISECOND_M * 2.0**-31  # DF406; DF401 is 2² times coarser
ROUGH_RANGE_M: Final = LIGHT_MILLISECOND_M * 2.0**-10  # DF398
CODE_BITS_BELOW_ROUGH: Final = 19
PHASE_BITS_BELOW_ROUGH: Final = 21
COARSER_CODE_SHIFT: Final = 5
COARSER_PHASE_SHIFT: Final = 2
RATE_M_S: Final = 1e-4  # DF404; DF399 is 1 m/s
CHANNEL_OFFSET: Final = 7  # DF419
MAX_CHANNEL_CODE: Final = 13
UNKNOWN_CHANNEL_CODE: Final = 15
MAX_LOCK_CODE: Final = 704  # DF407
WEEK_MS: Final = 604_800_000
DAY_MS: Final = 86_400_000
LEAP_SECOND_MS: Final = 1000  # DF034 counts on through a leap second; some receivers write a week's end as 604,800,000


#: Kind (1–7), system as a number and system of each MSM message number.
MSM_NUMBERS: Final = {
    FIRST_MSM_NUMBER + 10 * system + kind: (kind, int(system), system) for system in System for kind in range(1, 8)
}


def glonass_epoch(field: int) -> tuple[int | None, int]:
    """Day of week (None: unknown) and ms of the day of a GLONASS epoch field (DF416 and DF034)."""
    day, ms = divmod(field, 1 << 27)
    return (None if day == 7 else day), ms


def message_number_of(kind: int, system: System) -> int:
    """MSM message number of a kind (1–7) and a system."""
    return FIRST_MSM_NUMBER + 10 * system + kind


@njit(cache=True)
def least_lock_ms(code: int, bits: int) -> int:
    """The least lock time, ms, of an indicator: DF402 (4 bits) or DF407 (10 bits); −1 for reserved values."""
    if bits == 4:
        return 0 if code == 0 else 1 << (code + 4)
    if code > MAX_LOCK_CODE:
        return -1
    k = max(code // 32 - 1, 0)
    return (code - 32 * k) << k


@njit(cache=True)
def lock_code(lock_ms: float, bits: int) -> int:
    """The indicator whose least lock time is the greatest that is not above ``lock_ms``; 0 for NaN."""
    top = 15 if bits == 4 else MAX_LOCK_CODE
    if not lock_ms > 0.0:
        return 0
    low, high = 0, top
    while low < high:
        middle = (low + high + 1) // 2
        if least_lock_ms(middle, bits) <= lock_ms:
            low = middle
        else:
            high = middle - 1
    return low
