"""Wang 2023, eqs 1-8, live: GNSS displacements and inertial samples, each as it comes, to blocks of motion.

State: displacement, velocity, baseline (eq. 1); the acceleration drives (eq. 3), a solution's displacement measures
(eq. 2, with R the covariance of what is new in it at its epoch: r/t_d). The three axes meet only in the covariance of
the solution.

A solution belongs to its own time. If the samples have passed it, the second it lies in and all after it are run
again from the node kept at that second's entry, so the outcome is the one of an input in order. Blocks are published
when their last sample is in, and once more, with a higher revision, when the solution that belongs to them has come
(not for every solution before it, though those too change them: a block that no solution followed is revised with the
next one).

The reported sigma of a displacement adds the variance of the last solution to the filter's: the error of GNSS is slow
(orbits, troposphere, multipath; minutes), so it passes the filter, which averages only what changes between epochs.
"""

import math
from dataclasses import replace

import numpy as np

from plumbline.config import FusionSettings
from plumbline.epochs.time_matching import grid_rate, grid_time_ns, match_samples
from plumbline.fusion.blocks import motions_of
from plumbline.fusion.control import without_faults
from plumbline.fusion.second import Run, index_in_second, run_second
from plumbline.fusion.state import FusionResult, FusionState, Innovation, Measurement, Second, unknown_node
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, InertialBlock, Motion, Solution, Status

IMPOSSIBLE_ACCELERATION_M_S2 = 200.0  # beyond the range of any sensor for structures
FUTURE_LIMIT_NS = 600 * NS_PER_S  # a sample stamped so long after its receipt has a wrong stamp
DEFAULT_SOLUTION_INTERVAL_NS = NS_PER_S
TOO_LATE = "solution_too_late"
REVISIONS_OF_A_START = 10_000  # a filter that starts anew revises above all that it has published before
LATE_IN_A_ROW = 10  # so many inputs too late, and none in time: it is the filter that is ahead, by a wrong stamp
_UP = 2


def receive_inertial(state: FusionState, block: InertialBlock, settings: FusionSettings) -> FusionResult:
    """Apply a block of samples as it comes; every second that it completes leaves as a block of motion."""
    rate = grid_rate(block.interval_ns)
    if rate is None:
        return _unused(state, "inertial_interval_not_usable")
    if block.t_first_gps_ns > block.t_receive_ns + FUTURE_LIMIT_NS:
        return _unused(state, "inertial_from_the_future")
    if state.sensor not in (None, block.sensor):
        return _unused(state, "inertial_of_another_sensor")
    first, values, tail = match_samples(block, settings.inertial_time_offset_s, state.tail)
    state = replace(state, tail=tail, sensor=block.sensor)
    if len(values) == 0:
        return FusionResult(state, [], [])
    state, values = _acceleration_enu(state, values, settings)
    state, touched = _place(state, first, values, rate, block.t_receive_ns)
    if not touched:
        too_late = bool(state.seconds) and (first + len(values) - 1) // rate < state.seconds[0].second
        return FusionResult(_one_more_late(state) if too_late else state, [], [])
    end_ns = grid_time_ns(first + len(values) - 1, rate)
    state = replace(state, t_samples_end_gps_ns=max(end_ns, state.t_samples_end_gps_ns or end_ns))
    state, closed = _close(state, state.seconds[-1].second * NS_PER_S)
    start = min(touched | closed)
    if state.stale_from is not None and any(m.second in touched for m in state.measurements):
        start = min(start, state.stale_from)
        state = replace(state, stale_from=None)
    state, runs, innovations, start = _tested(state, start, settings)
    state, motions = _publish(state, runs, start, state.seconds[-1].second, block.t_receive_ns, settings)
    return FusionResult(_trimmed(state, settings), motions, innovations)


