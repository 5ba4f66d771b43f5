"""Detection, identification, adaptation for rows of single differences (Baarda 1968; Teunissen 1990, 2006).

Model of rows of one kind: ``v = −line · b + clock(group) + ε``, weights ``1/σ²``; ``b`` is free, or has a prior about
zero. Everything comes from one adjustment: residuals ``r``, redundancy numbers ``ρ`` and w-statistics ``r √(weight /
ρ)``. Only where one of these exceeds its critical value, the tableau of :mod:`plumbline.estimation.dia` is made ::

    G = W − W 1 1ᵀ W / Σ W (within groups) − W D C Dᵀ W,    t = W r,    D the lines less their groups' means, C = Cov(b)

and alternatives are adopted and taken back in it: an error of each row, and with a prior, a motion beyond it (three
columns). Rows that cannot be told from one adopted (their w-statistics are correlated) are left out with it.
"""

from typing import Final, NamedTuple

import numpy as np
from numba import njit

from plumbline.config import PositioningSettings
from plumbline.estimation import dia
from plumbline.estimation.dia_tables import alternative_critical
from plumbline.positioning.control import TAIL
from plumbline.positioning.ppp_noise import levels_of
from plumbline.positioning.rtk_filter import group_means, solve3
from plumbline.records import Booleans, Floats, Ints

_AXES: Final = 3
_LEAST_REDUNDANCY: Final = 1e-3  # of a row: below it nothing checks it
_INSEPARABLE_CORRELATION: Final = 0.98


class Limits(NamedTuple):
    """Critical χ² values, infinite where quality control is off."""

    row: float  # of an error of one row
    motion: float  # of a motion in three dimensions


def limits_of(settings: PositioningSettings) -> Limits:
    """Critical values of a station's significance and power, raised for the tails of real errors."""
    if settings.quality_control == "off":
        return Limits(np.inf, np.inf)
    critical = alternative_critical(levels_of(settings)) * TAIL**2
    return Limits(float(critical[1]), float(critical[_AXES]))


class Adjusted(NamedTuple):
    """Rows of an epoch after their tests; n rows, of which those of weight zero take no part."""

    b_m: Floats  # (3,)
    covariance_m2: Floats  # (3, 3)
    use: Booleans  # (n,)
    residual_m: Floats  # (n,) given b and the clocks; of a row left out: as the others predict it
    sigma_error_m: Floats  # (n,) of the estimate of each row's own error; infinite where nothing checks it
    w: Floats  # (n,) given the errors found
    squares: float  # weighted sum of squares of what is used, χ² of …
    degrees_of_freedom: float
    moved: bool  # more than the prior allows
    inseparable: Booleans  # (n,) left out since its error cannot be told from another's
    taken_back: int
    explained: bool  # no alternative is left that exceeds its critical value
    regular: bool  # b is determined


@njit(cache=True)
def _reduced(line, group, mean):  # type: ignore[no-untyped-def]
    """Design of b with the groups' clocks eliminated, (n, 3)."""
    d = np.empty((group.size, _AXES))
    for i in range(group.size):
        for k in range(_AXES):
            d[i, k] = -line[i, k] - mean[group[i], k]
    return d


@njit(cache=True)
def _fit(line, v, weight, group, n_groups, use, prior):  # type: ignore[no-untyped-def]
    """Least squares over b and a clock a group: (b, covariance, residuals, sums of weights, design, regular)."""
    mean, total = group_means(line, v, weight, group, n_groups, use)
    d = _reduced(line, group, mean)
    normal, right = prior.copy(), np.zeros(_AXES)
    for i in range(v.size):
        if use[i]:
            for k in range(_AXES):
                right[k] += weight[i] * d[i, k] * (v[i] - mean[group[i], 3])
                for j in range(_AXES):
                    normal[k, j] += weight[i] * d[i, k] * d[i, j]
    covariance, regular = solve3(normal)
    b, residual = np.zeros(_AXES), np.zeros(v.size)
    if regular:
        for k in range(_AXES):
            b[k] = covariance[k, 0] * right[0] + covariance[k, 1] * right[1] + covariance[k, 2] * right[2]
        for i in range(v.size):
            if weight[i] > 0.0 and total[group[i]] > 0.0:
                residual[i] = v[i] - mean[group[i], 3] - d[i, 0] * b[0] - d[i, 1] * b[1] - d[i, 2] * b[2]
    return b, covariance, residual, total, d, regular


