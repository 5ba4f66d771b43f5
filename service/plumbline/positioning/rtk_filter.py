"""The filter of relative positioning in information form.

Model of a single difference of group g (``b`` baseline correction, ``c`` a clock for each group and kind and epoch)::

    code  = −line · b + c_code(g) + ε            phase = −line · b + c_phase(g) + λ (a + offset) + ε

A group's clock is eliminated from its normal equations by subtracting weighted means, which is exactly what double
differencing with its full covariance does, whatever the reference satellite (Teunissen & Kleusberg 1998, ch. 5).
"""

from typing import Final

import numpy as np
from numba import njit

from plumbline.positioning.rtk_state import N_CORE
from plumbline.positioning.state import Records
from plumbline.records import Booleans, Floats, Ints

_LEAST_PIVOT: Final = 1e-10  # of the largest diagonal element: less is no information
_LEAST_UNIT_PIVOT: Final = 1e-13  # of a matrix scaled to a unit diagonal


@njit(cache=True)
def solve3(normal: Floats) -> tuple[Floats, bool]:
    """Inverse of a symmetric positive matrix (3, 3) by cofactors, and whether it is regular."""
    inverse = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            a, b = (j + 1) % 3, (j + 2) % 3
            c, d = (i + 1) % 3, (i + 2) % 3
            inverse[i, j] = normal[a, c] * normal[b, d] - normal[a, d] * normal[b, c]
    determinant = normal[0, 0] * inverse[0, 0] + normal[0, 1] * inverse[1, 0] + normal[0, 2] * inverse[2, 0]
    scale = normal[0, 0] * normal[1, 1] * normal[2, 2]
    if not determinant > 1e-12 * scale or scale <= 0.0:
        return inverse, False
    return inverse / determinant, True


@njit(cache=True)
def group_means(line, v, weight, group, n_groups, use):  # type: ignore[no-untyped-def]
    """Weighted means (groups, 4) of lines and values, and sums of weights (groups,)."""
    mean, total = np.zeros((n_groups, 4)), np.zeros(n_groups)
    for i in range(v.size):
        if use[i]:
            g, w = group[i], weight[i]
            total[g] += w
            for k in range(3):
                mean[g, k] -= w * line[i, k]
            mean[g, 3] += w * v[i]
    for g in range(n_groups):
        if total[g] > 0.0:
            for k in range(4):
                mean[g, k] /= total[g]
    return mean, total


# ------------------------------------------------------------------------------------------- information


@njit(cache=True)
def eliminate(information: Floats, right: Floats, i: int) -> None:
    """Marginalise state i in place: what it was is forgotten, what it told of the others is kept (Schur complement)."""
    n = right.size
    pivot = information[i, i]
    largest = 0.0
    for k in range(n):
        largest = max(largest, information[k, k])
    if pivot > _LEAST_PIVOT * largest:
        column = information[i].copy()
        for j in range(n):
            if column[j] != 0.0 and j != i:
                factor = column[j] / pivot
                right[j] -= factor * right[i]
                for k in range(n):
                    information[j, k] -= factor * column[k]
    for k in range(n):
        information[i, k] = 0.0
        information[k, i] = 0.0
    right[i] = 0.0


@njit(cache=True)
def carry_over(information: Floats, right: Floats, previous: Ints) -> tuple[Floats, Floats]:
    """Information after arcs have come and gone: arc i carries on old arc ``previous[i]`` (−1: begins anew)."""
    old = right.size - N_CORE
    kept = np.zeros(old, np.bool_)
    for i in previous:
        if i >= 0:
            kept[i] = True
    for i in range(old):
        if not kept[i]:
            eliminate(information, right, N_CORE + i)
    n = previous.size + N_CORE
    source = np.full(n, -1)
    source[:N_CORE] = np.arange(N_CORE)
    for i in range(previous.size):
        if previous[i] >= 0:
            source[N_CORE + i] = N_CORE + previous[i]
    out, out_right = np.zeros((n, n)), np.zeros(n)
    for i in range(n):
        if source[i] >= 0:
            out_right[i] = right[source[i]]
            for k in range(n):
                if source[k] >= 0:
                    out[i, k] = information[source[i], source[k]]
    return out, out_right


@njit(cache=True)
def move_position(information: Floats, right: Floats, variance_m2: float) -> None:
    """The antenna may have moved by a random step of this variance an axis (infinite: anywhere), in place.

    For ``b' = b + w``, ``w`` of information ``q``: ``N' = N − N_b (N_bb + q)⁻¹ N_bᵀ`` among the ambiguities, and ``q``
    in the place of what the old position knew.
    """
    if np.isinf(variance_m2):
        for i in range(N_CORE):
            eliminate(information, right, i)
        return
    if variance_m2 <= 0.0:
        return
    n, q = right.size, 1.0 / variance_m2
    block = information[:N_CORE, :N_CORE].copy()
    for i in range(N_CORE):
        block[i, i] += q
    inverse, regular = solve3(block)
    if not regular:
        return
    coupling = information[:N_CORE].copy()
    for i in range(N_CORE):
        for k in range(N_CORE):
            coupling[i, k] = -q if i == k else 0.0
    step = inverse @ coupling
    push = inverse @ right[:N_CORE]
    for i in range(N_CORE):
        right[i] = 0.0
        for k in range(n):
            information[i, k] = 0.0
            information[k, i] = 0.0
        information[i, i] = q
    for i in range(n):
        for m in range(N_CORE):
            right[i] -= coupling[m, i] * push[m]
            for k in range(n):
                information[i, k] -= coupling[m, i] * step[m, k]


