"""The quality of an epoch against a base, as a record: rows are single differences, named by satellite and signal.

The model is the epoch's last one: the position and the ambiguities that are not known (none, where all integers are
held) with their covariance after the update, clocks of the groups eliminated. Unlike a filter's report, a residual here
is what is left after the adjustment, so that ``w = residual / (sigma √redundancy)`` of an observation that was used; of
one that was left out it is the difference from what the others predict. A minimal detectable bias is that of the epoch
by itself; errors that come within seconds are found at a fraction of it, by the changes.
"""

from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plumbline.config import StationSettings
from plumbline.estimation.dia_tables import global_critical, noncentrality, w_critical
from plumbline.estimation.dia_window import equivalent
from plumbline.positioning.control import TAIL
from plumbline.positioning.ppp_noise import levels_of
from plumbline.positioning.rtk_filter import invert
from plumbline.positioning.rtk_fix import references_of, sines_of_arcs
from plumbline.positioning.rtk_observations import satellites_in
from plumbline.positioning.rtk_solution import RtkDiagnostics
from plumbline.positioning.rtk_state import N_CORE, POSITION, RtkState
from plumbline.positioning.solutions import rotation_at
from plumbline.quality.reliability import Integrity, factors, geometry, measures
from plumbline.records import Booleans, Floats, Ints, QualityReport, SignalIds, Solution
from plumbline.signals import satellite_name

_LEAST_REDUNDANCY: Final = 1e-6
_NO_DESIGN: Final = 1e-9


class _Model(NamedTuple):
    """An epoch's observations, a code and a phase of each row as far as there are any, (m,) each."""

    row: Ints
    is_phase: Booleans
    used: Booleans
    counts: Booleans  # moves the position: not alone with its clock
    variance_m2: Floats
    design: Floats  # (m, n) of the free states, the groups' clocks eliminated
    residual_m: Floats
    sigma_error_m: Floats
    w: Floats
    verdict: NDArray[np.int8]
    signals: SignalIds  # (m, 2) the rover's, and the base's where that is another
    elevation_rad: Floats
    azimuth_rad: Floats


def relative_report(
    solution: Solution, state: RtkState, seen: RtkDiagnostics, settings: StationSettings
) -> QualityReport | None:
    """The report of an epoch; ``state`` is the filter's after it. None where its states are not determined."""
    levels, integrity = levels_of(settings.positioning), Integrity(risk=settings.positioning.integrity_risk)
    rows, arcs, judged, rotation = seen.rows, seen.arcs, seen.judged, rotation_at(state.position_ecef_m)
    references = references_of(rows, arcs, sines_of_arcs(rows, arcs.size), True)
    x, column, covariance, regular = _free_states(state.information, state.right, arcs, references)
    if not regular:
        return None
    shift_m = state.origin_ecef_m + x[POSITION] - seen.approximate_ecef_m
    model = _model(rows, arcs, x, column, covariance, shift_m, rotation, *judged.columns)
    made = measures(
        model.sigma_error_m, model.variance_m2, model.used & model.counts, model.design, model.variance_m2,
        np.ascontiguousarray(covariance[POSITION]), rotation, factors(levels, integrity, TAIL),
    )  # fmt: skip
    first, place = satellites_in(rows, False, False)
    used = np.zeros(first.size, np.bool_)
    used[place[judged.use_phase | judged.use_code]] = True
    sky = geometry(np.ascontiguousarray(rows["line"][first]), rows["system"][first].astype(np.int64), used, rotation)
    return QualityReport(
        station=solution.station,
        t_gps_ns=solution.t_gps_ns,
        t_receive_ns=solution.t_receive_ns,
        tests=_tests(state, seen, settings) | _network_tests(solution),
        satellite=rows["satellite"][model.row],
        is_phase=model.is_phase,
        signals=model.signals,
        residual_m=model.residual_m,
        sigma_m=np.sqrt(model.variance_m2),
        redundancy=made.redundancy,
        mdb_m=made.mdb,
        w=model.w,
        external_enu_m=made.external,
        qdop=sky.qdop[place[model.row]],
        elevation_rad=model.elevation_rad,
        azimuth_rad=model.azimuth_rad,
        verdict=model.verdict,
        hdop=sky.hdop,
        vdop=sky.vdop,
        pdop=sky.pdop,
        protection_horizontal_m=made.protection_horizontal,
        protection_vertical_m=made.protection_vertical,
        integrity_risk=integrity.risk,
        events=_events(seen),
    )


