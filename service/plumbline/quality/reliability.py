"""What an epoch's observations are worth: Lee 2016, section 2.3, for a filter.

With ``S`` the covariance of the innovations and ``R`` that of the observations (Teunissen 1990 for the filter's case):

* redundancy number ``rᵢ = Rᵢ (S⁻¹)ᵢᵢ`` (eq. 43): how much of an error shows in the observation's own residual;
* internal reliability, MDB, ``√(λ₀ / (S⁻¹)ᵢᵢ)`` (eq. 55): the error that is found with the power of the test;
* external reliability ``∇x = K eᵢ MDB`` with the filter's gain ``K = P⁺ Hᵀ R⁻¹`` (eq. 56): its effect on the position;
* QDOP ``eᵢᵀ A (AᵀA)⁻¹ Aᵀ eᵢ`` of geometry alone (eq. 52): 1, and nothing else checks the satellite.

Given errors already found, ``S⁻¹`` is the swept one of :mod:`plumbline.estimation.dia`, so that an observation that was
left out has the numbers of its re-instatement.

Protection level (after RAIM's slope method: Brown & Chin 1998; RTCA DO-229D, J.2): without an error, the position error
exceeds ``k σ`` with the integrity risk. With an error of one observation, of prior probability ``p``, a larger error
than ``b* = (N_w + N_{1−ρ}) σ_b`` is missed with less than ``ρ = risk / p``, and a smaller one moves the position by no
more than its slope times ``b*``; the larger of both bounds is the level. Horizontally, ``P(|e| > k σ_max) ≤
exp(−k²/2)`` with the larger half axis of the error ellipse.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from scipy.stats import norm

from plumbline.estimation import dia_tables
from plumbline.estimation.dia_tables import Levels
from plumbline.estimation.kalman import cholesky_lower, lower_inverse
from plumbline.records import Booleans, Floats, Ints

_AXES: Final = 3


@dataclass(frozen=True, slots=True)
class Integrity:
    """What the protection levels promise: at most this risk an epoch, if an error is no likelier than its prior."""

    risk: float = 1e-5
    prior: float = 1e-3  # that an epoch holds an error of one observation


class Factors(NamedTuple):
    """Multiples of sigmas, in the kernels' form."""

    root_noncentrality: float
    missed: float  # of an estimate's sigma: larger errors are missed with less than the conditional risk
    horizontal: float  # without an error
    vertical: float
    horizontal_fault: float  # with one
    vertical_fault: float


@lru_cache(maxsize=64)
def factors(levels: Levels, integrity: Integrity, tail: float = 1.0) -> Factors:
    """Factors of the levels and the integrity promised; the w-test's critical value is raised by ``tail``."""
    conditional = min(integrity.risk / integrity.prior, 0.5)
    raised = (tail - 1.0) * dia_tables.w_critical(levels)
    return Factors(
        root_noncentrality=float(np.sqrt(dia_tables.noncentrality(levels))) + raised,
        missed=dia_tables.missed_detection_factor(levels, conditional) + raised,
        horizontal=float(np.sqrt(-2.0 * np.log(integrity.risk))),
        vertical=float(norm.ppf(1.0 - 0.5 * integrity.risk)),
        horizontal_fault=float(np.sqrt(-2.0 * np.log(conditional))),
        vertical_fault=float(norm.ppf(1.0 - 0.5 * conditional)),
    )


class Measures(NamedTuple):
    """Quality measures of an epoch, a row an observation."""

    redundancy: Floats  # (m,)
    mdb: Floats  # (m,) in the observation's unit
    external: Floats  # (m, 3) east, north, up; NaN for what was left out
    protection_horizontal: float
    protection_vertical: float


@njit(cache=True)
def _largest_horizontal_sigma(covariance: Floats) -> float:
    """Larger half axis of the horizontal error ellipse of an ENU covariance (3, 3)."""
    mean = 0.5 * (covariance[0, 0] + covariance[1, 1])
    half = 0.5 * (covariance[0, 0] - covariance[1, 1])
    return float(np.sqrt(mean + np.sqrt(half * half + covariance[0, 1] * covariance[0, 1])))


