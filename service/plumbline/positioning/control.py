"""An epoch's observations against each other: detection, identification, adaptation for the position filter.

The alternatives are an error of each code and each phase and, for an antenna that is thought to stand, a jump of the
position (:mod:`plumbline.estimation.dia`). An error of a phase may be an outlier or a slip: nothing tells them apart in
one epoch. Left out, a phase that is off by the same amount in the next epoch too has slipped, and its ambiguity begins
anew; one that is not was an outlier, and its ambiguity is still good.

Codes enter the filter with the variance of what they add to an arc's mean (:mod:`plumbline.positioning.ppp_noise`),
which says nothing of how far a code may stray. For the tests a code is compared with the mean of its own innovations
and has the variance of its noise. What passes is tested once more where phases are there: the phases carry both
frequencies' codes from epoch to epoch, so that an error of one code, or of both, shows against noise of decimetres.
"""

from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.estimation import dia
from plumbline.estimation.kalman import innovation_covariance
from plumbline.positioning.ppp_noise import Tuning, bias_sigma_m, noise_factor
from plumbline.positioning.state import POSITION, Records
from plumbline.records import Booleans, Floats, Ints, Verdict

_AXES: Final = POSITION.stop
_ACCEPTED, _OUTLIER, _SLIP = int(Verdict.ACCEPTED), int(Verdict.OUTLIER), int(Verdict.SLIP)
_UNDECIDED, _INSEPARABLE, _EPOCH = int(Verdict.UNDECIDED), int(Verdict.INSEPARABLE), int(Verdict.EPOCH)
_NORMAL_MEDIAN: Final = 0.6745  # of a standard normal's absolute value
_NORMAL_MEDIAN_OF_THREE: Final = 1.03  # of the largest of |x|, |y| and |x + y|/√2
_SQUARE_OF_THREE: Final = 1.6  # mean of the square of the largest of |x|, |y| and |x + y|/√2
_LARGEST_SQUARE: Final = 12.0
_SCALE_GAIN: Final = 0.04  # of one code's usual size: a memory of 25 epochs
_SCALE_PRIOR: Final = 5.0  # … what all codes' is counts for as many epochs
TAIL: Final = 1.55  # real errors have longer tails than normal ones: critical values of w are higher by this
_RESTLESS: Final = 3.0  # where an epoch does not agree, once more with statistics allowed to be this much larger
_LEAST_SCALE: Final = 0.2
_MOST_SCALE: Final = 4.0
_DOUBT: Final = 0.5  # share of its limit from which an observation is believed less
_CODE_FLOOR_M: Final = 0.2  # multipath of one code that changes from epoch to epoch, whatever the elevation
_INSEPARABLE_CORRELATION: Final = 0.98
_MEAN_MEMORY: Final = 200  # epochs of a code's means
_CODES_STAY: Final = 4  # epochs in a row that a code may be refused before its new level is believed
_LEVEL_LASTS_NS: Final = 600_000_000_000  # an older mean of a code's innovations says nothing of the next
_ALIKE_SIGMAS: Final = 5.0  # two misfits of a phase that differ by less are one slip
_LONGEST_CHANGE_S: Final = 5.0
_IONOSPHERE_MEAN_M_S: Final = 0.0015  # unforeseen rate of the mean of both phases at the zenith
_LOWEST_SINE: Final = 0.1
_REFUSED_LIMIT: Final = 3  # epochs in a row after which a refused phase begins a new ambiguity


class Scene(NamedTuple):
    """An epoch's observations and what belongs to them; ``kind`` (m,) is 2·pair for a code, 2·pair + 1 for a phase."""

    kind: Ints
    rows: Records  # (n,) model of the pairs
    pairs: Records  # (n,)
    arcs: Records
    arc_of_pair: Ints  # (n,)
    levels: Records  # (satellites,) means of the codes' innovations, by satellite id
    t_gps_ns: int


