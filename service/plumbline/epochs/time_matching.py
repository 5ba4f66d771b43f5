"""GNSS solutions and inertial samples brought to one time line (Wang 2023, section 2.2).

The corrections of an epoch are matched by the correction book as the epoch is positioned; here its solution meets the
inertial samples. The common time line is a grid of ``rate`` points in every GPS second, the first one on the second
itself: point ``i`` counts from the GPS epoch and lies in second ``i // rate``. Samples whose stamps are on the grid
(what a device does that starts with the GNSS second) pass untouched; others are interpolated by the cubic through four
neighbours, so a stamp's offset, ``inertial_time_offset_s``, costs no time resolution.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, InertialBlock

Times = NDArray[np.int64]

ON_GRID_NS: Final = 50_000  # at 0.1 m/s a time error of 50 µs moves 5 µm
_TAIL: Final = 3  # samples kept of the previous block: what a cubic needs to its left
_LEAST_RATE, _GREATEST_RATE = 2, 4000


@dataclass(frozen=True, slots=True)
class SampleTail:
    """The last samples of a sensor, in time order: times (m,) GPS ns and values (m, 3)."""

    t_gps_ns: Times
    values: Floats


NO_TAIL: Final = SampleTail(np.zeros(0, np.int64), np.zeros((0, 3)))


def grid_rate(interval_ns: int) -> int | None:
    """Grid points a second for a sample interval; None where the interval is no inertial sensor's (2 Hz to 4 kHz)."""
    if interval_ns <= 0:
        return None
    rate = round(NS_PER_S / interval_ns)
    return rate if _LEAST_RATE <= rate <= _GREATEST_RATE else None


def grid_time_ns(index: int, rate: int) -> int:
    """GPS time of a grid point, ns."""
    second, k = divmod(index, rate)
    return second * NS_PER_S + (k * NS_PER_S + rate // 2) // rate


def nearest_grid_index(t_gps_ns: int, rate: int) -> int:
    """The grid point nearest to a time."""
    second, rest = divmod(t_gps_ns, NS_PER_S)
    return second * rate + (rest * rate + NS_PER_S // 2) // NS_PER_S


def match_samples(block: InertialBlock, offset_s: float, tail: SampleTail) -> tuple[int, Floats, SampleTail]:
    """Samples of a block, stamps corrected by ``offset_s``, on the grid.

    Returns the first grid index, the samples there (m, 3), m possibly 0, and the tail for the next block. ``tail``
    joins in when the block follows it without a hole, so that no grid point between two blocks is lost.
    """
    rate = grid_rate(block.interval_ns)
    values = np.asarray(block.specific_force_m_s2, float)
    if rate is None or len(values) == 0:
        return 0, np.zeros((0, 3)), tail
    first_ns = block.t_first_gps_ns + round(offset_s * NS_PER_S)
    times = first_ns + block.interval_ns * np.arange(len(values), dtype=np.int64)
    first = nearest_grid_index(int(times[0]), rate)
    last = nearest_grid_index(int(times[-1]), rate)
    new_tail = SampleTail(times[-_TAIL:], values[-_TAIL:])
    drift_ns = max(abs(int(times[0]) - grid_time_ns(first, rate)), abs(int(times[-1]) - grid_time_ns(last, rate)))
    if drift_ns <= ON_GRID_NS and last - first == len(values) - 1:
        return first, values, new_tail
    start_ns = int(times[0])
    if len(tail.t_gps_ns) and 0.5 < (start_ns - int(tail.t_gps_ns[-1])) / block.interval_ns < 1.5:
        start_ns = int(tail.t_gps_ns[-1])
        times, values = np.concatenate((tail.t_gps_ns, times)), np.concatenate((tail.values, values))
    first = _grid_index_after(start_ns, rate)
    last = nearest_grid_index(int(times[-1]), rate)
    last -= grid_time_ns(last, rate) > times[-1]
    points = np.array([grid_time_ns(i, rate) for i in range(first, last + 1)], np.int64)
    return first, interpolate_cubic(times, values, points), new_tail


def _grid_index_after(t_gps_ns: int, rate: int) -> int:
    index = nearest_grid_index(t_gps_ns, rate)
    return index + (grid_time_ns(index, rate) < t_gps_ns)


def interpolate_cubic(t_ns: Times, values: Floats, at_ns: Times) -> Floats:
    """Lagrange's cubic through the four samples around each instant (one-sided at the ends), (m, 3).

    ``t_ns`` (n,) increasing, ``values`` (n, 3), ``at_ns`` (m,) within it. With less than four samples, linear.
    """
    if len(t_ns) < 4:
        seconds, at = (t_ns - t_ns[0]) * 1e-9, (at_ns - t_ns[0]) * 1e-9
        return np.column_stack([np.interp(at, seconds, values[:, c]) for c in range(values.shape[1])])
    start = np.clip(np.searchsorted(t_ns, at_ns, side="right") - 2, 0, len(t_ns) - 4)
    nodes = start[:, None] + np.arange(4)
    distance = (at_ns[:, None] - t_ns[nodes]) * 1e-9
    spacing = (t_ns[nodes][:, :, None] - t_ns[nodes][:, None, :]) * 1e-9
    weights = np.ones((len(at_ns), 4))
    for i in range(4):
        for j in range(4):
            if i != j:
                weights[:, i] *= distance[:, j] / spacing[:, i, j]
    return np.asarray(np.einsum("mi,mic->mc", weights, values[nodes]), float)
