"""The tight filter's measurement equations, compiled (Dai 2024, eqs 3-12, rederived).

A single difference of antenna i to the base, observed less computed at the antenna's assumed place, is::

    phase   z = −e · (r + C l_i − origin_i) + clock + λ N
    rate    ż = −e · (v + C (ω × l_i) − ω_ie × C l_i) + clock drift

with e the unit vector to the satellite. By the error state of :mod:`plumbline.fusion.strapdown`::

    ∂z/∂δr = −eᵀ     ∂z/∂ψ = eᵀ [(C l_i)×]
    ∂ż/∂δv = −eᵀ     ∂ż/∂ψ = eᵀ ([(C (ω × l_i))×] − [ω_ie×] [(C l_i)×])     ∂ż/∂δb_g = −eᵀ C [l_i×]

(Dai's eqs 8 and 11 vary the Earth-rate term as if it were turned with the body: [ω_ie×] acts on the turned lever arm.)
Clocks go with the difference to a reference row of the same group; the covariance of those differences holds what rows
share: their reference, and the base's measurement.
"""

import numpy as np
from numba import njit

from plumbline.constants import EARTH_ROTATION_RATE_RAD_S
from plumbline.fusion.rotations import cross, turned
from plumbline.records import Booleans, Floats, Ints

_RATE = EARTH_ROTATION_RATE_RAD_S


