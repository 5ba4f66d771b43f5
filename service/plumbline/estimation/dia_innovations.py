"""The tests of a filter's innovations in one call, for filters of any measurement (Teunissen 1990).

*Detection*: the global test ``vᵀ S⁻¹ v`` (χ² of m) or any w-test. *Identification*: an error of each component, taken
in and taken back (:mod:`plumbline.estimation.dia`). *Adaptation* is the caller's: leave out what is not in ``use``.
Nuisance parameters that each epoch has anew (receivers' clocks) are columns that are in the model from the start.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from plumbline.estimation import dia
from plumbline.records import Booleans, Floats


class Screened(NamedTuple):
    """Innovations after their tests, (m,) each."""

    use: Booleans
    w: Floats  # given the errors found
    sigma_error: Floats  # of the estimate of each one's own error: times √λ₀ the minimal detectable bias
    error: Floats  # that estimate
    statistic: float  # global, before …
    statistic_after: float  # … and after what was found
    degrees_of_freedom: int  # before
    taken_back: int
    explained: bool  # no component is left beyond its critical value
    regular: bool  # S is positive definite


@njit(cache=True)
def screen(s: Floats, v: Floats, nuisance: Floats, critical: float, most: int) -> Screened:
    """Test innovations ``v`` (m,) of covariance ``s`` (m, m).

    ``nuisance`` (m, c) columns of parameters without a prior (c may be 0); ``critical`` χ² value of one component's
    test (infinite: nothing is left out); at most ``most`` are left out.
    """
    m, c = nuisance.shape
    table, regular = dia.information(s, v, nuisance)
    if not regular:
        nothing = np.zeros(m)
        return Screened(np.ones(m, np.bool_), nothing, np.full(m, np.inf), nothing, 0.0, 0.0, 0, 0, False, False)
    for k in range(m, m + c):
        if table[k, k] > 0.0:
            dia.sweep(table, k, False)
    starts, allowed = np.arange(m + c + 1), np.zeros(m + c, np.bool_)
    allowed[:m] = True
    found = dia.identify(table, starts, allowed, np.full(m + c, critical), most)
    adopted = found.adopted.copy()
    adopted[m:] = True
    w, sigma = dia.w_values(found.swept, adopted)
    error = np.empty(m)
    for i in range(m):
        error[i] = found.swept[i, m + c] if adopted[i] else (w[i] * sigma[i] if np.isfinite(sigma[i]) else 0.0)
    return Screened(
        ~adopted[:m], w[:m].copy(), sigma[:m].copy(), error, found.statistic, found.statistic_after, m - c,
        found.taken_back, found.explained, True,
    )  # fmt: skip
