"""What is new in a position's error at an epoch, as opposed to what it shares with the epochs before.

A filtered position's error is mostly slow: ambiguities, troposphere, orbits, the same for minutes. What is combined
with an accelerometer from epoch to epoch must be weighted by the part that changes between them, or the
accelerometer's drift takes over. That part is the noise of the epoch's own phases, ambiguities held, and, while the
filter converges, what the position moves by: an optimal estimate's step has the variance that it takes off (Anderson
& Moore 1979, 5.3).
"""

from typing import Final

import numpy as np
from numba import njit

from plumbline.estimation.kalman import cholesky_lower, lower_inverse
from plumbline.positioning.state import CLOCKS, POSITION
from plumbline.records import Booleans, Floats, Ints

_LEAST_SIGMA_M: Final = 0.0005
_LEAST_SCALE: Final = 0.1
_LEAST_PIVOT: Final = 1e-8  # of a Cholesky factor, relative and squared: less is singular
_AXES: Final = POSITION.stop
_UNKNOWNS: Final = POSITION.stop + 1
_FIRST_CLOCK: Final = CLOCKS.start
_LAST_CLOCK: Final = CLOCKS.stop


@njit(cache=True)
def _phase_covariance(h: Floats, variance: Floats, kind: Ints, used: Booleans, scale: float) -> tuple[Floats, bool]:
    """Covariance (3, 3) of a position from the phases alone, ambiguities held; the systems' clocks move together."""
    normal, row = np.zeros((_UNKNOWNS, _UNKNOWNS)), np.zeros(_UNKNOWNS)
    for i in range(kind.size):
        if not used[i] or kind[i] % 2 == 0:
            continue
        row[:_AXES] = h[i, :_AXES]
        row[_AXES] = np.sum(h[i, _FIRST_CLOCK:_LAST_CLOCK])
        weight = 1.0 / (variance[i] * scale * scale)
        for a in range(_UNKNOWNS):
            for b in range(_UNKNOWNS):
                normal[a, b] += weight * row[a] * row[b]
    factor, positive = cholesky_lower(normal)
    covariance = np.zeros((_AXES, _AXES))
    for a in range(_UNKNOWNS):
        if not positive or factor[a, a] * factor[a, a] < _LEAST_PIVOT * normal[a, a]:
            return covariance, False
    inverse = lower_inverse(factor)
    for a in range(_AXES):
        for b in range(_AXES):
            covariance[a, b] = np.sum(inverse[:, a] * inverse[:, b])
    return covariance, True


def epoch_noise_enu_m2(
    rotation_enu: Floats, h: Floats, variance: Floats, kind: Ints, used: Booleans, scale: float,
    before_enu_m2: Floats | None, now_enu_m2: Floats,
) -> Floats | None:  # fmt: skip
    """Covariance (3, 3), m², of the new part; None where the phases alone do not give a position.

    ``rotation_enu`` (3, 3) from Earth-fixed, ``h`` (m, n) design in the filter's states, ``variance`` (m,), ``kind``
    (m,) odd for phases, ``used`` (m,), ``scale`` how much larger the phases' residuals are than said, ``before_enu_m2``
    and ``now_enu_m2`` the position's covariances before and after.
    """
    covariance, regular = _phase_covariance(h, variance, kind, used, max(scale, _LEAST_SCALE))
    if not regular:
        return None
    noise: Floats = rotation_enu @ covariance @ rotation_enu.T
    moved = np.zeros(3) if before_enu_m2 is None else np.maximum(0.0, np.diag(before_enu_m2 - now_enu_m2))
    return noise + np.diag(moved + _LEAST_SIGMA_M**2)