@njit(cache=True)
def _sigmas(weight, group, use, total, d, covariance):  # type: ignore[no-untyped-def]
    """Sigma of each row's estimated error (n,) and redundancy number (n,), used or not."""
    sigma, redundancy = np.full(weight.size, np.inf), np.zeros(weight.size)
    for i in range(weight.size):
        sum_of_weights = total[group[i]]
        if weight[i] == 0.0 or sum_of_weights == 0.0:
            continue
        spread = 1.0 / sum_of_weights
        for k in range(_AXES):
            for j in range(_AXES):
                spread += d[i, k] * covariance[k, j] * d[i, j]
        redundancy[i] = 1.0 - weight[i] * spread if use[i] else 1.0 / (1.0 + weight[i] * spread)
        if redundancy[i] > _LEAST_REDUNDANCY:
            sigma[i] = 1.0 / np.sqrt(weight[i] * redundancy[i])
    return sigma, redundancy


@njit(cache=True)
def _w(weight, use, residual, sigma):  # type: ignore[no-untyped-def]
    """w-statistics (n,), the estimated error over its sigma."""
    w = np.zeros(weight.size)
    for i in range(weight.size):
        if np.isfinite(sigma[i]):
            w[i] = residual[i] * weight[i] * sigma[i] if use[i] else residual[i] / sigma[i]
    return w


@njit(cache=True)
def _tableau(at, weight, group, total, d, covariance, residual, squares, with_motion):  # type: ignore[no-untyped-def]
    """The rows' tableau, and where asked for with the three columns of a motion."""
    m, extra = at.size, _AXES if with_motion else 0
    table = np.zeros((m + extra + 1, m + extra + 1))
    for a in range(m):
        i = at[a]
        for b in range(a + 1):
            j = at[b]
            spread = 1.0 / total[group[i]] if group[i] == group[j] else 0.0
            for k in range(_AXES):
                for q in range(_AXES):
                    spread += d[i, k] * covariance[k, q] * d[j, q]
            table[a, b] = (weight[i] if a == b else 0.0) - weight[i] * weight[j] * spread
            table[b, a] = table[a, b]
        table[a, m + extra] = weight[i] * residual[i]
        table[m + extra, a] = table[a, m + extra]
    table[m + extra, m + extra] = squares
    if with_motion:
        design = d[at]
        side = np.ascontiguousarray(table[:m, :m]) @ design
        table[:m, m : m + extra], table[m : m + extra, :m] = side, side.T
        table[m : m + extra, m : m + extra] = design.T @ side
        along = design.T @ np.ascontiguousarray(table[:m, m + extra])
        table[m : m + extra, m + extra], table[m + extra, m : m + extra] = along, along
    return table


@njit(cache=True)
def _squares(b, weight, use, residual, prior):  # type: ignore[no-untyped-def]
    """Weighted sum of squares of the residuals, and of b against its prior."""
    total = 0.0
    for i in range(weight.size):
        if use[i]:
            total += weight[i] * residual[i] * residual[i]
    for k in range(_AXES):
        for j in range(_AXES):
            total += b[k] * prior[k, j] * b[j]
    return total


@njit(cache=True)
def _motion(line, v, weight, group, n_groups, use, squares):  # type: ignore[no-untyped-def]
    """χ² statistic of a motion beyond the prior: what the prior adds to the sum of squares."""
    free = np.zeros((_AXES, _AXES))
    b, _, residual, _, _, regular = _fit(line, v, weight, group, n_groups, use, free)
    return squares - _squares(b, weight, use, residual, free) if regular else 0.0