def receive_solution(state: FusionState, solution: Solution, settings: FusionSettings) -> FusionResult:
    """Apply a solution at its own time; blocks that it changes leave again. One without a usable position is
    counted.
    """
    refusal = _why_not(state, solution)
    if refusal:
        late = _one_more_late(state) if refusal == TOO_LATE else state
        return _unused(replace(late, no_solution=solution.reason or solution.status.value), refusal)
    measurement = _measurement(solution, settings)
    index = sum(m.t_gps_ns < measurement.t_gps_ns for m in state.measurements)
    earlier = state.measurements[index - 1].t_gps_ns if index else None
    measurements = (*state.measurements[:index], measurement, *state.measurements[index:])
    state = replace(state, measurements=measurements, no_solution="", late_in_a_row=0)
    second = measurement.second
    if _waits(state, measurement, second, settings):
        return FusionResult(state, [], [])
    state, closed = _close(state, measurement.t_gps_ns)
    start = min({second, *closed} | ({state.stale_from} if state.stale_from is not None else set()))
    state, runs, innovations, start = _tested(state, start, settings)
    interval_ns = measurement.t_gps_ns - earlier if earlier is not None else DEFAULT_SOLUTION_INTERVAL_NS
    last = (state.measurements[-1].t_gps_ns + interval_ns) // NS_PER_S - 1
    rows_from_ns = min([measurement.t_gps_ns, *(number * NS_PER_S for number in closed)])
    state, motions = _publish(state, runs, start, last, solution.t_receive_ns, settings, rows_from_ns)
    stale = next((s.second for s in state.seconds if s.second > max(last, start - 1) and s.revision), None)
    return FusionResult(_trimmed(replace(state, stale_from=stale), settings), motions, innovations)


# ------------------------------------------------------------------------------------------- samples


def _acceleration_enu(state: FusionState, values: Floats, settings: FusionSettings) -> tuple[FusionState, Floats]:
    """Samples turned from sensor axes to ENU, gravity taken off the vertical; impossible ones become NaN and are
    counted.
    """
    rotation = np.array(settings.rotation_enu_from_sensor)
    possible = (np.abs(values) < IMPOSSIBLE_ACCELERATION_M_S2).all(axis=1)
    turned = values @ rotation.T
    turned[:, _UP] -= state.gravity_m_s2
    turned[~possible] = np.nan
    return _counted(state, "inertial_sample_impossible", int((~possible).sum())), turned


