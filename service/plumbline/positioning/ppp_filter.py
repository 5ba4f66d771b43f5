"""The position filter: prediction, the test of an epoch's observations, and the update.

Observation rows are ordered pair by pair, code before phase. Positions are Earth-fixed metres; all systems' clocks move
together with the receiver's (white noise, foretold by the codes) and slowly against each other.
"""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plumbline.estimation.kalman import (
    cholesky_lower,
    innovation_covariance,
    lower_inverse,
    update_sequential,
    w_statistics,
    whiten,
)
from plumbline.positioning.ppp_noise import Tuning, code_scale, variances
from plumbline.positioning.state import CLOCKS, GRADIENTS, N_CORE, POSITION, ZENITH_DELAY, Records
from plumbline.records import Booleans, Floats, Ints

_CLOCK: Final = CLOCKS.start
_N_CLOCKS: Final = CLOCKS.stop - CLOCKS.start
_NORTH: Final = GRADIENTS.start
_EAST: Final = GRADIENTS.start + 1
_AMBIGUITY_SIGMA_M: Final = 60.0
_NEW_CLOCK_SIGMA_M: Final = 30.0
_POSITION_AXES: Final = POSITION.stop
W_LIMIT: Final = 4.0  # of codes
W_LIMIT_OF_SCALE: Final = 5.0  # of phases, in units of their usual statistic
_DOUBT: Final = 0.6  # share of its limit from which an observation is believed less
_LEAST_SCALE: Final = 0.2
_MOST_SCALE: Final = 2.0
UPDATED: Final = 0
DISAGREES: Final = 1
LOST: Final = 2
_NORMAL_MEDIAN: Final = 0.6745  # median of a standard normal's absolute value


@njit(cache=True)
def carry_over(x: Floats, p: Floats, previous: Ints) -> tuple[Floats, Floats]:
    """State and covariance for the new arcs: core states as they are, ambiguities from ``previous`` (−1: zero)."""
    n = N_CORE + previous.size
    source = np.empty(n, np.int64)
    for i in range(n):
        source[i] = i if i < N_CORE else (N_CORE + previous[i - N_CORE] if previous[i - N_CORE] >= 0 else -1)
    out_x, out_p = np.zeros(n), np.zeros((n, n))
    for i in range(n):
        if source[i] >= 0:
            out_x[i] = x[source[i]]
            for j in range(n):
                if source[j] >= 0:
                    out_p[i, j] = p[source[i], source[j]]
    return out_x, out_p


@njit(cache=True)
def predict_state(p: Floats, arcs: Records, dt_s: float, tuning: Tuning) -> None:
    """Add the process noise of ``dt_s`` to ``p``, in place; states not in use stay at zero."""
    for i in range(_POSITION_AXES):
        p[i, i] += tuning.position_m_sqrt_s**2 * dt_s + tuning.position_jump_m**2
    p[ZENITH_DELAY, ZENITH_DELAY] += tuning.zenith_delay_m_sqrt_s**2 * dt_s
    for i in (_NORTH, _EAST):
        p[i, i] += tuning.gradient_m_sqrt_s**2 * dt_s
    for i in range(_CLOCK, _CLOCK + _N_CLOCKS):
        if p[i, i] > 0.0:
            p[i, i] += tuning.system_clock_m_sqrt_s**2 * dt_s
            for j in range(_CLOCK, _CLOCK + _N_CLOCKS):
                if p[j, j] > 0.0:
                    p[i, j] += tuning.common_clock_m**2
    for k in range(arcs.size):
        if arcs[k].estimated:
            p[N_CORE + k, N_CORE + k] += tuning.ambiguity_m_sqrt_s**2 * dt_s


@njit(cache=True)
def _reduced(row, x: Floats) -> float:  # type: ignore[no-untyped-def]
    """Prediction without receiver clock, wind-up and ambiguity."""
    troposphere = row.wet * x[ZENITH_DELAY] + row.gradient_north * x[_NORTH] + row.gradient_east * x[_EAST]
    return float(row.predicted_m + troposphere)


