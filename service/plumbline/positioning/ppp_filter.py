"""The position filter: prediction, the test of an epoch's observations, and the update.

Observation rows are ordered pair by pair, code before phase. Positions are Earth-fixed metres; all systems' clocks move
together with the receiver's (white noise, foretold by the codes) and slowly against each other.
"""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plumbline.estimation.kalman import cholesky_lower, lower_inverse, update_with_errors
from plumbline.positioning.control import Control, Scene, Usual, book_keep, control, nothing_found
from plumbline.positioning.ppp_noise import Tuning, code_scale, variances
from plumbline.positioning.state import CLOCKS, GRADIENTS, N_CORE, POSITION, ZENITH_DELAY, Records
from plumbline.records import Floats, Ints, Verdict

_CLOCK: Final = CLOCKS.start
_N_CLOCKS: Final = CLOCKS.stop - CLOCKS.start
_NORTH: Final = GRADIENTS.start
_EAST: Final = GRADIENTS.start + 1
_AMBIGUITY_SIGMA_M: Final = 60.0
_NEW_CLOCK_SIGMA_M: Final = 30.0
_POSITION_AXES: Final = POSITION.stop
_ACCEPTED: Final = int(Verdict.ACCEPTED)
_MOVE_ROOM: Final = 25.0  # variance of a position that has jumped, in squares of the jump: five times as far
_LOST_M: Final = 15.0  # codes that differ by more (median) say that the position is wrong
UPDATED: Final = 0
DISAGREES: Final = 1
LOST: Final = 2


@njit(cache=True)
def carry_over(x: Floats, p: Floats, q: Floats, previous: Ints) -> tuple[Floats, Floats, Floats]:
    """State and covariances for the new arcs: core states as they are, ambiguities from ``previous`` (−1: zero)."""
    n = N_CORE + previous.size
    source = np.empty(n, np.int64)
    for i in range(n):
        source[i] = i if i < N_CORE else (N_CORE + previous[i - N_CORE] if previous[i - N_CORE] >= 0 else -1)
    out_x, out_p, out_q = np.zeros(n), np.zeros((n, n)), np.zeros((n, n))
    for i in range(n):
        if source[i] >= 0:
            out_x[i] = x[source[i]]
            for j in range(n):
                if source[j] >= 0:
                    out_p[i, j] = p[source[i], source[j]]
                    out_q[i, j] = q[source[i], source[j]]
    return out_x, out_p, out_q


@njit(cache=True)
def predict_state(p: Floats, arcs: Records, dt_s: float, ambiguity_m_sqrt_s: float, tuning: Tuning) -> None:
    """Add the process noise of ``dt_s`` to ``p``, in place, with the ambiguities' walk given; states not in use stay at
    zero.
    """
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
            p[N_CORE + k, N_CORE + k] += ambiguity_m_sqrt_s**2 * dt_s


@njit(cache=True)
def _reduced(row, x: Floats) -> float:  # type: ignore[no-untyped-def]
    """Prediction without receiver clock, wind-up and ambiguity."""
    troposphere = row.wet * x[ZENITH_DELAY] + row.gradient_north * x[_NORTH] + row.gradient_east * x[_EAST]
    return float(row.predicted_m + troposphere)


@njit(cache=True)
def foretell_clocks(x: Floats, p: Floats, q: Floats, rows: Records, pairs: Records) -> Floats:
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
            p[k, k], q[k, k] = _NEW_CLOCK_SIGMA_M**2, _NEW_CLOCK_SIGMA_M**2
            for i in range(rows.size):
                if pairs[i].system == system:
                    misclosure[i] -= x[k]
    return misclosure


@njit(cache=True)
def begin_ambiguities(
    x: Floats, p: Floats, q: Floats, rows: Records, pairs: Records, arcs: Records, arc_of_pair: Ints
) -> None:  # fmt: skip
    """Begin the ambiguities of arcs whose state is not in use, at phase less code, in place."""
    for i in range(rows.size):
        arc = arc_of_pair[i]
        if rows[i].usable and arc >= 0 and not arcs[arc].estimated:
            k = N_CORE + arc
            x[k] = pairs[i].phase_m - rows[i].wind_up_m - _reduced(rows[i], x) - x[_CLOCK + pairs[i].system]
            for covariance in (p, q):
                covariance[k, :] = 0.0
                covariance[:, k] = 0.0
                covariance[k, k] = _AMBIGUITY_SIGMA_M**2
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
def _rows_and_columns(p: Floats, active: Ints) -> Floats:
    out = np.empty((active.size, active.size))
    for i in range(active.size):
        for j in range(active.size):
            out[i, j] = p[active[i], active[j]]
    return out