@njit(cache=True)
def measures(
    sigma_b: Floats, test_variance: Floats, used: Booleans, h: Floats, variance: Floats, position_rows: Floats,
    rotation: Floats, factor: Factors, usual: Floats | None = None,
) -> Measures:  # fmt: skip
    """Measures of an epoch after an update.

    ``sigma_b`` (m,) sigma of each observation's estimated error (:func:`plumbline.estimation.dia.w_values`),
    ``test_variance`` (m,) of the observation in the tests, ``variance`` (m,) in the update, ``h`` (m, n) design,
    ``position_rows`` (3, n) rows of the updated covariance that belong to the position, the position being the first
    three states; ``rotation`` (3, 3) from their frame to east, north, up; ``usual`` (m,) how large the w-statistics are
    against a standard normal's, None: as large.
    """
    m, n = h.shape
    redundancy, mdb, external = np.zeros(m), np.full(m, np.inf), np.full((m, _AXES), np.nan)
    worst_horizontal, worst_vertical = 0.0, 0.0
    along, moved = np.zeros(_AXES), np.zeros(_AXES)
    for i in range(m):
        redundancy[i] = test_variance[i] / (sigma_b[i] * sigma_b[i])
        sigma = sigma_b[i] if usual is None else sigma_b[i] * usual[i]
        mdb[i] = factor.root_noncentrality * sigma
        if not used[i]:
            continue
        along[:] = 0.0
        for k in range(n):
            if h[i, k] != 0.0:
                for a in range(_AXES):
                    along[a] += position_rows[a, k] * h[i, k]
        for a in range(_AXES):
            moved[a] = 0.0
            for b in range(_AXES):
                moved[a] += rotation[a, b] * along[b] / variance[i]
            external[i, a] = moved[a] * mdb[i]
        horizontal = np.sqrt(moved[0] * moved[0] + moved[1] * moved[1])
        worst_horizontal = max(worst_horizontal, horizontal * sigma)
        worst_vertical = max(worst_vertical, abs(moved[2]) * sigma)
    covariance = rotation @ np.ascontiguousarray(position_rows[:, :_AXES]) @ rotation.T
    sigma_h, sigma_v = _largest_horizontal_sigma(covariance), np.sqrt(covariance[2, 2])
    level_h = max(factor.horizontal * sigma_h, factor.missed * worst_horizontal + factor.horizontal_fault * sigma_h)
    level_v = max(factor.vertical * sigma_v, factor.missed * worst_vertical + factor.vertical_fault * sigma_v)
    return Measures(redundancy, mdb, external, level_h, level_v)


class Geometry(NamedTuple):
    """Dilutions of precision, NaN where the satellites do not suffice, and each satellite's QDOP (n,)."""

    hdop: float
    vdop: float
    pdop: float
    qdop: Floats


@njit(cache=True)
def geometry(line: Floats, clock: Ints, used: Booleans, rotation: Floats) -> Geometry:
    """Dilutions from unit vectors to satellites ``line`` (n, 3), turned by ``rotation`` to east, north, up.

    ``clock`` (n,) number of each one's receiver clock; satellites not ``used`` (n,) get the QDOP they would have.
    """
    n = clock.size
    column = np.full(np.max(clock) + 1 if n > 0 else 0, -1, np.int64)
    unknowns = _AXES
    for i in range(n):
        if used[i] and column[clock[i]] < 0:
            column[clock[i]] = unknowns
            unknowns += 1
    design = np.zeros((n, unknowns))
    for i in range(n):
        for a in range(_AXES):
            for b in range(_AXES):
                design[i, a] -= rotation[a, b] * line[i, b]
        if column[clock[i]] >= 0:
            design[i, column[clock[i]]] = 1.0
    kept = np.ascontiguousarray(design[used])
    qdop = np.full(n, np.nan)
    factor, positive = cholesky_lower(kept.T @ kept)
    if not positive or kept.shape[0] < unknowns:
        return Geometry(np.nan, np.nan, np.nan, qdop)
    inverse = lower_inverse(factor)
    q = np.zeros(_AXES)
    for a in range(_AXES):
        q[a] = np.sum(inverse[:, a] ** 2)
    for i in range(n):
        size = np.sum((inverse @ design[i]) ** 2)
        qdop[i] = size if used[i] else size / (1.0 + size)
    return Geometry(np.sqrt(q[0] + q[1]), np.sqrt(q[2]), np.sqrt(q[0] + q[1] + q[2]), qdop)