@njit(cache=True)
def accumulate(
    information: Floats, right: Floats, rows: Records, arcs: Records, use_code: Booleans, use_phase: Booleans,
    shift_m: Floats, n_groups: int,
) -> None:  # fmt: skip
    """Add an epoch's codes and phases; ``shift_m`` (3,) is the approximate position less the filter's origin."""
    n = rows.size
    v, w, line = np.zeros(n), np.zeros(n), np.zeros((n, 3))
    group = np.zeros(n, np.int64)
    for kind in range(2):
        for i in range(n):
            row = rows[i]
            group[i] = row.group
            moved = 0.0
            for k in range(3):
                line[i, k] = row.line[k]
                moved -= row.line[k] * shift_m[k]
            if kind == 0:
                w[i] = row.code_weight if use_code[i] else 0.0
                v[i] = row.code_oc_m + moved if w[i] > 0.0 else 0.0
            else:
                w[i] = row.phase_weight if use_phase[i] and row.arc >= 0 else 0.0
                v[i] = row.phase_oc_m + moved - row.wavelength_m * arcs[row.arc].offset_cycles if w[i] > 0.0 else 0.0
        _add(information, right, rows, line, v, w, group, n_groups, kind == 1)


@njit(cache=True)
def _add(information, right, rows, line, v, w, group, n_groups, with_ambiguities):  # type: ignore[no-untyped-def]
    """Add one kind of observation, its group clocks eliminated."""
    mean, total = group_means(line, v, w, group, n_groups, w > 0.0)
    d = np.zeros(3)
    for i in range(v.size):
        if w[i] == 0.0:
            continue
        g = group[i]
        for k in range(3):
            d[k] = -line[i, k] - mean[g, k]
        y = v[i] - mean[g, 3]
        for k in range(3):
            right[k] += w[i] * d[k] * y
            for j in range(3):
                information[k, j] += w[i] * d[k] * d[j]
        if not with_ambiguities:
            continue
        a, scale = N_CORE + rows[i].arc, w[i] * rows[i].wavelength_m
        right[a] += scale * y
        information[a, a] += scale * rows[i].wavelength_m
        for k in range(3):
            information[k, a] += scale * d[k]
            information[a, k] += scale * d[k]
        for j in range(v.size):
            if w[j] > 0.0 and group[j] == g:
                information[a, N_CORE + rows[j].arc] -= scale * w[j] * rows[j].wavelength_m / total[g]


# ------------------------------------------------------------------------------------------- estimates


@njit(cache=True)
def _upper_factor(a: Floats) -> tuple[Floats, bool]:
    """``u`` upper triangular with ``uᵀ u = a`` (n, n), row by row; ``a`` is used up."""
    n = a.shape[0]
    upper = np.zeros((n, n))
    for i in range(n):
        if not a[i, i] > _LEAST_UNIT_PIVOT:
            return upper, False
        root = 1.0 / np.sqrt(a[i, i])
        for k in range(i, n):
            upper[i, k] = a[i, k] * root
        for j in range(i + 1, n):
            factor = upper[i, j]
            if factor != 0.0:
                for k in range(j, n):
                    a[j, k] -= factor * upper[i, k]
    return upper, True


@njit(cache=True)
def _upper_inverse(upper: Floats) -> Floats:
    """Inverse of an upper triangular matrix, rows from the last up."""
    n = upper.shape[0]
    inverse = np.zeros((n, n))
    for i in range(n - 1, -1, -1):
        inverse[i, i] = 1.0
        for j in range(i + 1, n):
            factor = upper[i, j]
            if factor != 0.0:
                for k in range(j, n):
                    inverse[i, k] -= factor * inverse[j, k]
        for k in range(i, n):
            inverse[i, k] /= upper[i, i]
    return inverse


@njit(cache=True)
def invert(normal: Floats) -> tuple[Floats, bool]:
    """Inverse of a symmetric positive definite matrix (n, n), scaled to a unit diagonal first."""
    n = normal.shape[0]
    scale, a = np.zeros(n), np.zeros((n, n))
    for i in range(n):
        if not normal[i, i] > 0.0:
            return a, False
        scale[i] = 1.0 / np.sqrt(normal[i, i])
    for i in range(n):
        for k in range(n):
            a[i, k] = normal[i, k] * scale[i] * scale[k]
    upper, positive = _upper_factor(a)
    if not positive:
        return a, False
    inverse, out = _upper_inverse(upper), np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, n):
                total += inverse[i, k] * inverse[j, k]
            out[i, j] = total * scale[i] * scale[j]
            out[j, i] = out[i, j]
    return out, True


@njit(cache=True)
def estimate(information: Floats, right: Floats, known: Booleans, values: Floats) -> tuple[Floats, Floats, bool]:
    """States (n,) and their covariance (n, n; zero rows where known) given that some states have known values.

    Last item: whether the rest is determined. The others' entries of ``values`` are not looked at.
    """
    n = right.size
    free = np.flatnonzero(~known)
    m = free.size
    normal, side = np.zeros((m, m)), np.zeros(m)
    for i in range(m):
        side[i] = right[free[i]]
        for k in range(n):
            if known[k]:
                side[i] -= information[free[i], k] * values[k]
        for k in range(m):
            normal[i, k] = information[free[i], free[k]]
    inverse, regular = invert(normal)
    x, covariance = np.where(known, values, 0.0), np.zeros((n, n))
    if not regular:
        return x, covariance, False
    for i in range(m):
        total = 0.0
        for k in range(m):
            total += inverse[i, k] * side[k]
            covariance[free[i], free[k]] = inverse[i, k]
        x[free[i]] = total
    return x, covariance, True