@njit(cache=True)
def foretell_clocks(x: Floats, p: Floats, rows: Records, pairs: Records) -> Floats:
    """Move the clocks to where the codes see them, in place; begin those of systems not seen before.

    Returns what is left between codes and prediction, m (n,), NaN where not usable: large where the position is wrong.
    """
    misclosure, active = np.full(rows.size, np.nan), np.full(rows.size, np.nan)
    for i in range(rows.size):
        if rows[i].usable:
            k = _CLOCK + pairs[i].system
            misclosure[i] = pairs[i].code_m - _reduced(rows[i], x) - x[k]
            if p[k, k] > 0.0:
                active[i] = misclosure[i]
    shift = np.nanmedian(active)
    if not np.isnan(shift):
        for k in range(_CLOCK, _CLOCK + _N_CLOCKS):
            if p[k, k] > 0.0:
                x[k] += shift
        for i in range(rows.size):
            if not np.isnan(active[i]):
                misclosure[i] -= shift
    for system in range(_N_CLOCKS):
        k = _CLOCK + system
        own = misclosure[(pairs["system"] == system) & ~np.isnan(misclosure)]
        if p[k, k] == 0.0 and own.size > 0:
            x[k] = np.median(own)
            p[k, k] = _NEW_CLOCK_SIGMA_M**2
            for i in range(rows.size):
                if pairs[i].system == system:
                    misclosure[i] -= x[k]
    return misclosure


@njit(cache=True)
def begin_ambiguities(x: Floats, p: Floats, rows: Records, pairs: Records, arcs: Records, arc_of_pair: Ints) -> None:
    """Begin the ambiguities of arcs whose state is not in use, at phase less code, in place."""
    for i in range(rows.size):
        arc = arc_of_pair[i]
        if rows[i].usable and arc >= 0 and not arcs[arc].estimated:
            k = N_CORE + arc
            x[k] = pairs[i].phase_m - rows[i].wind_up_m - _reduced(rows[i], x) - x[_CLOCK + pairs[i].system]
            p[k, :] = 0.0
            p[:, k] = 0.0
            p[k, k] = _AMBIGUITY_SIGMA_M**2
            arcs[arc].estimated = True


@njit(cache=True)
def _design_row(h: Floats, row, system: int) -> None:  # type: ignore[no-untyped-def]
    """Partials of a code to the core states."""
    for k in range(_POSITION_AXES):
        h[k] = -row.line[k]
    h[ZENITH_DELAY] = row.wet
    h[_NORTH], h[_EAST] = row.gradient_north, row.gradient_east
    h[_CLOCK + system] = 1.0


@njit(cache=True)
def observation_equations(
    x: Floats, rows: Records, pairs: Records, arc_of_pair: Ints, code_variance: Floats, phase_variance: Floats
) -> tuple[Floats, Floats, Floats, Ints]:
    """Design (m, n), innovations and variances (m,) and of each row 2·pair for a code, 2·pair + 1 for a phase."""
    most = 2 * rows.size
    h, v, r = np.zeros((most, x.size)), np.zeros(most), np.zeros(most)
    kind = np.zeros(most, np.int64)
    m = 0
    for i in range(rows.size):
        if not rows[i].usable:
            continue
        reduced = _reduced(rows[i], x) + x[_CLOCK + pairs[i].system]
        _design_row(h[m], rows[i], pairs[i].system)
        v[m], r[m], kind[m] = pairs[i].code_m - reduced, code_variance[i], 2 * i
        m += 1
        arc = arc_of_pair[i]
        if arc < 0:
            continue
        _design_row(h[m], rows[i], pairs[i].system)
        h[m, N_CORE + arc] = 1.0
        v[m] = pairs[i].phase_m - rows[i].wind_up_m - reduced - x[N_CORE + arc]
        r[m], kind[m] = phase_variance[i], 2 * i + 1
        m += 1
    return h[:m], v[:m], r[:m], kind[:m]


