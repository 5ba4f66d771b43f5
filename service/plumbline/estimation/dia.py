"""Detection, identification, adaptation: which errors explain a misfit (Teunissen 1990; Lee 2016, section 2.2).

All is done in the space of a catalogue of alternative hypotheses. An alternative adds ``C b`` to the expectation of the
misclosures ``v`` (covariance ``S``), ``C`` (m, q) known, ``b`` (q,) unknown: a unit vector for an error of one
observation, the design's columns for a jump of the state. With ``G = Cᵀ S⁻¹ C`` and ``t = Cᵀ S⁻¹ v`` of the whole
catalogue, :func:`tableau` is ::

    | G   t |        and sweeping it on an alternative's columns puts that alternative into the model: what remains is
    | tᵀ  T |        ``G``, ``t`` and ``T = vᵀ S⁻¹ v`` of the others given it, and its own estimate and variance.

So selecting, taking back, and every w-statistic, minimal detectable bias and correlation between alternatives given
those already found come from one small matrix, without a second factorisation (sweep operator: Goodnight 1979, *The
American Statistician* 33(3)). Leaving an observation out and estimating its error are the same thing (Baarda 1968).

Nothing here knows what is measured. Suffixes as in :mod:`plumbline.estimation.kalman`.
"""

from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plumbline.estimation.kalman import cholesky_lower, lower_inverse, whiten

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Booleans = NDArray[np.bool_]

_SINGULAR: Final = 1e-9  # what is left of an alternative's information when others explain it altogether


class Findings(NamedTuple):
    """What identification found; k alternatives' columns in the catalogue."""

    adopted: Booleans  # (groups,) alternatives taken into the model
    order: Ints  # (found,) groups in the order in which they were adopted, without those taken back
    swept: Floats  # (k + 1, k + 1) the tableau with the adopted swept in
    statistic: float  # vᵀ S⁻¹ v before …
    statistic_after: float  # … and after
    explained: bool  # no alternative is left that exceeds its critical value
    taken_back: int  # alternatives that others made needless (re-instated observations)


@njit(cache=True)
def information(s: Floats, v: Floats, extra: Floats) -> tuple[Floats, bool]:
    """Tableau (m + e + 1)² of the unit vectors of all observations and of ``extra`` columns (m, e).

    ``s`` (m, m) covariance and ``v`` (m,) misclosures. Second: whether ``s`` is positive definite.
    """
    m, e = extra.shape
    table = np.zeros((m + e + 1, m + e + 1))
    factor, positive = cholesky_lower(s)
    if not positive:
        return table, False
    inverse = lower_inverse(factor)
    white = np.zeros((e + 1, m))  # rows: whitened extra columns, then misclosures
    for a in range(e):
        white[a] = whiten(inverse, np.ascontiguousarray(extra[:, a]))
    white[e] = whiten(inverse, v)
    columns = np.ascontiguousarray(inverse.T)
    for i in range(m):
        for j in range(i, m):
            total = 0.0
            for k in range(j, m):
                total += columns[i, k] * columns[j, k]
            table[i, j] = total
            table[j, i] = total
        for a in range(e + 1):
            total = 0.0
            for k in range(i, m):
                total += columns[i, k] * white[a, k]
            table[i, m + a] = total
            table[m + a, i] = total
    table[m:, m:] = white @ white.T
    return table, True


@njit(cache=True)
def residual_information(h: Floats, v: Floats, sigma: Floats) -> tuple[Floats, bool]:
    """The same (m + 1)² for least squares, where the state is unknown: ``S⁻¹`` becomes ``R⁻¹ − R⁻¹ H Q Hᵀ R⁻¹``.

    ``h`` (m, n), ``v`` and ``sigma`` (m,). Second: whether the state is estimable.
    """
    m, n = h.shape
    scaled = np.empty((m, n))
    for i in range(m):
        scaled[i] = h[i] / sigma[i]
    table = np.zeros((m + 1, m + 1))
    factor, positive = cholesky_lower(scaled.T @ scaled)
    if not positive:
        return table, False
    basis = scaled @ lower_inverse(factor).T
    projector = np.eye(m) - basis @ basis.T
    white = v / sigma
    left = projector @ white
    for i in range(m):
        for j in range(m):
            table[i, j] = projector[i, j] / (sigma[i] * sigma[j])
        table[i, m] = left[i] / sigma[i]
        table[m, i] = table[i, m]
    table[m, m] = np.sum(left * white)
    return table, True


@njit(cache=True)
def sweep(table: Floats, k: int, back: bool) -> None:
    """Sweep a tableau on column ``k``, in place; ``back`` undoes it."""
    n = table.shape[0]
    pivot = 1.0 / table[k, k]
    row = table[k].copy()
    for i in range(n):
        if i != k:
            factor = row[i] * pivot
            for j in range(n):
                table[i, j] -= factor * row[j]
    sign = -1.0 if back else 1.0
    for i in range(n):
        table[k, i] = sign * row[i] * pivot
        table[i, k] = table[k, i]
    table[k, k] = -pivot