def _place(
    state: FusionState, first: int, values: Floats, rate: int, t_receive_ns: int
) -> tuple[FusionState, set[int]]:
    """Put samples into their seconds, where none is yet; also the seconds that changed."""
    seconds = {s.second: s for s in state.seconds}
    oldest = state.seconds[0].second if state.seconds else first // rate
    touched: set[int] = set()
    used = 0
    for number in range(first // rate, (first + len(values) - 1) // rate + 1):
        begin, end = max(number * rate, first), min((number + 1) * rate, first + len(values))
        old = seconds.get(number)
        if number < oldest or (old is not None and old.rate not in (0, rate)):
            continue
        new, n = _filled(state, old, number, rate, begin - number * rate, values[begin - first : end - first])
        used += n
        if n:
            seconds[number] = replace(new, t_receive_ns=t_receive_ns)
            touched.add(number)
    state = _counted(state, "inertial_late_or_repeated", len(values) - used)
    if not touched:
        return state, touched
    return replace(state, rate=rate, late_in_a_row=0, seconds=tuple(s for _, s in sorted(seconds.items()))), touched


def _filled(
    state: FusionState, old: Second | None, number: int, rate: int, at: int, values: Floats
) -> tuple[Second, int]:
    """A second with samples put in from ``at`` on where it has none; and how many were put in."""
    if old is None:
        old = Second(number, rate, state.head, np.full((rate, 3), np.nan), 0, 0, state.first_revision)
    elif old.rate == 0:
        old = replace(old, rate=rate, acceleration_m_s2=np.full((rate, 3), np.nan))
    samples = old.acceleration_m_s2.copy()
    part = samples[at : at + len(values)]
    missing = np.isnan(part[:, 0])
    part[missing] = values[missing]
    n = int(missing.sum())
    return replace(old, acceleration_m_s2=samples, filled=max(old.filled, at + len(values))), n


# ------------------------------------------------------------------------------------------- solutions


def _why_not(state: FusionState, solution: Solution) -> str:
    """Why a solution cannot be used; empty if it can."""
    z, r = solution.displacement_enu_m, solution.covariance_enu_m2
    if not solution.status.has_position or solution.status is Status.SINGLE_POINT:
        return f"solution_{solution.status.value}"
    if z is None or r is None:
        return "solution_without_displacement"
    if not (np.isfinite(z).all() and np.isfinite(r).all() and np.linalg.eigvalsh(0.5 * (r + r.T)).min() > 0.0):
        return "solution_covariance_not_positive"
    if any(m.t_gps_ns == solution.t_gps_ns for m in state.measurements):
        return "solution_repeated"
    too_late = state.seconds and solution.t_gps_ns < state.seconds[0].second * NS_PER_S
    return TOO_LATE if too_late else ""


def _measurement(solution: Solution, settings: FusionSettings) -> Measurement:
    total = np.array(solution.covariance_enu_m2)
    covariance = total if solution.noise_enu_m2 is None else np.array(solution.noise_enu_m2)
    if settings.displacement_sigma_m is not None:
        covariance = np.diag(np.array(settings.displacement_sigma_m) ** 2)
    return Measurement(
        solution.t_gps_ns,
        solution.t_receive_ns,
        np.array(solution.displacement_enu_m),
        0.5 * (covariance + covariance.T),
        total.diagonal().copy(),
        solution.status,
    )


def _waits(state: FusionState, measurement: Measurement, second: int, settings: FusionSettings) -> bool:
    """Whether the samples at a solution's instant are still to come."""
    end_ns = state.t_samples_end_gps_ns
    if end_ns is None or measurement.t_gps_ns > end_ns + round(settings.accelerometer_timeout_s * NS_PER_S):
        return False
    held = next((s for s in state.seconds if s.second == second), None)
    if held is None:
        return not state.seconds or second > state.seconds[-1].second
    return held.rate > 0 and index_in_second(held, measurement.t_gps_ns) >= held.filled


def _close(state: FusionState, until_ns: int) -> tuple[FusionState, set[int]]:
    """Give up samples that have not come before a time, and give solutions that lie there seconds of their own.

    Returns also the seconds that changed.
    """
    seconds = {s.second: s for s in state.seconds}
    closed: set[int] = set()
    for m in state.measurements:
        number = m.second
        if m.t_gps_ns <= until_ns and number not in seconds:
            seconds[number] = Second(number, 0, state.head, np.zeros((0, 3)), 0, m.t_receive_ns, state.first_revision)
            closed.add(number)
    for number, s in seconds.items():
        if s.filled < s.rate and index_in_second(s, until_ns) >= s.filled:
            seconds[number] = replace(s, filled=s.rate)
            closed.add(number)
    if not closed:
        return state, closed
    return replace(state, seconds=tuple(s for _, s in sorted(seconds.items()))), closed


# ------------------------------------------------------------------------------------------- run and publish


def _run_from(
    state: FusionState, first: int, settings: FusionSettings
) -> tuple[FusionState, dict[int, Run], list[Innovation]]:
    """Run the seconds from ``first`` on again; innovations of the solutions that had not been met before."""
    seconds, runs = list(state.seconds), {}
    start = next(i for i, s in enumerate(seconds) if s.second >= first)
    while start > 0 and (seconds[start].entry.t_gps_ns or 0) >= seconds[start].second * NS_PER_S:
        start -= 1  # a second put in between two others has the head for its entry
    by_second: dict[int, list[Measurement]] = {}
    for m in state.measurements:
        if m.t_gps_ns >= (seconds[start].second - 1) * NS_PER_S:
            by_second.setdefault(m.second, []).append(m)
    node = seconds[start].entry
    for i in range(start, len(seconds)):
        seconds[i] = replace(seconds[i], entry=node)
        run = run_second(seconds[i], by_second.get(seconds[i].second, []), settings)
        runs[seconds[i].second], node = run, run.node
    met = {v.t_gps_ns: v for run in runs.values() for v in run.innovations}
    fresh = [met[m.t_gps_ns] for m in state.measurements if m.t_gps_ns in met and not m.processed]
    marked = tuple(
        replace(m, processed=True) if m.t_gps_ns in met and not m.processed else m for m in state.measurements
    )
    return replace(state, seconds=tuple(seconds), measurements=marked, head=node), runs, fresh


def _tested(
    state: FusionState, first: int, settings: FusionSettings
) -> tuple[FusionState, dict[int, Run], list[Innovation], int]:
    """:func:`_run_from`, and once more without the samples that explain why a new solution does not fit.

    Last: the first second that was run differently.
    """
    ran, runs, fresh = _run_from(state, first, settings)
    refused = next((v for v in fresh if not v.applied), None)
    if refused is not None:
        rotation = np.array(settings.rotation_enu_from_sensor)
        fitting = [m.t_gps_ns for m in state.measurements if m.processed and m.t_gps_ns < refused.t_gps_ns]
        since_ns = fitting[-1] if fitting else refused.t_gps_ns - NS_PER_S
        seconds, cause, n, changed = without_faults(state.seconds, since_ns, refused.t_gps_ns, rotation)
        if n:
            other, other_runs, other_fresh = _run_from(
                replace(state, seconds=seconds), min(first, changed), settings
            )  # fmt: skip
            if next(v for v in other_fresh if v.t_gps_ns == refused.t_gps_ns).applied:
                ran, runs, first = _counted(other, f"motion_{cause}_samples", n), other_runs, min(first, changed)
                fresh = [replace(v, cause=cause) if v.t_gps_ns == refused.t_gps_ns else v for v in other_fresh]
    for innovation in fresh:
        ran = _counted(ran, f"motion_{innovation.cause}", int(innovation.cause != ""))
    return replace(ran, last_innovation=fresh[-1] if fresh else ran.last_innovation), runs, fresh, first


def _publish(
    state: FusionState,
    runs: dict[int, Run],
    first: int,
    last: int,
    t_receive_ns: int,
    settings: FusionSettings,
    rows_from_ns: int = 0,
) -> tuple[FusionState, list[Motion]]:
    """Blocks of the complete seconds ``first`` … ``last`` (of GNSS alone: rows from ``rows_from_ns`` on, and any
    second).
    """
    motions: list[Motion] = []
    seconds = list(state.seconds)
    for i, s in enumerate(seconds):
        in_range = first <= s.second <= last or (s.rate == 0 and s.second >= first)
        if s.second not in runs or not in_range or s.filled < s.rate:
            continue
        blocks = motions_of(state, s, runs[s.second], t_receive_ns, rows_from_ns, settings)
        motions += blocks
        seconds[i] = replace(s, revision=s.revision + bool(blocks))
    return replace(state, seconds=tuple(seconds)), motions


def _trimmed(state: FusionState, settings: FusionSettings) -> FusionState:
    """Forget what a solution can no longer change."""
    if not state.seconds or state.seconds[0].second >= state.seconds[-1].second - math.ceil(settings.late_limit_s):
        return state
    oldest = state.seconds[-1].second - math.ceil(settings.late_limit_s)
    seconds = tuple(s for s in state.seconds if s.second >= oldest)
    kept = tuple(m for m in state.measurements if m.second >= oldest)
    return replace(state, seconds=seconds, measurements=kept)


def _one_more_late(state: FusionState) -> FusionState:
    """Count an input that came too late; after too many the filter starts anew."""
    if state.late_in_a_row + 1 < LATE_IN_A_ROW:
        return replace(state, late_in_a_row=state.late_in_a_row + 1)
    fresh = FusionState(
        state.station,
        state.gravity_m_s2,
        unknown_node(),
        first_revision=state.first_revision + REVISIONS_OF_A_START,
        counters=state.counters,
    )
    return _counted(fresh, "restarted_after_a_wrong_time_stamp", 1)


def _unused(state: FusionState, reason: str) -> FusionResult:
    return FusionResult(_counted(state, reason, 1), [], [])


def _counted(state: FusionState, reason: str, n: int) -> FusionState:
    if n == 0:
        return state
    return replace(state, counters={**state.counters, reason: state.counters.get(reason, 0) + n})
