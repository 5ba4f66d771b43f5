"""Errors against a base that last: what averaging epochs does not remove.

An antenna at rest keeps its multipath for minutes: a thousand epochs of it say little more than one. Taken for white
noise they make a float position that is certain of centimetres and wrong by metres, and integers to match.
"""

from typing import Final

import numpy as np
from numba import njit

from plumbline.positioning.rtk_control import snoop
from plumbline.positioning.state import Records
from plumbline.records import Booleans, Floats, Ints

_MEMORY_S: Final = 60.0  # how long a code's multipath lasts, at least


def with_honest_codes(rows: Records, use_code: Booleans, previous: Ints, interval_s: float) -> Records:
    """A copy of the rows with the code weights that the filter may have.

    The variance is scaled by the factor that the epoch's codes in use (n,) show where that is more than one. Rows that
    carry on an arc (``previous`` (k,), −1: a new one) have said already what they have to say: of errors with the
    autocorrelation exp(−t/τ), a mean over a long time has the variance of white ones of ``(1 + 2 τ/Δt) σ²``.
    """
    out = rows.copy()
    weight = np.where(use_code, rows["code_weight"], 0.0)
    codes = snoop(rows["line"], rows["code_oc_m"], weight, rows["group"], int(rows["group"].max()) + 1, np.inf, 0)
    degrees = codes.degrees_of_freedom
    factor = max(codes.squares / degrees, 1.0) if codes.regular and degrees >= 1.0 else 1.0
    known = np.append(previous >= 0, False)[rows["arc"]]  # −1, no arc, takes the last
    again = 1.0 + 2.0 * _MEMORY_S / max(interval_s, 1e-3)
    out["code_weight"] /= factor * np.where(known, again, 1.0)
    return out


@njit(cache=True)
def lasting_of_arcs(rows: Records, n_arcs: int) -> Floats:
    """Covariance (k, k), cycles², of what arcs' phases keep however many epochs are averaged.

    As large as the variance of a single phase; the least of a group, its datum's, is common to the group.
    """
    out, datum, group = np.zeros((n_arcs, n_arcs)), np.full(rows.size, np.inf), np.full(n_arcs, -1, np.int64)
    for row in rows:
        if row.arc >= 0 and row.phase_weight > 0.0:
            variance = 1.0 / (row.phase_weight * row.wavelength_m * row.wavelength_m)
            out[row.arc, row.arc] = variance
            group[row.arc] = row.group
            datum[row.group] = min(datum[row.group], variance)
    for i in range(n_arcs):
        for j in range(n_arcs):
            if group[i] >= 0 and group[i] == group[j]:
                out[i, j] += datum[group[i]]
    return out