@njit(cache=True)
def design(
    nav: Floats, rate_rad_s: Floats, arms_body_m: Floats, origin_ecef_m: Floats, antenna: Ints, line: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Rows of phase (and code) and of range rate: designs (m, 15) each, and predictions (m,) m and m/s.

    ``rate_rad_s`` (3,) as measured; ``arms_body_m`` and ``origin_ecef_m`` (antennas, 3).
    """
    m, n = antenna.size, arms_body_m.shape[0]
    rotation = nav[6:15].reshape(3, 3)
    arms, arm_rates, places, speeds = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    for a in range(n):
        arms[a] = turned(rotation, arms_body_m[a])
        arm_rates[a] = turned(rotation, cross(rate_rad_s - nav[18:21], arms_body_m[a]))
        places[a] = nav[0:3] + arms[a] - origin_ecef_m[a]
        speeds[a] = nav[3:6] + arm_rates[a]
        speeds[a, 0] += _RATE * arms[a, 1]
        speeds[a, 1] -= _RATE * arms[a, 0]
    h, h_rate = np.zeros((m, 15)), np.zeros((m, 15))
    z, z_rate = np.empty(m), np.empty(m)
    spun = np.zeros(3)
    for i in range(m):
        a, e = antenna[i], line[i]
        h[i, 0:3] = -e
        h[i, 6:9] = -cross(arms[a], e)
        h_rate[i, 3:6] = -e
        spun[0], spun[1] = _RATE * e[1], -_RATE * e[0]  # eᵀ [ω_ie×] as a vector: e × ω_ie
        h_rate[i, 6:9] = cross(arms[a], spun) - cross(arm_rates[a], e)
        for k in range(3):
            along = 0.0
            for c in range(3):
                along += e[c] * rotation[c, k]
            spun[k] = along
        h_rate[i, 12:15] = cross(arms_body_m[a], spun)
        spun[2] = 0.0
        z[i] = -(e[0] * places[a, 0] + e[1] * places[a, 1] + e[2] * places[a, 2])
        z_rate[i] = -(e[0] * speeds[a, 0] + e[1] * speeds[a, 1] + e[2] * speeds[a, 2])
    return h, z, h_rate, z_rate


@njit(cache=True)
def references(group: Ints, sine: Floats, use: Booleans, held: Booleans) -> Ints:
    """Reference row (m,) of each row: the highest of its group, held ones first; −1 for rows not used."""
    m = group.size
    out = np.full(m, -1, np.int64)
    for i in range(m):
        if not use[i]:
            continue
        best, best_score = -1, -1.0
        for j in range(m):
            if use[j] and group[j] == group[i]:
                score = sine[j] + (2.0 if held[j] else 0.0)
                if score > best_score:
                    best, best_score = j, score
        out[i] = best
    return out


@njit(cache=True)
def differences(
    h: Floats, v: Floats, reference: Ints, variance: Floats, link: Ints, share: float
) -> tuple[Floats, Floats, Floats]:
    """Differences to the reference rows: design (d, n), innovations (d,) and their covariance (d, d).

    ``variance`` (m,) of the single differences, of which ``share`` is common to rows of one ``link``.
    """
    m, n = h.shape
    rows = np.empty(m, np.int64)
    d = 0
    for i in range(m):
        if reference[i] >= 0 and reference[i] != i:
            rows[d] = i
            d += 1
    out_h, out_v, r = np.empty((d, n)), np.empty(d), np.empty((d, d))
    root = np.sqrt(share * variance)  # covariance of rows of one link: the product of two
    for a in range(d):
        i, ri = rows[a], reference[rows[a]]
        for k in range(n):
            out_h[a, k] = h[i, k] - h[ri, k]
        out_v[a] = v[i] - v[ri]
        for b in range(a + 1):
            j, rj = rows[b], reference[rows[b]]
            total = 0.0
            if link[i] == link[j]:
                total += variance[i] if i == j else root[i] * root[j]
            if link[i] == link[rj]:
                total -= root[i] * root[rj]
            if link[ri] == link[j]:
                total -= root[ri] * root[j]
            if link[ri] == link[rj]:
                total += variance[ri] if ri == rj else root[ri] * root[rj]
            r[a, b] = total
            r[b, a] = total
    return out_h, out_v, r


@njit(cache=True)
def whitened(h: Floats, v: Floats, r: Floats) -> tuple[Floats, Floats, bool]:
    """``l⁻¹ h``, ``l⁻¹ v`` with ``r = l lᵀ``; False where ``r`` is not positive definite."""
    d, n = h.shape
    factor = np.zeros((d, d))
    for j in range(d):
        pivot = r[j, j]
        for k in range(j):
            pivot -= factor[j, k] * factor[j, k]
        if not pivot > 0.0:
            return h, v, False
        root = np.sqrt(pivot)
        factor[j, j] = root
        for i in range(j + 1, d):
            total = r[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            factor[i, j] = total / root
    out_h, out_v = h.copy(), v.copy()
    for i in range(d):
        for k in range(i):
            f = factor[i, k]
            if f != 0.0:
                for c in range(n):
                    out_h[i, c] -= f * out_h[k, c]
                out_v[i] -= f * out_v[k]
        inverse = 1.0 / factor[i, i]
        for c in range(n):
            out_h[i, c] *= inverse
        out_v[i] *= inverse
    return out_h, out_v, True


@njit(cache=True)
def informed(p: Floats, h: Floats, v: Floats) -> tuple[Floats, Floats]:
    """Estimate (n,) and covariance (n, n) after whitened observations ``v = h x + noise`` of unit variance.

    ``p (1 + hᵀ h p)⁻¹`` in Joseph's form, with the d observations compressed to n by a triangular factor of ``hᵀ h``
    (their sufficient statistic): much less work than one by one when d is several times n.
    """
    n = p.shape[0]
    information, right = h.T @ h, h.T @ v
    gain = np.linalg.solve(np.eye(n) + information @ p, np.eye(n)).T @ p  # p (1 + information p)⁻¹, transposed twice
    gain = 0.5 * (gain + gain.T)
    x = gain @ right
    keep = np.eye(n) - gain @ information
    updated = keep @ p @ keep.T + gain @ information @ gain
    return x, 0.5 * (updated + updated.T)


@njit(cache=True)
def group_medians(group: Ints, v: Floats, use: Booleans) -> Floats:
    """Median of the used rows of each row's group (m,); NaN with fewer than three."""
    m = group.size
    out = np.full(m, np.nan)
    done = np.zeros(m, np.bool_)
    for i in range(m):
        if done[i]:
            continue
        members = np.empty(m)
        n = 0
        for j in range(m):
            if group[j] == group[i]:
                done[j] = True
                if use[j]:
                    members[n] = v[j]
                    n += 1
        if n >= 3:
            middle = np.median(members[:n])
            for j in range(m):
                if group[j] == group[i]:
                    out[j] = middle
    return out