class Usual(NamedTuple):
    """What is expected of an epoch: how large the statistics of codes and phases usually are, whether it may move."""

    code_scale: float
    phase_scale: float
    may_move: bool  # a jump of the position is an alternative: the antenna is thought to stand


class Control(NamedTuple):
    """What became of an epoch's observations, (m,) rows as given."""

    verdict: NDArray[np.int8]
    w: Floats  # given the errors found
    error_m: Floats  # estimate of each observation's error, given those found
    sigma_error_m: Floats  # … and its one sigma
    misclosure_m: Floats  # as tested: codes less their means
    variance_m2: Floats  # of the observations, as tested
    factor: Floats  # on the variances for the update: what is nearly an outlier is believed less
    statistic: float  # Σ of both kinds' vᵀ S⁻¹ v over their usual size, χ² of m
    statistic_after: float  # of what was accepted
    phase_scale: float  # how large the accepted phases' statistics are in this epoch; NaN without any
    code_scale: float
    moved_m: Floats  # (3,) jump of the position, where that explains the epoch; else NaN
    taken_back: int  # observations that were left out and re-instated
    agrees: bool


@njit(cache=True)
def nothing_found(m: int) -> Control:
    """Of observations that contradict each other altogether, (m,)."""
    none = np.zeros(m)
    return Control(
        np.full(m, _EPOCH, np.int8), none, none, none, none, none, np.ones(m), 0.0, 0.0, np.nan, np.nan,
        np.full(_AXES, np.nan), 0, False,
    )  # fmt: skip


@njit(cache=True)
def _scale(w: Floats, verdict: NDArray[np.int8], kind: Ints, of: int) -> float:
    """How large the accepted w-statistics of codes (0) or phases (1) are against a standard normal's; NaN without."""
    sizes = np.abs(w[(kind % 2 == of) & (verdict == _ACCEPTED)])
    return float(np.median(sizes) / _NORMAL_MEDIAN) if sizes.size > 0 else np.nan


@njit(cache=True)
def _bounded(scale: float) -> float:
    return min(max(scale, _LEAST_SCALE), _MOST_SCALE)


@njit(cache=True)
def _code_sigma_m(pair, sine: float, level, code_scale: float, tuning: Tuning) -> float:  # type: ignore[no-untyped-def]
    """One sigma of the noise of one code at an elevation and C/N₀: as all codes' is usually or, if larger, its own."""
    combination = np.sqrt(pair.alpha**2 + (pair.alpha - 1.0) ** 2)
    white = noise_factor(pair, sine, tuning) / combination * tuning.code_sigma_m * np.sqrt(1.0 + pair.thermal)
    return float(max(code_scale, level.scale) * np.sqrt(white**2 + _CODE_FLOOR_M**2))