@njit(cache=True)
def _degrees(use, group, n_groups, has_prior):  # type: ignore[no-untyped-def]
    """Degrees of freedom: rows less clocks, and less b where nothing else tells it."""
    seen, n = np.zeros(n_groups, np.bool_), 0
    for i in range(use.size):
        if use[i]:
            seen[group[i]] = True
            n += 1
    return float(max(n - np.sum(seen) - (0 if has_prior else _AXES), 0))


@njit(cache=True)
def test_rows(line, v, weight, group, n_groups, critical, critical_move, max_out, prior):  # type: ignore[no-untyped-def]
    """Adjust rows and test them (:class:`Adjusted`).

    ``line`` (n, 3), ``v`` (n,) m, ``weight`` (n,) 1/σ² (0: takes no part), ``group`` (n,); ``critical`` χ² value of a
    row's alternative, ``critical_move`` of a motion (both infinite: nothing is left out); at most ``max_out`` columns
    are adopted; ``prior`` (3, 3) information of b about zero (zeros: free, and no motion is beyond it).
    """
    has_prior, use = prior[0, 0] > 0.0, weight > 0.0
    b, covariance, residual, total, d, regular = _fit(line, v, weight, group, n_groups, use, prior)
    inseparable, moved, taken_back, explained = np.zeros(v.size, np.bool_), False, 0, True
    if not regular:
        nothing = np.zeros(v.size)
        return Adjusted(
            b, covariance, use, nothing, np.full(v.size, np.inf), nothing, 0.0, 0.0, False, inseparable, 0, False, False
        )
    sigma, redundancy = _sigmas(weight, group, use, total, d, covariance)
    w = _w(weight, use, residual, sigma)
    squares = _squares(b, weight, use, residual, prior)
    motion = _motion(line, v, weight, group, n_groups, use, squares) if has_prior else 0.0
    if np.max(w * w) > critical or motion > critical_move:
        at = np.flatnonzero(redundancy > _LEAST_REDUNDANCY)
        table = _tableau(at, weight, group, total, d, covariance, residual, squares, has_prior)
        starts, limits = np.arange(at.size + 1), np.full(at.size + (1 if has_prior else 0), critical)
        if has_prior:
            starts, limits[at.size] = np.append(starts, at.size + _AXES), critical_move
        found = dia.identify(table, starts, np.ones(limits.size, np.bool_), limits, max_out)
        taken_back, explained = found.taken_back, found.explained
        moved = has_prior and found.adopted[at.size]
        for a in np.flatnonzero(found.adopted[: at.size]):
            use[at[a]] = False
            candidates = np.flatnonzero(~found.adopted[: at.size])
            for other in dia.inseparable(table, int(a), candidates, _INSEPARABLE_CORRELATION):
                use[at[other]], inseparable[at[other]] = False, True
        prior = np.zeros((_AXES, _AXES)) if moved else prior
        b, covariance, residual, total, d, regular = _fit(line, v, weight, group, n_groups, use, prior)
        if regular:
            sigma, redundancy = _sigmas(weight, group, use, total, d, covariance)
            w = _w(weight, use, residual, sigma)
            squares = _squares(b, weight, use, residual, prior)
    return Adjusted(
        b, covariance, use, residual, sigma, w, squares, _degrees(use, group, n_groups, has_prior and not moved),
        moved, inseparable, taken_back, explained, regular,
    )  # fmt: skip


def snoop(
    line: Floats, v: Floats, weight: Floats, group: Ints, n_groups: int, critical: float, max_out: int
) -> Adjusted:  # fmt: skip
    """:func:`test_rows` with b free, of arrays that need not be contiguous."""
    return test_rows(  # type: ignore[no-any-return]
        np.ascontiguousarray(line, np.float64), np.ascontiguousarray(v, np.float64),
        np.ascontiguousarray(weight, np.float64), np.ascontiguousarray(group, np.int64), n_groups, float(critical),
        np.inf, max_out, np.zeros((_AXES, _AXES)),
    )  # fmt: skip


@njit(cache=True)
def usual_size(w: Floats, counted: Booleans) -> float:
    """How large w-statistics are against a standard normal's, by their median; NaN of fewer than eight."""
    sizes = np.abs(w[counted])
    return float(np.median(sizes) / 0.6745) if sizes.size >= 8 else np.nan