@njit(cache=True)
def _put_back(p: Floats, active: Ints, values: Floats) -> None:
    for i in range(active.size):
        for j in range(active.size):
            p[active[i], active[j]] = values[i, j]


@njit(cache=True)
def update(
    x: Floats, p: Floats, q: Floats, h: Floats, v: Floats, r: Floats, scene: Scene, usual: Usual, tuning: Tuning
) -> tuple[Control, float]:  # fmt: skip
    """Test an epoch's observations and, where they agree, update ``x``, ``p``, ``q`` in place by those that passed.

    Where a jump of the position explains them, the position is first let go by as much (adaptation: the state is
    widened). Where nothing does, nothing is changed. Second: the NIS of what passed.
    """
    active = np.flatnonzero(np.diag(p) > 0.0)  # the states in use have a variance
    x_active, h_active = x[active], np.ascontiguousarray(h[:, active])
    p_active, q_active = _rows_and_columns(p, active), _rows_and_columns(q, active)
    found, nis = control(p_active, h_active, v, r, scene, usual, tuning), 0.0
    if found.agrees:
        if not np.isnan(found.moved_m[0]):
            for k in range(_POSITION_AXES):
                p_active[k, k] += _MOVE_ROOM * np.sum(found.moved_m**2)
                q_active[k, k] += _MOVE_ROOM * np.sum(found.moved_m**2)
        accepted = found.verdict == _ACCEPTED
        nis = update_with_errors(x_active, p_active, q_active, h_active, r * found.factor, v, accepted)
        x[active] = x_active
        _put_back(p, active, p_active)
        _put_back(q, active, q_active)
    return found, nis


@njit(cache=True)
def advance(
    x: Floats, p: Floats, q: Floats, arcs: Records, levels: Records, rows: Records, pairs: Records,
    arc_of_pair: Ints, t_gps_ns: int, dt_s: float, usual: Usual, tuning: Tuning,
) -> tuple[int, Floats, Floats, Floats, Ints, Control, float]:  # fmt: skip
    """An epoch of the filter: predict over ``dt_s`` (0: the first), test, update; state, covariances, ``arcs`` and
    ``levels`` in place.

    Returns UPDATED, DISAGREES or LOST (the codes are further than ``_LOST_M`` from the prediction), the design (m, n),
    innovations and variances as used (m,), kinds (m,), what quality control found and the NIS of what it accepted.
    """
    if dt_s > 0.0:
        predict_state(p, arcs, dt_s, tuning.ambiguity_m_sqrt_s, tuning)
        predict_state(q, arcs, dt_s, tuning.ambiguity_error_m_sqrt_s, tuning)
    misclosure_m = foretell_clocks(x, p, q, rows, pairs)
    none = np.zeros(0)
    if dt_s > 0.0 and np.nanmedian(np.abs(misclosure_m)) > _LOST_M:
        return LOST, np.zeros((0, 0)), none, none, np.zeros(0, np.int64), nothing_found(0), 0.0
    begin_ambiguities(x, p, q, rows, pairs, arcs, arc_of_pair)
    scale = code_scale(misclosure_m, rows, pairs, tuning)
    code_variance, phase_variance, added = variances(rows, pairs, arcs, arc_of_pair, dt_s, scale, tuning)
    h, v, r, kind = observation_equations(x, rows, pairs, arc_of_pair, code_variance, phase_variance)
    before = x.copy()
    scene = Scene(kind, rows, pairs, arcs, arc_of_pair, levels, t_gps_ns)
    found, nis = update(x, p, q, h, v, r, scene, usual, tuning)
    if found.agrees:
        book_keep(found, v, v - h @ (x - before), scene, added)
    return UPDATED if found.agrees else DISAGREES, h, v, r * found.factor, kind, found, nis


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
