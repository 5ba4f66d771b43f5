"""The nearest integer vectors, more than two: for choices that something else than their distance decides as well."""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plumbline.estimation.ambiguity import decorrelate

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_MAX_STEPS: Final = 100_000


@njit(cache=True)
def _insert(best: Ints, norms: Floats, held: int, trial: Floats, norm: float) -> int:
    """Put a candidate in its place among those held; returns how many are held then."""
    place = min(held, norms.size - 1)
    while place > 0 and norms[place - 1] > norm:
        norms[place] = norms[place - 1]
        best[place] = best[place - 1]
        place -= 1
    norms[place] = norm
    for i in range(trial.size):
        best[place, i] = np.int64(trial[i])
    return min(held + 1, norms.size)


@njit(cache=True)
def _nearest(l: Floats, d: Floats, z: Floats, count: int, reach: float) -> tuple[Ints, Floats, int]:  # noqa: E741
    """Depth-first search as in ``ambiguity.search``: candidates (count, n), norms (count,) and how many were found."""
    n = z.size
    best, norms, held = np.zeros((count, n), np.int64), np.full(count, np.inf), 0
    shifts, centre, trial = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    step, partial = np.zeros(n), np.zeros(n)
    k = n - 1
    centre[k] = z[k]
    trial[k] = np.round(centre[k])
    step[k] = 1.0 if centre[k] > trial[k] else -1.0
    for _ in range(_MAX_STEPS):
        rest = centre[k] - trial[k]
        norm = partial[k] + rest * rest / d[k]
        limit = min(norms[count - 1], norms[0] + reach)
        if norm < limit and k > 0:
            for i in range(k):
                shifts[k - 1, i] = shifts[k, i] - rest * l[k, i]
            k -= 1
            partial[k] = norm
            centre[k] = z[k] + shifts[k, k]
            trial[k] = np.round(centre[k])
            step[k] = 1.0 if centre[k] > trial[k] else -1.0
            continue
        if norm < limit:
            held = _insert(best, norms, held, trial, norm)
        elif k == n - 1:
            break
        else:
            k += 1
        trial[k] += step[k]
        step[k] = -step[k] - (1.0 if step[k] > 0.0 else -1.0)
    return best, norms, held


def nearest(a: Floats, q: Floats, count: int, reach: float) -> tuple[Ints, Floats]:
    """Up to ``count`` integer vectors (k, n) nearest to ``a`` (n,) in the metric of ``q`` (n, n); squared norms (k,).

    Best first; none whose squared norm exceeds the best's by more than ``reach``. None at all where ``q`` is not
    positive definite.
    """
    l, d, tt, positive = decorrelate(q)  # noqa: E741
    if not positive:
        return np.zeros((0, a.size), np.int64), np.zeros(0)
    best, norms, held = _nearest(l, d, tt @ a, count, reach)
    back = np.rint(np.linalg.inv(tt.astype(np.float64))).astype(np.int64)
    return best[:held] @ back.T, norms[:held]
