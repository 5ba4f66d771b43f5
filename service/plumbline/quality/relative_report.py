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

from plumbline.config import StationSettings
from plumbline.estimation.dia_tables import global_critical, noncentrality, w_critical
from plumbline.estimation.dia_window import equivalent
from plumbline.positioning.control import TAIL
from plumbline.positioning.ppp_noise import levels_of
from plumbline.positioning.rtk_filter import invert
from plumbline.positioning.rtk_fix import references_of, sines_of_arcs
from plumbline.positioning.rtk_solution import RtkDiagnostics
from plumbline.positioning.rtk_state import N_CORE, POSITION, RtkState
from plumbline.positioning.solutions import rotation_at
from plumbline.positioning.state import Records
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


def relative_report(
    solution: Solution, state: RtkState, seen: RtkDiagnostics, settings: StationSettings
) -> QualityReport | None:
    """The report of an epoch; ``state`` is the filter's after it. None where its states are not determined."""
    levels, integrity = levels_of(settings.positioning), Integrity(risk=settings.positioning.integrity_risk)
    free, x, covariance, regular = _free_states(state, seen)
    if not regular:
        return None
    model, rows, judged = _model(state, seen, free, x, covariance), seen.rows, seen.judged
    rotation, row = rotation_at(state.position_ecef_m), model.row
    made = measures(
        model.sigma_error_m, model.variance_m2, model.used & model.counts, model.design, model.variance_m2,
        np.ascontiguousarray(covariance[POSITION]), rotation, factors(levels, integrity, TAIL),
    )  # fmt: skip
    satellite, first, place = np.unique(rows["satellite"], return_index=True, return_inverse=True)
    used_rows = np.isin(satellite, rows["satellite"][seen.use_phase | seen.use_code])
    sky = geometry(
        np.ascontiguousarray(rows["line"][first]), rows["system"][first].astype(np.int64), used_rows, rotation
    )  # fmt: skip
    enu = rows["line"] @ rotation.T
    return QualityReport(
        station=solution.station,
        t_gps_ns=solution.t_gps_ns,
        t_receive_ns=solution.t_receive_ns,
        tests=_tests(state, seen, settings) | _network_tests(solution),
        satellite=rows["satellite"][row],
        is_phase=model.is_phase,
        signals=_signals(rows, row),
        residual_m=model.residual_m,
        sigma_m=np.sqrt(model.variance_m2),
        redundancy=made.redundancy,
        mdb_m=made.mdb,
        w=model.w,
        external_enu_m=made.external,
        qdop=sky.qdop[place][row],
        elevation_rad=np.arcsin(np.clip(rows["sine"], -1.0, 1.0))[row],
        azimuth_rad=(np.arctan2(enu[:, 0], enu[:, 1]) % (2.0 * np.pi))[row],
        verdict=np.where(model.is_phase, judged.phase[row], judged.code[row]).astype(np.int8),
        hdop=sky.hdop,
        vdop=sky.vdop,
        pdop=sky.pdop,
        protection_horizontal_m=made.protection_horizontal,
        protection_vertical_m=made.protection_vertical,
        integrity_risk=integrity.risk,
        events=_events(seen),
    )


def _free_states(state: RtkState, seen: RtkDiagnostics) -> tuple[Ints, Floats, Floats, bool]:
    """States that are not known integers or references: numbers (n,), all states' values, covariance (n, n)."""
    arcs, sine = seen.arcs, sines_of_arcs(seen.rows, seen.arcs.size)
    known = np.concatenate([np.zeros(N_CORE, np.bool_), arcs["held"] | references_of(seen.rows, arcs, sine, True)])
    x = np.concatenate([np.zeros(N_CORE), np.where(arcs["held"], arcs["value"], 0)]).astype(np.float64)
    free = np.flatnonzero(~known)
    covariance, regular = invert(np.ascontiguousarray(state.information[np.ix_(free, free)]))
    if regular:
        x[free] = covariance @ (state.right[free] - state.information[np.ix_(free, np.flatnonzero(known))] @ x[known])
    return free, x, covariance, bool(regular)