@njit(cache=True)
def _test_quantities(v: Floats, r: Floats, scene: Scene, code_scale: float, tuning: Tuning) -> tuple[Floats, Floats]:
    """Misclosures and variances for the tests: codes less the mean of their innovations, with their noise alone."""
    misclosure, variance = v.copy(), r.copy()
    for i in range(scene.kind.size):
        if scene.kind[i] % 2 == 1:
            continue
        pair, row = scene.pairs[scene.kind[i] // 2], scene.rows[scene.kind[i] // 2]
        combination = pair.alpha**2 + (pair.alpha - 1.0) ** 2
        level = scene.levels[pair.satellite]
        white = combination * _code_sigma_m(pair, row.sine, level, code_scale, tuning) ** 2
        if level.count > 0 and scene.t_gps_ns - level.t_last_ns <= _LEVEL_LASTS_NS:
            misclosure[i] -= level.offset_m
            variance[i] = white * (1.0 + 1.0 / level.count)
        else:
            variance[i] = white + bias_sigma_m(pair, tuning) ** 2
    return misclosure, variance


@njit(cache=True)
def _statistic(table: Floats, misclosure: Floats, kind: Ints, out: Booleans, phase_scale: float) -> float:
    """Σ over codes and phases not left out of ``vᵀ S⁻¹ v``, the phases' over the square of their usual size."""
    total, last = 0.0, table.shape[0] - 1
    for i in range(kind.size):
        if not out[i]:
            total += misclosure[i] * table[i, last] / (phase_scale**2 if kind[i] % 2 == 1 else 1.0)
    return max(total, 0.0)


@njit(cache=True)
def _limits(kind: Ints, phase_scale: float, may_move: bool, tuning: Tuning) -> Floats:
    """Critical χ² value of each alternative: the tables', times its kind's usual size."""
    n = kind.size
    limits = np.empty(n + (1 if may_move else 0))
    for i in range(n):
        limits[i] = tuning.critical * (TAIL * (phase_scale if kind[i] % 2 == 1 else 1.0)) ** 2
    if may_move:
        limits[n] = tuning.critical_move * (TAIL * phase_scale) ** 2
    return limits


@njit(cache=True)
def doubt(ratio: float) -> float:
    """Factor on the variance of an observation whose w-statistic is ``ratio`` of its limit: 1 up to one half.

    Beyond, its weight falls so that its influence, ``ratio`` times the weight, goes down to none at the limit as
    steeply as it rose (a two-part redescending influence: Hampel et al. 1986, *Robust statistics*, 2.6). Whether an
    observation lies just below its limit or just above then makes no jump in the position, and nowhere does an
    observation's noise move the position by more than at full weight.
    """
    if ratio <= _DOUBT:
        return 1.0
    return ratio / max(_DOUBT / (1.0 - _DOUBT) * (1.0 - ratio), 1e-6)


@njit(cache=True)
def code_deviations(pair, arc, phase_error_m: float) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    """How far both codes are from their arc's means as the phases carry them, m.

    From the ionosphere-free code less phase and from Melbourne-Wübbena, two combinations of both codes. What the phases
    are off by, ``phase_error_m`` ionosphere-free and the geometry-free jump of a doubted phase, is taken out.
    """
    f1, f2 = pair.frequency_1_hz, pair.frequency_2_hz
    beta = pair.alpha - 1.0
    jump = pair.geometry_free_m - arc.geometry_free_m if arc.doubted > 0 else 0.0
    first = phase_error_m - beta * jump
    wide = (f1 * first - f2 * (first - jump)) / (f1 - f2)
    ionosphere_free = arc.phase_minus_code_mean_m - (pair.phase_m - pair.code_m) + phase_error_m
    turns = arc.wide_lane_mean_cycles - pair.wide_lane_cycles
    narrow_lane = turns * SPEED_OF_LIGHT_M_S / (f1 - f2) + wide
    n1, n2 = f1 / (f1 + f2), f2 / (f1 + f2)
    scale = pair.alpha * n2 + beta * n1
    code_1 = (n2 * ionosphere_free + beta * narrow_lane) / scale
    code_2 = (pair.alpha * narrow_lane - n1 * ionosphere_free) / scale
    return code_1, code_2


@njit(cache=True)
def _code_w(pair, arc, level, sine, phase_error_m, code_scale, tuning):  # type: ignore[no-untyped-def]
    """Largest w-statistic of the first code, the second and both alike, against their arc's means; 0 without these."""
    if arc.code_count == 0 or pair.frequency_2_hz == 0.0:
        return 0.0
    first, second = code_deviations(pair, arc, phase_error_m)
    sigma = _code_sigma_m(pair, sine, level, code_scale, tuning) * np.sqrt(1.0 + 1.0 / arc.code_count)
    best = first / sigma
    for w in (second / sigma, (first + second) / (sigma * np.sqrt(2.0))):
        if abs(w) > abs(best):
            best = w
    return best


@njit(cache=True)
def _check_codes(w, out, error, scene, limit, code_scale, tuning):  # type: ignore[no-untyped-def]
    """Test codes against their arcs' means, in place: ``w`` becomes the larger of both tests', ``out`` grows.

    Returns how large the statistics are against a standard normal's; NaN without any.
    """
    n, sizes = 0, np.zeros(scene.kind.size)
    for i in range(scene.kind.size):
        number = scene.kind[i] // 2
        arc = scene.arc_of_pair[number]
        if scene.kind[i] % 2 == 1 or arc < 0:
            continue
        has_error = i + 1 < out.size and scene.kind[i + 1] == scene.kind[i] + 1 and out[i + 1]
        phase_error = error[i + 1] if has_error else 0.0
        level = scene.levels[scene.pairs[number].satellite]
        value = _code_w(
            scene.pairs[number], scene.arcs[arc], level, scene.rows[number].sine, phase_error, code_scale, tuning
        )  # fmt: skip
        if abs(value) > abs(w[i]):
            w[i] = value
        if abs(value) > limit:
            out[i] = True
        elif value != 0.0:
            sizes[n] = abs(value) * max(code_scale, level.scale) / code_scale
            n += 1
    return np.median(sizes[:n]) / _NORMAL_MEDIAN_OF_THREE if n > 0 else np.nan


@njit(cache=True)
def _forced(scene: Scene, n: int) -> Booleans:
    """Phases that have been doubted before the filter saw them, (n,)."""
    forced = np.zeros(n, np.bool_)
    for i in range(scene.kind.size):
        arc = scene.arc_of_pair[scene.kind[i] // 2]
        forced[i] = scene.kind[i] % 2 == 1 and arc >= 0 and scene.arcs[arc].doubted > 0
    return forced


@njit(cache=True)
def _changes(h, v, scene, tuning):  # type: ignore[no-untyped-def]
    """How phases have changed since their last accepted ones, the mean of both frequencies': rows, design of position
    and clock, changes and sigmas. None where that was longer than some seconds ago: the ionosphere is not modelled.
    """
    m = scene.kind.size
    rows, design, change, sigma = np.empty(m, np.int64), np.ones((m, _AXES + 1)), np.empty(m), np.empty(m)
    n = 0
    for i in range(m):
        number = scene.kind[i] // 2
        if scene.kind[i] % 2 == 0:
            continue
        arc, pair = scene.arcs[scene.arc_of_pair[number]], scene.pairs[number]
        dt_s = (scene.t_gps_ns - arc.t_residual_ns) * 1e-9
        if arc.t_residual_ns == 0 or dt_s > _LONGEST_CHANGE_S or arc.doubted > 0:
            continue
        to_mean = pair.alpha - 0.5
        rate = 0.0 if np.isnan(arc.geometry_free_rate_m_s) else arc.geometry_free_rate_m_s
        jump = pair.geometry_free_m - arc.residual_geometry_free_m
        rows[n] = i
        design[n, :_AXES] = h[i, :_AXES]
        change[n] = v[i] - arc.residual_m - to_mean * (jump - rate * dt_s)
        noise = tuning.phase_sigma_m + _IONOSPHERE_MEAN_M_S * dt_s
        sigma[n] = noise / max(scene.rows[number].sine, _LOWEST_SINE)
        n += 1
    return rows[:n], design[:n], change[:n], sigma[:n]


@njit(cache=True)
def change_of_phases(h: Floats, v: Floats, scene: Scene, forced: Booleans, tuning: Tuning) -> None:
    """Doubt phases, in place, whose change within seconds does not fit the motion and clock that the others agree on.

    At 1 Hz one cycle on both frequencies, which moves the ionosphere-free phase by 11 cm and its noise by three times
    that of a single one, stands out of the mean of both by 20 cm.
    """
    if tuning.critical == np.inf:
        return
    rows, design, change, sigma = _changes(h, v, scene, tuning)
    if rows.size < _AXES + 3:
        return
    middle = np.median(change)
    table, solvable = dia.residual_information(design, change - middle, sigma)
    if not solvable:
        return
    n = rows.size
    limits = np.full(n, tuning.critical * TAIL**2)
    found = dia.identify(table, np.arange(n + 1), np.ones(n, np.bool_), limits, n // 3)
    if found.explained:
        for k in found.order:
            forced[rows[k]] = True


@njit(cache=True)
def _verdicts(scene, out, error, sigma, table):  # type: ignore[no-untyped-def]
    """Verdict of each observation: a phase off like the epoch before has slipped."""
    verdict = np.zeros(scene.kind.size, np.int8)
    for i in np.flatnonzero(out):
        arc = scene.arc_of_pair[scene.kind[i] // 2]
        verdict[i] = _OUTLIER if scene.kind[i] % 2 == 0 else _UNDECIDED
        if scene.kind[i] % 2 == 1 and scene.arcs[arc].refused > 0:
            alike = abs(error[i] - scene.arcs[arc].refused_m) < _ALIKE_SIGMAS * sigma[i]
            verdict[i] = _SLIP if alike else _UNDECIDED
    others = np.flatnonzero(~out)
    for i in np.flatnonzero(out):
        if table[i, i] > 0.0:
            for j in dia.inseparable(table, int(i), others, _INSEPARABLE_CORRELATION):
                verdict[j] = _INSEPARABLE
    return verdict


@njit(cache=True)
def _identified(table, starts, forced, scene, phase_scale, may_move, tuning):  # type: ignore[no-untyped-def]
    """Identification with the critical values of a scale; and the alternatives' columns adopted."""
    limits = _limits(scene.kind, phase_scale, may_move, tuning)
    found = dia.identify(table, starts, ~forced[: starts.size - 1], limits, max(2, scene.kind.size // 6))
    adopted = forced.copy()
    for g in found.order:
        adopted[starts[g] : starts[g + 1]] = True
    return found, adopted, limits


@njit(cache=True)
def control(
    p: Floats, h: Floats, v: Floats, r: Floats, scene: Scene, usual: Usual, tuning: Tuning
) -> Control:  # fmt: skip
    """Test an epoch's observations; nothing is changed.

    ``p`` (n, n), ``h`` (m, n), ``v`` and ``r`` (m,) as the filter would be updated.
    """
    m = scene.kind.size
    code_scale, phase_scale, may_move = _bounded(usual.code_scale), _bounded(usual.phase_scale), usual.may_move
    misclosure, variance = _test_quantities(v, r, scene, code_scale, tuning)
    extra = h[:, :_AXES].copy() if may_move else np.zeros((m, 0))
    table, positive = dia.information(innovation_covariance(p, h, variance), misclosure, extra)
    if not positive:
        return nothing_found(m)
    starts = np.append(np.arange(m + 1), m + _AXES) if may_move else np.arange(m + 1)
    forced = _forced(scene, m + extra.shape[1])
    change_of_phases(h, v, scene, forced, tuning)
    statistic = _statistic(table, misclosure, scene.kind, np.zeros(m, np.bool_), phase_scale)
    for column in np.flatnonzero(forced):
        dia.sweep(table, int(column), False)
    found, adopted, limits = _identified(table, starts, forced, scene, phase_scale, may_move, tuning)
    if not found.explained:
        restless = _RESTLESS * phase_scale
        found, adopted, limits = _identified(table, starts, forced, scene, restless, may_move, tuning)
    w, sigma = dia.w_values(found.swept, adopted)
    error = np.where(adopted, found.swept[:-1, -1], w * sigma)
    out = adopted[:m].copy()
    checked = _check_codes(w, out, error, scene, np.sqrt(tuning.critical) * TAIL, code_scale, tuning)
    verdict = _verdicts(scene, out, error, sigma, table)
    factor = np.ones(m)
    for i in range(m):
        if verdict[i] == _ACCEPTED and tuning.critical < np.inf:
            factor[i] = doubt(abs(w[i]) / np.sqrt(limits[i]))
    return Control(
        verdict, w[:m].copy(), error[:m].copy(), sigma[:m].copy(), misclosure, variance, factor, statistic,
        _statistic(found.swept, misclosure, scene.kind, verdict != _ACCEPTED, phase_scale),
        _scale(w[:m], verdict, scene.kind, 1), checked * code_scale,
        error[m:].copy() if may_move and adopted[m] else np.full(_AXES, np.nan), found.taken_back, found.explained,
    )  # fmt: skip


@njit(cache=True)
def book_keep(found: Control, v: Floats, residual: Floats, scene: Scene, added_code_weight: Floats) -> None:
    """After an update: what arcs and levels remember of codes and phases, in place; ``residual`` (m,) is after it."""
    for i in range(scene.kind.size):
        number = scene.kind[i] // 2
        accepted = found.verdict[i] == _ACCEPTED
        k = scene.arc_of_pair[number]
        if scene.kind[i] % 2 == 0:
            level = scene.levels[scene.pairs[number].satellite]
            anew = _remember_level(level, v[i], accepted, scene.t_gps_ns)
            _remember_scale(level, found.w[i], found.code_scale)
            if k >= 0:
                _remember_codes(scene.arcs[k], scene.pairs[number], accepted, anew)
                if accepted:
                    scene.arcs[k].code_weight_m2 += added_code_weight[number]
        elif accepted or scene.arcs[k].doubted > 0:
            scene.arcs[k].refused = 0
            if accepted:
                scene.arcs[k].residual_m, scene.arcs[k].t_residual_ns = residual[i], scene.t_gps_ns
                scene.arcs[k].residual_geometry_free_m = scene.pairs[number].geometry_free_m
        else:
            slip = found.verdict[i] == _SLIP
            scene.arcs[k].refused = _REFUSED_LIMIT if slip else scene.arcs[k].refused + 1
            scene.arcs[k].refused_m = found.error_m[i]


@njit(cache=True)
def _remember_level(level, innovation_m, accepted, t_gps_ns):  # type: ignore[no-untyped-def]
    """Take a code's innovation into its mean; whether the mean began anew, since the code stayed elsewhere."""
    stale = t_gps_ns - level.t_last_ns > _LEVEL_LASTS_NS
    if not accepted:
        level.refused += 1
        if level.refused < _CODES_STAY:
            return False
    anew = level.refused >= _CODES_STAY
    if stale or anew:
        level.count = 0
    level.refused, level.t_last_ns = 0, t_gps_ns
    level.count = min(level.count + 1, _MEAN_MEMORY)
    if level.count == 1:
        level.offset_m = 0.0
    level.offset_m += (innovation_m - level.offset_m) / level.count
    return anew


@njit(cache=True)
def _remember_scale(level, w, usual):  # type: ignore[no-untyped-def]
    """Take a code's w-statistic into how large its own usually are; an outlier counts as the largest that is none."""
    used = max(usual, level.scale)
    if np.isnan(used):
        return
    ratio = min(w * w / _SQUARE_OF_THREE, _LARGEST_SQUARE)
    gain = max(_SCALE_GAIN, 1.0 / (level.count + _SCALE_PRIOR))
    level.scale = min(used * np.sqrt(1.0 + gain * (ratio - 1.0)), _MOST_SCALE)


@njit(cache=True)
def _remember_codes(arc, pair, accepted, anew):  # type: ignore[no-untyped-def]
    """Take an epoch's codes into the means that the phases carry."""
    if anew:
        arc.code_count = 0
    if not (accepted or anew) or arc.doubted > 0 or arc.refused > 0:
        return
    arc.code_count = min(arc.code_count + 1, _MEAN_MEMORY)
    if arc.code_count == 1:
        arc.wide_lane_mean_cycles, arc.phase_minus_code_mean_m = 0.0, 0.0
    gain = 1.0 / arc.code_count
    arc.wide_lane_mean_cycles += gain * (pair.wide_lane_cycles - arc.wide_lane_mean_cycles)
    arc.phase_minus_code_mean_m += gain * (pair.phase_m - pair.code_m - arc.phase_minus_code_mean_m)