@njit(cache=True)
def _free_states(information, right, arcs, references):  # type: ignore[no-untyped-def]
    """All states' values (k,), each one's column among those that are neither known integers nor references (−1: none),
    the free ones' covariance (n, n), and whether they are determined.
    """
    n = right.size
    x, column, made = np.zeros(n), np.full(n, -1), 0
    for i in range(n):
        held = i >= N_CORE and arcs[i - N_CORE].held
        if held:
            x[i] = arcs[i - N_CORE].value
        elif i < N_CORE or not references[i - N_CORE]:
            column[i] = made
            made += 1
    normal, side = np.zeros((made, made)), np.zeros(made)
    for i in range(n):
        if column[i] < 0:
            continue
        side[column[i]] = right[i]
        for k in range(n):
            if column[k] >= 0:
                normal[column[i], column[k]] = information[i, k]
            else:
                side[column[i]] -= information[i, k] * x[k]
    covariance, regular = invert(normal)
    if regular:
        values = covariance @ side
        for i in range(n):
            if column[i] >= 0:
                x[i] = values[column[i]]
    return x, column, covariance, regular


@njit(cache=True)
def _model(rows, arcs, x, column, covariance, shift_m, rotation, use, verdicts, tests):  # type: ignore[no-untyped-def]
    """The epoch's observations in the model of the states given."""
    row, phase = np.empty(2 * rows.size, np.int64), np.empty(2 * rows.size, np.bool_)
    m, n = 0, covariance.shape[0]
    for i in range(rows.size):
        for kind in range(2):
            if (rows[i].arc >= 0) if kind == 1 else (rows[i].code_weight > 0.0):
                row[m], phase[m] = i, kind == 1
                m += 1
    clocks = 2 * (np.max(rows["group"]) + 1)
    weight, residual, clock, used = np.empty(m), np.empty(m), np.empty(m, np.int64), np.empty(m, np.bool_)
    verdict, tested, signals = np.empty(m, np.int8), np.empty(m), np.full((m, 2), -1, np.int16)
    elevation, azimuth = np.empty(m), np.empty(m)
    design, mean, level, total = np.zeros((m, n)), np.zeros((clocks, n)), np.zeros(clocks), np.zeros(clocks)
    for i in range(m):
        one, kind = rows[row[i]], 1 if phase[i] else 0
        used[i], verdict[i], tested[i] = use[kind, row[i]], verdicts[kind, row[i]], tests[kind, row[i]]
        signals[i, 0] = one.signal
        if one.base_signal != one.signal:
            signals[i, 1] = one.base_signal
        along, east, north = 0.0, 0.0, 0.0
        for k in range(3):
            design[i, k] = -one.line[k]
            along += one.line[k] * shift_m[k]
            east += rotation[0, k] * one.line[k]
            north += rotation[1, k] * one.line[k]
        elevation[i], azimuth[i] = np.arcsin(min(1.0, max(-1.0, one.sine))), np.arctan2(east, north) % (2.0 * np.pi)
        clock[i], weight[i], residual[i] = 2 * one.group + kind, one.code_weight, one.code_oc_m + along
        if kind == 1:
            at, weight[i] = N_CORE + one.arc, one.phase_weight
            residual[i] = one.phase_oc_m + along - one.wavelength_m * (arcs[one.arc].offset_cycles + x[at])
            if column[at] >= 0:
                design[i, column[at]] = one.wavelength_m
        if used[i]:
            total[clock[i]] += weight[i]
            level[clock[i]] += weight[i] * residual[i]
            mean[clock[i]] += weight[i] * design[i]
    sigma, w, counts = _without_clocks(design, residual, covariance, weight, used, clock, mean, level, total)
    for i in range(m):
        w[i] = tested[i] if tested[i] != 0.0 else w[i]
    return _Model(
        row[:m].copy(), phase[:m].copy(), used, counts, 1.0 / weight, design, residual, sigma, w, verdict, signals,
        elevation, azimuth,
    )  # fmt: skip


