"""How old a receiver's velocities are.

Many receivers difference carrier phases over an epoch: their velocity is the mean since the last epoch, so that of
half an epoch ago, stamped as now. The positions beside it tell: with d_k the mean velocity between positions k − 1 and
k, an interval T apart,

    v_k − d_k = a_k (T/2 − lag)        a_k = (v_{k+1} − v_{k−1}) / 2T

(the acceleration from the velocities, whose noise is not that of d).
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from plumbline.gnss.earth_frames import geodetic_from_ecef, rotation_enu_from_ecef
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, Solution

_LEAST_PAIRS: Final = 50
_LEAST_ACCELERATION_M_S2: Final = 0.2  # rms: below, the positions' noise outweighs the motion
_MOST_ACCELERATION_M_S2: Final = 15.0  # beyond: a jump of the positions
_NORMAL_MAD: Final = 1.4826
_LONGEST_INTERVAL_S: Final = 1.1  # over longer ones the motion is no parabola


def velocity_lag_s(solutions: Sequence[Solution]) -> tuple[float, float]:
    """Age of the velocities, s, and its sigma; ``(0, inf)`` where they, or the motion, are too few to tell.

    Least absolute residuals: jumps of the positions do not count.
    """
    usable = [s for s in solutions if s.position_ecef_m is not None and s.velocity_enu_m_s is not None]
    if len(usable) < _LEAST_PAIRS:
        return 0.0, math.inf
    place = geodetic_from_ecef(np.asarray(usable[0].position_ecef_m, float))
    turn = rotation_enu_from_ecef(place[0], place[1])
    t_s = np.array([s.t_gps_ns - usable[0].t_gps_ns for s in usable]) / NS_PER_S
    position = np.array([s.position_ecef_m for s in usable], float) @ turn.T
    velocity = np.array([s.velocity_enu_m_s for s in usable], float)
    interval = np.diff(t_s)
    mean = np.diff(position, axis=0)[:, :2] / interval[:, None]
    usual = float(np.median(interval))
    even = (np.abs(interval[:-1] - usual) < 0.1 * usual) & (np.abs(interval[1:] - usual) < 0.1 * usual)
    change = ((velocity[2:, :2] - velocity[:-2, :2]) / (2.0 * usual))[even]
    ahead = (velocity[1:-1, :2] - mean[:-1])[even]
    if len(change) < _LEAST_PAIRS or usual > _LONGEST_INTERVAL_S or np.std(change) < _LEAST_ACCELERATION_M_S2:
        return 0.0, math.inf
    x, y = change.ravel(), ahead.ravel()
    likely = np.abs(x) < _MOST_ACCELERATION_M_S2
    x, y = x[likely], y[likely]
    slope = _least_absolute(x, y)
    spread = _NORMAL_MAD * float(np.median(np.abs(y - slope * x)))
    return 0.5 * usual - slope, math.sqrt(math.pi / 2.0) * spread / math.sqrt(x @ x)


def _least_absolute(x: Floats, y: Floats) -> float:
    """The slope of least absolute residuals: the median of y / x, each weighing as much as x is long."""
    x, y = x[x != 0.0], y[x != 0.0]
    order = np.argsort(y / x)
    weight = np.cumsum(np.abs(x)[order])
    return float((y / x)[order][np.searchsorted(weight, 0.5 * weight[-1])])