@njit(cache=True)
def _without(s: Floats, v: Floats, use: Booleans) -> tuple[Floats, Floats, Ints]:
    """The rows still in use: their covariance, innovations and indices."""
    keep = np.flatnonzero(use)
    out = np.empty((keep.size, keep.size))
    for i in range(keep.size):
        for j in range(keep.size):
            out[i, j] = s[keep[i], keep[j]]
    return out, v[keep], keep


@njit(cache=True)
def phase_scale(statistics: Floats, kind: Ints) -> float:
    """How large the phases' w-statistics are against a standard normal's, from their median; NaN without any."""
    sizes = np.abs(statistics[kind % 2 == 1])
    return np.median(sizes) / _NORMAL_MEDIAN if sizes.size > 0 else np.nan


@njit(cache=True)
def _limits(kind: Ints, scale: float) -> Floats:
    """What each w-statistic may be at most: a factor of what the phases' usually are; codes by their own variance."""
    limits = np.full(kind.size, W_LIMIT)
    limits[kind % 2 == 1] = W_LIMIT_OF_SCALE * min(max(scale, _LEAST_SCALE), _MOST_SCALE)
    return limits


@njit(cache=True)
def doubt(ratio: float) -> float:
    """Factor on the variance of an observation whose w-statistic is ``ratio`` of its limit: 1 up to ``_DOUBT``.

    Beyond, it grows without bound towards the limit (the IGG III weights of Yang 1999), so that whether an observation
    lies just below or just above makes no jump in the position.
    """
    if ratio <= _DOUBT:
        return 1.0
    left = max(1.0 - ratio, 1e-3)
    return ratio / _DOUBT * ((1.0 - _DOUBT) / left) ** 2


_Snooped = tuple[Booleans, Floats, Floats, float, bool]
_Updated = tuple[Booleans, Floats, float, bool]
_Advanced = tuple[int, Floats, Floats, Floats, Ints, Booleans, Floats, float]


@njit(cache=True)
def snoop(s: Floats, v: Floats, kind: Ints, usual_scale: float, most: int) -> _Snooped:
    """Leave out one observation after another while the largest w-statistic says so, ``most`` at most.

    The phases' variances hold their slow errors too, so that their statistics are smaller than a standard normal's:
    they are judged by what they usually are (``usual_scale``) or, where an epoch is restless altogether, are now.
    Returns which are in use (m,), factors on their variances (m,), the whitened innovations of those in use,
    :func:`phase_scale` of the epoch and whether what is left agrees.
    """
    use, factors = np.ones(v.size, np.bool_), np.ones(v.size)
    scale_now, limits, white = np.nan, np.full(v.size, W_LIMIT), v
    for attempt in range(most + 1):
        reduced, innovation, keep = _without(s, v, use)
        cholesky, positive = cholesky_lower(reduced)
        if not positive:
            break
        inverse = lower_inverse(cholesky)
        white = whiten(inverse, innovation)
        statistics = np.abs(w_statistics(inverse, white))
        if attempt == 0:
            scale_now = phase_scale(statistics, kind)
            limits = _limits(kind, np.fmax(usual_scale, scale_now))
        ratio = statistics / limits[keep]
        worst = np.argmax(ratio)
        if ratio[worst] <= 1.0:
            for i in range(keep.size):
                factors[keep[i]] = doubt(ratio[i])
            return use, factors, white, scale_now, True
        if attempt < most:
            use[keep[worst]] = False
    return use, factors, white, scale_now, False


@njit(cache=True)
def book_keep(kind: Ints, use: Booleans, arcs: Records, arc_of_pair: Ints, added_code_weight: Floats) -> None:
    """After an update: count refused phases and the codes' weight in their arcs, in place."""
    for i in range(kind.size):
        pair = kind[i] // 2
        arc = arc_of_pair[pair]
        if arc < 0:
            continue
        if kind[i] % 2 == 0:
            if use[i]:
                arcs[arc].code_weight_m2 += added_code_weight[pair]
        elif use[i]:
            arcs[arc].refused = 0
        else:
            arcs[arc].refused += 1


