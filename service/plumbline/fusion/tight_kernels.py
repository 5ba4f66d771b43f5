"""The tight filter's measurement equations, compiled (Dai 2024, eqs 3-12, rederived).

A single difference of antenna i to the base, observed less computed at the antenna's assumed place, is::

    phase   z = −e · (r + C l_i − origin_i) + clock + λ N
    rate    ż = −e · (v + C (ω × l_i) − ω_ie × C l_i) + clock drift

with e the unit vector to the satellite. By the error state of :mod:`plumbline.fusion.strapdown`::

    ∂z/∂δr = −eᵀ     ∂z/∂ψ = eᵀ [(C l_i)×]
    ∂ż/∂δv = −eᵀ     ∂ż/∂ψ = eᵀ ([(C (ω × l_i))×] − [ω_ie×] [(C l_i)×])     ∂ż/∂δb_g = −eᵀ C [l_i×]

(Dai's eqs 8 and 11 vary the Earth-rate term as if it were turned with the body: [ω_ie×] acts on the turned lever arm.)
Clocks are eliminated within their group, which is what differences between satellites do; the covariance holds what
rows share: the base's measurement.
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
def _members(link: Ints, use: Booleans, first: int, out: Ints) -> int:
    """Fill in the used rows from ``first`` on that share its link; returns how many."""
    n = 0
    for j in range(first, link.size):
        if use[j] and link[j] == link[first]:
            out[n] = j
            n += 1
    return n


@njit(cache=True)
def weighed(m: Floats, variance: Floats, link: Ints, group: Ints, use: Booleans, share: float) -> tuple[Floats, int]:
    """``W m`` (rows, k) of the rows used, W the inverse covariance of single differences without their group's clock.

    ``variance`` (rows,), of which ``share`` is common to rows of one ``link`` (the base's measurement): in a link of k
    rows the inverse covariance is ``1/d_i δ_ij − w_i w_j / (1 + k r)`` with ``d = (1 − share) variance``, ``r = share /
    (1 − share)``, ``w_i = √(share variance_i) / d_i`` (Sherman & Morrison). Clocks are free parameters: eliminating
    them is double differencing with its full covariance, whatever the reference. Second: degrees of freedom left.
    """
    rows, columns = m.shape
    groups = np.unique(group[use])
    slot, g = np.searchsorted(groups, group), groups.size
    out, weight = np.zeros((rows, columns)), np.zeros((rows, g))
    inverse = 1.0 / ((1.0 - share) * variance)
    w = np.sqrt(share * variance) * inverse
    done, members, n_used = np.zeros(rows, np.bool_), np.empty(rows, np.int64), 0
    for i in range(rows):
        if not use[i] or done[i]:
            continue
        k = _members(link, use, i, members)
        n_used += k
        damp = 1.0 / (1.0 + k * share / (1.0 - share))
        total, total_weight = np.zeros(columns), np.zeros(g)
        for j in members[:k]:
            done[j] = True
            total += w[j] * m[j]
            total_weight[slot[j]] += w[j]
        for j in members[:k]:
            out[j] = inverse[j] * m[j] - damp * w[j] * total
            weight[j] = -damp * w[j] * total_weight
            weight[j, slot[j]] += inverse[j]
    if g > 0:
        clock, clock_m = np.zeros((g, g)), np.zeros((g, columns))
        for i in range(rows):
            if use[i]:
                clock[slot[i]] += weight[i]
                clock_m[slot[i]] += out[i]
        out -= weight @ np.linalg.solve(clock, clock_m)
    return out, n_used - g


@njit(cache=True)
def informed(p: Floats, information: Floats, right: Floats) -> tuple[Floats, Floats]:
    """Estimate (n,) and covariance (n, n) after observations of normal equations ``information x = right``.

    ``p (1 + information p)⁻¹`` in Joseph's form.
    """
    n = p.shape[0]
    gain = np.linalg.solve(np.eye(n) + information @ p, np.eye(n)).T @ p  # p (1 + information p)⁻¹, transposed twice
    gain = 0.5 * (gain + gain.T)
    x = gain @ right
    keep = np.eye(n) - gain @ information
    updated = keep @ p @ keep.T + gain @ information @ gain
    return x, 0.5 * (updated + updated.T)


@njit(cache=True)
def normal_equations(
    h: Floats, v: Floats, variance: Floats, link: Ints, group: Ints, use: Booleans, share: float,
    column: Ints, wavelength_m: Floats, n: int,
) -> tuple[Floats, Floats, float, int]:  # fmt: skip
    """Normal matrix (n, n), right side (n,), squared norm and degrees of freedom of one kind of observation.

    ``h`` (rows, 15); row i has its ambiguity, cycles, at state ``column[i]`` (−1: it is held); ``v`` (rows,).
    """
    rows = v.size
    m = np.zeros((rows, n + 1))
    for i in range(rows):
        if use[i]:
            m[i, :15] = h[i]
            if column[i] >= 0:
                m[i, column[i]] = wavelength_m[i]
            j = 0
            while not (use[j] and group[j] == group[i]):
                j += 1
            m[i, n] = v[i] - v[j]  # most of the clock, which would cost digits
    w, degrees = weighed(m, variance, link, group, use, share)
    full = m.T @ w
    return full[:n, :n].copy(), full[:n, n].copy(), full[n, n], degrees


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


@njit(cache=True)
def fitting(
    p: Floats, h: Floats, phase: Floats, held: Booleans, group: Ints, variance: Floats, most: Floats, gate_sigma: float
) -> Booleans:
    """Rows (m,) whose phase innovation is near the median of the held ones of its group; rows not held all are.

    Near is ``gate_sigma`` of what ``p`` (15, 15) and ``variance`` (m,) lead to expect, and ``most`` (m,) m.
    """
    m = phase.size
    there = np.isfinite(phase)
    middle = group_medians(group, phase, held & there)
    for i in range(m):
        if held[i] and there[i] and not np.isnan(middle[i]):
            expected = variance[i]
            for j in range(15):
                for k in range(15):
                    expected += h[i, j] * p[j, k] * h[i, k]
            there[i] = abs(phase[i] - middle[i]) <= min(gate_sigma * np.sqrt(expected), most[i])
    return there