@njit(cache=True)
def _statistic(table: Floats, first: int, last: int, inside: bool, full: Floats) -> float:
    """χ² statistic of the columns [first, last); −1 where they cannot be told from those adopted."""
    n, q = table.shape[0], last - first
    if q == 1:
        own = -table[first, first] if inside else table[first, first]
        if not inside and own <= _SINGULAR * full[first]:
            return -1.0
        along = table[first, n - 1]
        return float(along * along / own)
    block = table[first:last, first:last].copy()
    factor, positive = cholesky_lower(-block if inside else block)
    for a in range(q):
        if not positive or (not inside and factor[a, a] ** 2 <= _SINGULAR * full[first + a]):
            return -1.0
    white = whiten(lower_inverse(factor), np.ascontiguousarray(table[first:last, n - 1]))
    return float(np.sum(white * white))


@njit(cache=True)
def _sweep_group(table: Floats, first: int, last: int, back: bool) -> None:
    for k in range(first, last):
        sweep(table, k, back)


@njit(cache=True)
def _strongest(table, starts, adopted, allowed, critical, full):  # type: ignore[no-untyped-def]
    """The alternative not yet adopted with the largest test ratio, and that ratio."""
    best, largest = -1, 0.0
    for g in range(adopted.size):
        if adopted[g] or not allowed[g]:
            continue
        ratio = _statistic(table, starts[g], starts[g + 1], False, full) / critical[g]
        if ratio > largest:
            best, largest = g, ratio
    return best, largest


@njit(cache=True)
def _weakest(table, starts, adopted, critical, full):  # type: ignore[no-untyped-def]
    """The adopted alternative with the smallest test ratio, and that ratio."""
    best, smallest = -1, np.inf
    for g in range(adopted.size):
        if adopted[g]:
            ratio = _statistic(table, starts[g], starts[g + 1], True, full) / critical[g]
            if ratio < smallest:
                best, smallest = g, ratio
    return best, smallest


@njit(cache=True)
def identify(table: Floats, starts: Ints, allowed: Booleans, critical: Floats, most: int) -> Findings:
    """Adopt alternatives one by one, the strongest first, and take back those that later ones make needless.

    ``starts`` (groups + 1,): alternative g has the columns starts[g] … starts[g + 1] − 1 of the tableau. ``allowed``
    (groups,): whether it may be adopted. ``critical`` (groups,): its χ² critical value. At most ``most`` columns are
    adopted. One threshold to enter and to leave: each step lowers ``T + Σ critical`` of the adopted, so that this ends.
    """
    swept, full = table.copy(), np.diag(table).copy()
    n_groups, n = starts.size - 1, table.shape[0]
    adopted, order = np.zeros(n_groups, np.bool_), np.zeros(0, np.int64)
    columns, taken_back, explained = 0, 0, False
    while True:
        best, ratio = _strongest(swept, starts, adopted, allowed, critical, full)
        if best < 0 or ratio <= 1.0:
            explained = True
            break
        if columns + starts[best + 1] - starts[best] > most:
            break
        _sweep_group(swept, starts[best], starts[best + 1], False)
        adopted[best] = True
        columns += starts[best + 1] - starts[best]
        order = np.append(order, best)
        while True:
            worst, ratio = _weakest(swept, starts, adopted, critical, full)
            if worst < 0 or ratio > 1.0 or worst == best:
                break
            _sweep_group(swept, starts[worst], starts[worst + 1], True)
            adopted[worst] = False
            columns -= starts[worst + 1] - starts[worst]
            order = order[order != worst]
            taken_back += 1
    return Findings(adopted, order, swept, table[n - 1, n - 1], swept[n - 1, n - 1], explained, taken_back)


@njit(cache=True)
def w_values(swept: Floats, adopted: Booleans) -> tuple[Floats, Floats]:
    """w-statistic of each one-column alternative given the others adopted, and the sigma of its estimate, (k,).

    Alternatives that cannot be told from the adopted have w 0 and an infinite sigma. ``adopted`` (k,) by column.
    """
    n = swept.shape[0] - 1
    w, sigma = np.zeros(n), np.full(n, np.inf)
    for i in range(n):
        own = -1.0 / swept[i, i] if adopted[i] else swept[i, i]
        if own > 0.0:
            sigma[i] = 1.0 / np.sqrt(own)
            w[i] = swept[i, n] / sigma[i] if adopted[i] else swept[i, n] * sigma[i]
    return w, sigma


@njit(cache=True)
def correlation(table: Floats, i: int, j: int) -> float:
    """Correlation of the w-statistics of two columns, −1…1: at ±1 the two cannot be told apart."""
    return float(table[i, j] / np.sqrt(table[i, i] * table[j, j]))


@njit(cache=True)
def inseparable(table: Floats, column: int, candidates: Ints, limit: float) -> Ints:
    """Of ``candidates`` those whose correlation with ``column`` exceeds ``limit`` in size, before adoption."""
    found = np.zeros(candidates.size, np.bool_)
    for c in range(candidates.size):
        other = candidates[c]
        if other != column and table[other, other] > 0.0:
            found[c] = abs(correlation(table, column, other)) > limit
    return candidates[found]