@njit(cache=True)
def update(
    x: Floats, p: Floats, h: Floats, v: Floats, r: Floats, kind: Ints, usual_scale: float, most: int
) -> _Updated:
    """Test an epoch's observations and, where they agree, update ``x`` and ``p`` in place by those that passed.

    States without variance (not in use) are left aside. Returns which were used (m,), their whitened innovations, the
    phases' scale and whether the observations agree; where they do not, nothing is changed.
    """
    active = np.flatnonzero(np.diag(p) > 0.0)
    n = active.size
    x_active, p_active, h_active = x[active], np.empty((n, n)), np.ascontiguousarray(h[:, active])
    for i in range(n):
        for j in range(n):
            p_active[i, j] = p[active[i], active[j]]
    s = innovation_covariance(p_active, h_active, r)
    use, factors, white, scale_now, agrees = snoop(s, v, kind, usual_scale, most)
    if agrees:
        update_sequential(x_active, p_active, h_active, r * factors, v, use)
        for i in range(n):
            x[active[i]] = x_active[i]
            for j in range(n):
                p[active[i], active[j]] = p_active[i, j]
    return use, white, scale_now, agrees


@njit(cache=True)
def advance(
    x: Floats, p: Floats, arcs: Records, rows: Records, pairs: Records, arc_of_pair: Ints, dt_s: float,
    usual_scale: float, lost_m: float, tuning: Tuning,
) -> _Advanced:  # fmt: skip
    """An epoch of the filter: predict over ``dt_s`` (0: the first), test, update ``x``, ``p`` and ``arcs`` in place.

    Returns UPDATED, DISAGREES or LOST (the codes are further than ``lost_m`` from the prediction), the design (m, n),
    innovations and variances (m,), kinds (m,), which were used (m,), their whitened innovations and the phases' scale.
    """
    if dt_s > 0.0:
        predict_state(p, arcs, dt_s, tuning)
    misclosure_m = foretell_clocks(x, p, rows, pairs)
    none = np.zeros(0)
    if dt_s > 0.0 and np.nanmedian(np.abs(misclosure_m)) > lost_m:
        return LOST, np.zeros((0, 0)), none, none, np.zeros(0, np.int64), np.zeros(0, np.bool_), none, np.nan
    begin_ambiguities(x, p, rows, pairs, arcs, arc_of_pair)
    scale = code_scale(misclosure_m, rows, pairs, tuning)
    code_variance, phase_variance, added = variances(rows, pairs, arcs, arc_of_pair, dt_s, scale, tuning)
    h, v, r, kind = observation_equations(x, rows, pairs, arc_of_pair, code_variance, phase_variance)
    most = max(2, kind.size // 6)
    used, white, scale_now, agrees = update(x, p, h, v, r, kind, usual_scale, most)
    if agrees:
        book_keep(kind, used, arcs, arc_of_pair, added)
    return UPDATED if agrees else DISAGREES, h, v, r, kind, used, white, scale_now


@njit(cache=True)
def dilution(rows: Records, system: NDArray[np.int8]) -> float:
    """PDOP of satellites (n,) with one clock for each of their systems (n,); NaN where they do not suffice."""
    columns = np.full(_N_CLOCKS, -1, np.int64)
    unknowns = _POSITION_AXES
    for number in system:
        if columns[number] < 0:
            columns[number] = unknowns
            unknowns += 1
    normal = np.zeros((unknowns, unknowns))
    for i in range(rows.size):
        clock = columns[system[i]]
        normal[clock, clock] += 1.0
        for a in range(_POSITION_AXES):
            normal[a, clock] += rows[i].line[a]
            normal[clock, a] += rows[i].line[a]
            for b in range(_POSITION_AXES):
                normal[a, b] += rows[i].line[a] * rows[i].line[b]
    factor, positive = cholesky_lower(normal)
    if not positive:
        return np.nan
    inverse = lower_inverse(factor)
    return float(np.sqrt(np.sum(inverse[:, :_POSITION_AXES] ** 2)))
