"""Integer least squares: from real-valued estimates of integers, and their covariance, to the integers (LAMBDA).

With ``a`` the float estimates (n,) and ``q`` their covariance (n, n), the integers sought minimise
``(a − z)ᵀ q⁻¹ (a − z)``. An integer, volume-preserving transformation first makes the ellipsoid nearly round, then a
depth-first search with a shrinking ellipsoid finds the best and the second best vector.

Convention of de Jonge & Tiberius (1996): ``q = lᵀ diag(d) l`` with ``l`` unit lower triangular, so ``d[i]`` is the
variance of element i when all *later* ones are known; the last element is fixed first. Transformed ambiguities are
``z = tᵀ a``. Sources: Teunissen 1995 (J Geod 70:65-82); de Jonge & Tiberius 1996 (LGR 12); Chang, Yang & Zhou 2005
(J Geod 79:552-565; the pivoting factorisation and the search); Teunissen 1998 (J Geod 72:606-612, eq. 17, the
bootstrapped success rate); Teunissen, Joosten & Tiberius 1999 (partial resolution in the transformed space).
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_MAX_SEARCH_STEPS: Final = 200_000
_SWAP_GAIN: Final = 1e-6  # relative: a smaller gain is no reason to swap
_LEAST_NORM: Final = 1e-3  # a best norm below counts as this much in ratios
_RATIO_LIMIT: Final = 4.0  # ratios are known up to this, or up to the least one accepted if that is more


@dataclass(frozen=True, slots=True)
class Resolution:
    """What integer least squares found; ``transform @ a = integers`` are the relations that may be held as certain."""

    accepted: bool
    transform: Ints  # (k, n) integer rows; the identity's rows when the whole vector was resolved
    integers: Ints  # (k,)
    values: Floats  # (n,) the estimates given those integers: integers themselves when the whole vector is resolved
    second: Ints  # (k,) the second best
    squared_norm: float  # of the best, in the metric of the covariance of ``transform @ a``
    second_squared_norm: float
    success_rate: float  # bootstrapped, of the relations: a lower bound of integer least squares' own
    reason: str  # empty when accepted

    @property
    def ratio(self) -> float:
        """Second best over best squared norm; large ones are lower bounds (see :func:`search`)."""
        return self.second_squared_norm / max(self.squared_norm, _LEAST_NORM)

    @property
    def complete(self) -> bool:
        """Whether every ambiguity is resolved."""
        return self.accepted and self.integers.size == self.values.size


# ------------------------------------------------------------------------------------------- decorrelation


@njit(cache=True)
def _factor(q: Floats) -> tuple[Floats, Floats, Ints, bool]:
    """``q[p][:, p] = lᵀ diag(d) l`` with pivoting that puts the smallest variances last; (l, d, p, positive)."""
    n = q.shape[0]
    a = q.copy()
    l = np.zeros((n, n))  # noqa: E741
    d = np.zeros(n)
    p = np.arange(n)
    for i in range(n - 1, -1, -1):
        best = i
        for j in range(i):
            if a[j, j] < a[best, best]:
                best = j
        if best != i:
            p[i], p[best] = p[best], p[i]
            for k in range(n):
                a[i, k], a[best, k] = a[best, k], a[i, k]
            for k in range(n):
                a[k, i], a[k, best] = a[k, best], a[k, i]
            for k in range(i + 1, n):
                l[k, i], l[k, best] = l[k, best], l[k, i]
        d[i] = a[i, i]
        if not d[i] > 0.0:
            return l, d, p, False
        for j in range(i):
            l[i, j] = a[i, j] / d[i]
        l[i, i] = 1.0
        for j in range(i):
            factor = l[i, j] * d[i]
            for k in range(i):
                a[j, k] -= factor * l[i, k]
    return l, d, p, True


@njit(cache=True)
def _gauss(lt: Floats, tt: Ints, i: int, j: int) -> None:
    """Make ``|l[i, j]| ≤ ½`` by an integer multiple of column i; ``lt`` and ``tt`` are transposed for contiguity."""
    mu = np.round(lt[j, i])
    if mu != 0.0:
        for k in range(i, lt.shape[0]):
            lt[j, k] -= mu * lt[i, k]
        whole = np.int64(mu)
        for k in range(lt.shape[0]):
            tt[j, k] -= whole * tt[i, k]


@njit(cache=True)
def _swap(lt: Floats, d: Floats, tt: Ints, j: int, variance: float) -> None:
    """Exchange elements j and j + 1, ``variance`` being that of j + 1 once it stands before."""
    n = lt.shape[0]
    eta = d[j] / variance
    lam = d[j + 1] * lt[j, j + 1] / variance
    d[j] = eta * d[j + 1]
    d[j + 1] = variance
    below = lt[j, j + 1]
    for k in range(j):
        first, second = lt[k, j], lt[k, j + 1]
        lt[k, j] = -below * first + second
        lt[k, j + 1] = eta * first + lam * second
    lt[j, j + 1] = lam
    for k in range(j + 2, n):
        lt[j, k], lt[j + 1, k] = lt[j + 1, k], lt[j, k]
    for k in range(n):
        tt[j, k], tt[j + 1, k] = tt[j + 1, k], tt[j, k]


@njit(cache=True)
def decorrelate(q: Floats) -> tuple[Floats, Floats, Ints, bool]:
    """Factor and transform a covariance (n, n): ``tᵀ q t = lᵀ diag(d) l``; returns (l, d, tᵀ, positive definite).

    ``l`` unit lower triangular with elements of at most ½ below the diagonal, ``d`` mostly decreasing, ``t`` integer
    of determinant ±1.
    """
    n = q.shape[0]
    l, d, p, positive = _factor(q)  # noqa: E741
    tt = np.zeros((n, n), np.int64)
    for i in range(n):
        tt[i, p[i]] = 1
    lt = l.T.copy()
    if not positive:
        return l, d, tt, False
    j, reduced_from = n - 2, n - 2
    while j >= 0:
        if j <= reduced_from:
            for i in range(j + 1, n):
                _gauss(lt, tt, i, j)
        variance = d[j] + lt[j, j + 1] * lt[j, j + 1] * d[j + 1]
        if variance < d[j + 1] * (1.0 - _SWAP_GAIN):
            _swap(lt, d, tt, j, variance)
            reduced_from = j
            j = min(j + 1, n - 2)
        else:
            j -= 1
    for j in range(n - 2, -1, -1):
        for i in range(j + 1, n):
            _gauss(lt, tt, i, j)
    return lt.T.copy(), d, tt, True


# ------------------------------------------------------------------------------------------- search


@njit(cache=True)
def _step_of(remainder: float) -> float:
    return 1.0 if remainder > 0.0 else -1.0


@njit(cache=True)
def search(l: Floats, d: Floats, z: Floats, ratio_limit: float = np.inf) -> tuple[Ints, Floats, bool]:  # noqa: E741
    """The two integer vectors nearest to ``z`` in the metric of ``lᵀ diag(d) l``.

    Returns candidates (2, n), best first, their squared norms (2,) and whether the search came to its end. A second
    best whose norm exceeds ``ratio_limit`` times the best is not looked for (in a strong model that search alone would
    be long): then its norm is that bound, and its vector zeros or some farther one.
    """
    n = z.size
    best, norms = np.zeros((2, n), np.int64), np.full(2, np.inf)
    shifts = np.zeros((n, n))  # row k: what the elements from k on have added to the elements before them
    centre, trial, step, partial = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    k, limit = n - 1, np.inf
    centre[k] = z[k]
    trial[k] = np.round(centre[k])
    step[k] = _step_of(centre[k] - trial[k])
    for _ in range(_MAX_SEARCH_STEPS):
        rest = centre[k] - trial[k]
        norm = partial[k] + rest * rest / d[k]
        if norm < limit and k > 0:
            for i in range(k):
                shifts[k - 1, i] = shifts[k, i] - rest * l[k, i]
            k -= 1
            partial[k] = norm
            centre[k] = z[k] + shifts[k, k]
            trial[k] = np.round(centre[k])
            step[k] = _step_of(centre[k] - trial[k])
            continue
        if norm < limit:
            place = 0 if norm < norms[0] else 1
            if place == 0:
                best[1], norms[1] = best[0], norms[0]
            norms[place] = norm
            for i in range(n):
                best[place, i] = np.int64(trial[i])
            limit = min(norms[1], ratio_limit * max(norms[0], _LEAST_NORM))
        elif k == n - 1:
            norms[1] = limit
            return best, norms, True
        else:
            k += 1
        trial[k] += step[k]
        step[k] = -step[k] - _step_of(step[k])
    return best, norms, False


@njit(cache=True)
def success_rate(d: Floats) -> float:
    """Success rate of integer bootstrapping, ``Π (2 Φ(1 / (2 √dᵢ)) − 1)``, for conditional variances (n,)."""
    rate = 1.0
    for i in range(d.size):
        rate *= math.erf(1.0 / (2.0 * math.sqrt(2.0 * d[i])))
    return rate


@njit(cache=True)
def _first_resolvable(d: Floats, least: float) -> int:
    """Index from which on the elements can be resolved together with a success rate of at least ``least``."""
    rate, first = 1.0, d.size
    while first > 0:
        rate *= math.erf(1.0 / (2.0 * math.sqrt(2.0 * d[first - 1])))
        if rate < least:
            break
        first -= 1
    return first


@njit(cache=True)
def _condition(l: Floats, z: Floats, integers: Ints, first: int) -> Floats:  # noqa: E741
    """Transformed estimates (n,) given integers for the elements from ``first`` on."""
    n = z.size
    shift, out = np.zeros(n), z.copy()
    for k in range(n - 1, first - 1, -1):
        rest = z[k] + shift[k] - integers[k - first]
        for i in range(k):
            shift[i] -= rest * l[k, i]
        out[k] = integers[k - first]
    for k in range(first):
        out[k] = z[k] + shift[k]
    return out


@njit(cache=True)
def _resolve(a, q, least_success, ratio_limit, partial):  # type: ignore[no-untyped-def]
    """(status, tᵀ, first, candidates, norms, transformed values, success rate); status 0: found."""
    n = a.size
    l, d, tt, positive = decorrelate(q)  # noqa: E741
    z = np.zeros(n)
    none, norms = np.zeros((2, 0), np.int64), np.full(2, np.inf)
    if not positive:
        return 1, tt, n, none, norms, z, 0.0
    for i in range(n):
        for k in range(n):
            z[i] += tt[i, k] * a[k]
    first = _first_resolvable(d, least_success) if partial else 0
    rate = success_rate(d[first:])
    if first == n or rate < least_success:
        return 2, tt, n, none, norms, z, success_rate(d)
    candidates, norms, ended = search(l[first:, first:].copy(), d[first:].copy(), z[first:].copy(), ratio_limit)
    if not ended:
        return 3, tt, n, none, norms, z, rate
    return 0, tt, first, candidates, norms, _condition(l, z, candidates[0], first), rate


_REASONS: Final = {
    1: "the covariance of the ambiguities is not positive definite",
    2: "success rate {rate:.3f} below {least:.3f}",
    3: "the search did not end",
}


def resolve(
    a: Floats, q: Floats, min_ratio: float = 2.0, min_success_rate: float = 0.99, partial: bool = True
) -> Resolution:
    """Resolve float ambiguities (n,) of covariance (n, n), in cycles.

    The success rate is asked for first: where the whole vector does not reach it and ``partial`` is set, the largest
    set of transformed ambiguities that does is resolved. Accepted are integers whose ratio (second best over best
    squared norm) is at least ``min_ratio``.
    """
    n = a.size
    empty = np.zeros((0, n), np.int64), np.zeros(0, np.int64)
    if n == 0:
        return Resolution(False, *empty, a, empty[1], np.inf, np.inf, 1.0, "no ambiguities")
    status, tt, first, candidates, norms, z, rate = _resolve(
        a, q, min_success_rate, max(min_ratio, _RATIO_LIMIT), partial
    )
    if status != 0:
        reason = _REASONS[status].format(rate=rate, least=min_success_rate)
        return Resolution(False, *empty, a, empty[1], np.inf, np.inf, rate, reason)
    back = np.linalg.inv(tt.astype(np.float64))
    transform, best, second = tt[first:], candidates[0], candidates[1]
    values = back @ z
    if first == 0:
        inverse = np.rint(back).astype(np.int64)
        transform, best, second = np.eye(n, dtype=np.int64), inverse @ best, inverse @ second
        values = best.astype(np.float64)
    ratio = norms[1] / max(norms[0], _LEAST_NORM)
    reason = "" if ratio >= min_ratio else f"ratio {ratio:.2f} below {min_ratio:.2f}"
    return Resolution(
        not reason, transform, best, values, second, float(norms[0]), float(norms[1]), float(rate), reason
    )  # fmt: skip