def _model(state: RtkState, seen: RtkDiagnostics, free: Ints, x: Floats, covariance: Floats) -> _Model:
    rows, judged = seen.rows, seen.judged
    there = np.column_stack([rows["code_weight"] > 0.0, rows["arc"] >= 0]).ravel()
    row, is_phase = np.divmod(np.flatnonzero(there), 2)
    is_phase = is_phase == 1
    used = np.where(is_phase, seen.use_phase[row], seen.use_code[row])
    column = np.full(x.size, -1)
    column[free] = np.arange(free.size)
    shift_m = state.origin_ecef_m + x[POSITION] - seen.approximate_ecef_m
    weight, design, residual, sigma = _adjusted(
        rows, seen.arcs["offset_cycles"] + x[N_CORE:], row, is_phase, used, column[N_CORE:], shift_m, covariance
    )  # fmt: skip
    with np.errstate(invalid="ignore"):
        w = np.where(used, residual * weight * sigma, residual / sigma)
    tested = np.where(is_phase, judged.w_phase[row], judged.w_code[row])
    w = np.where(tested != 0.0, tested, np.where(np.isfinite(sigma), w, 0.0))
    counts = np.abs(design).max(axis=1) > _NO_DESIGN
    return _Model(row, is_phase, used, counts, 1.0 / weight, design, residual, sigma, w)


@njit(cache=True)
def _adjusted(rows, cycles, row, is_phase, used, column, shift_m, covariance):  # type: ignore[no-untyped-def]
    """Weights (m,), reduced design (m, n), residuals (m,) and sigmas of the observations' estimated errors (m,)."""
    m, n = row.size, covariance.shape[0]
    clocks = 2 * (np.max(rows["group"]) + 1)
    weight, residual, clock = np.empty(m), np.empty(m), np.empty(m, np.int64)
    design, mean, level, total = np.zeros((m, n)), np.zeros((clocks, n)), np.zeros(clocks), np.zeros(clocks)
    for i in range(m):
        one = rows[row[i]]
        along = one.line[0] * shift_m[0] + one.line[1] * shift_m[1] + one.line[2] * shift_m[2]
        for k in range(3):
            design[i, k] = -one.line[k]
        clock[i], weight[i], residual[i] = 2 * one.group, one.code_weight, one.code_oc_m + along
        if is_phase[i]:
            clock[i], weight[i] = clock[i] + 1, one.phase_weight
            residual[i] = one.phase_oc_m + along - one.wavelength_m * cycles[one.arc]
            if column[one.arc] >= 0:
                design[i, column[one.arc]] = one.wavelength_m
        if used[i]:
            total[clock[i]] += weight[i]
            level[clock[i]] += weight[i] * residual[i]
            mean[clock[i]] += weight[i] * design[i]
    sigma = np.full(m, np.inf)
    for i in range(m):
        sum_of_weights = total[clock[i]]
        if sum_of_weights == 0.0:
            residual[i] = 0.0
            continue
        residual[i] -= level[clock[i]] / sum_of_weights
        design[i] -= mean[clock[i]] / sum_of_weights
        spread = 1.0 / sum_of_weights + np.sum(design[i] * (covariance @ design[i]))
        redundancy = 1.0 - weight[i] * spread if used[i] else 1.0 / (1.0 + weight[i] * spread)
        if redundancy > _LEAST_REDUNDANCY:
            sigma[i] = 1.0 / np.sqrt(weight[i] * redundancy)
    return weight, design, residual, sigma


def _signals(rows: Records, row: Ints) -> SignalIds:
    """Signal ids (m, 2): the rover's, and the base's where that is another."""
    other = np.where(rows["base_signal"] != rows["signal"], rows["base_signal"], -1)
    signals: SignalIds = np.column_stack([rows["signal"], other])[row].astype(np.int16)
    return signals


def _tests(state: RtkState, seen: RtkDiagnostics, settings: StationSettings) -> dict[str, float]:
    levels, judged = levels_of(settings.positioning), seen.judged
    factor, after, left_out = state.variance_factor, judged.degrees_of_freedom, judged.left_out
    window, window_freedom = equivalent(state.window)
    strength = seen.rows["cn0_db_hz"][np.isfinite(seen.rows["cn0_db_hz"])]
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
        "cn0_db_hz": float(np.median(strength)) if strength.size else float("nan"),
        "ratio": seen.ratio,
        "success_rate": seen.success_rate,
    }


def _network_tests(solution: Solution) -> dict[str, float]:
    """Of the adjustment of several bases, where there was one."""
    return {name: value for name, value in solution.extras.items() if name.startswith("network_")}


def _events(seen: RtkDiagnostics) -> tuple[str, ...]:
    judged = seen.judged
    why = "its phase stayed off by the same amount"
    events = [f"cycle slip of {satellite_name(int(s))}: {why}" for s in np.unique(judged.slipped)]
    if judged.motion_m is not None:
        moved_mm = np.linalg.norm(judged.motion_m) * 1e3
        events.append(f"the antenna moved by {moved_mm:.0f} mm: the position was let go")
    if judged.contradiction:
        events.append("the phases' changes contradict each other: all ambiguities begin anew")
    if seen.let_go:
        events.append("the integers held were contradicted and let go")
    return tuple(events)