@njit(cache=True)
def _without_clocks(design, residual, covariance, weight, used, clock, mean, level, total):  # type: ignore[no-untyped-def]
    """Take the clocks out of design and residuals, in place; sigmas of the errors' estimates, w, and what counts."""
    m, n = design.shape
    sigma, w, counts = np.full(m, np.inf), np.zeros(m), np.zeros(m, np.bool_)
    for i in range(m):
        sum_of_weights = total[clock[i]]
        if sum_of_weights == 0.0:
            residual[i] = 0.0
            continue
        residual[i] -= level[clock[i]] / sum_of_weights
        spread = 1.0 / sum_of_weights
        for k in range(n):
            design[i, k] -= mean[clock[i], k] / sum_of_weights
            counts[i] = counts[i] or abs(design[i, k]) > _NO_DESIGN
        for k in range(n):
            if design[i, k] != 0.0:
                for j in range(n):
                    spread += design[i, k] * covariance[k, j] * design[i, j]
        redundancy = 1.0 - weight[i] * spread if used[i] else 1.0 / (1.0 + weight[i] * spread)
        if redundancy > _LEAST_REDUNDANCY:
            sigma[i] = 1.0 / np.sqrt(weight[i] * redundancy)
            w[i] = residual[i] * weight[i] * sigma[i] if used[i] else residual[i] / sigma[i]
    return sigma, w, counts


def _tests(state: RtkState, seen: RtkDiagnostics, settings: StationSettings) -> dict[str, float]:
    levels, judged = levels_of(settings.positioning), seen.judged
    factor, after, left_out = state.variance_factor, judged.degrees_of_freedom, judged.left_out
    window, window_freedom = equivalent(state.window)
    strength = np.sort(seen.rows["cn0_db_hz"])  # NaN is sorted last
    known = int(np.count_nonzero(np.isfinite(strength)))
    return {
        "statistic": (judged.squares + judged.squares_left_out) / factor,
        "degrees_of_freedom": after + left_out,
        "critical_value": global_critical(levels, round(after + left_out)),
        "statistic_after": judged.squares / factor,
        "degrees_of_freedom_after": after,
        "critical_value_after": global_critical(levels, round(after)),
        "window_statistic": window,
        "window_degrees_of_freedom": window_freedom,
        "window_critical_value": global_critical(levels, round(window_freedom)),
        "variance_factor": judged.squares / after if after > 0.0 else float("nan"),
        "usual_variance_factor": factor,
        "significance": levels.significance,
        "power": levels.power,
        "w_significance": levels.w_significance,
        "w_critical": w_critical(levels) * TAIL,
        "noncentrality": noncentrality(levels),
        "reinstated": float(judged.taken_back),
        "cn0_db_hz": float(strength[known // 2]) if known else float("nan"),
        "ratio": seen.ratio,
        "success_rate": seen.success_rate,
    }


def _network_tests(solution: Solution) -> dict[str, float]:
    """Of the adjustment of several bases, where there was one."""
    return {name: value for name, value in solution.extras.items() if name.startswith("network_")}


def _events(seen: RtkDiagnostics) -> tuple[str, ...]:
    judged = seen.judged
    why = "its phase stayed off by the same amount"
    events = [f"cycle slip of {satellite_name(int(s))}: {why}" for s in sorted(set(judged.slipped.tolist()))]
    if judged.motion_m is not None:
        moved_mm = np.linalg.norm(judged.motion_m) * 1e3
        events.append(f"the antenna moved by {moved_mm:.0f} mm: the position was let go")
    if judged.contradiction:
        events.append("the phases' changes contradict each other: all ambiguities begin anew")
    if seen.let_go:
        events.append("the integers held were contradicted and let go")
    return tuple(events)
