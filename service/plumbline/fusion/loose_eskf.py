"""Loosely coupled GNSS/IMU: a 15-state error-state filter on GNSS positions and velocities (de Alteriis 2022).

The state is carried by the local mechanisation (:mod:`plumbline.fusion.strapdown`; the paper's eqs 1-7), its errors by
the model of :mod:`plumbline.fusion.error_model` (eqs 8-10), and measured (eqs 11-14) by positions and velocities of an
antenna at a lever arm (the paper leaves it out, eq. 12)::

    δz_r = δr − [(C l)×] ψ
    δz_v = δv − [(C (ω × l))×] ψ + [ω_ie×] [(C l)×] ψ + C [l×] δb_g

Where the samples' stamps are not trusted (``inertial_time_offset_sigma_s``), their clock's offset and drift are two
more states: see :mod:`plumbline.fusion.loose_clock`.

Standstills found in the samples give zero velocity and the gyroscope's bias. Feedback is closed: after each measurement
the estimated errors go into the state. Inputs may come in any order within ``late_limit_s``.

Before the first attitude is known, samples and solutions are kept: see :mod:`plumbline.fusion.loose_start`.
"""

from dataclasses import replace

import numpy as np

from plumbline.config import InertialSettings
from plumbline.fusion.loose_start import aligned
from plumbline.fusion.loose_state import (
    VELOCITY_SIGMAS,
    Fix,
    LooseExtra,
    LooseNode,
    LooseResult,
    LooseState,
    LooseTimeline,
    SampleClock,
)
from plumbline.fusion.loose_update import update_fix, update_standstill
from plumbline.fusion.noise import noise_row, samples_of
from plumbline.fusion.timeline import Ran, add_measurement, add_samples, counted, no_rows, run
from plumbline.fusion.zupt import Standstill, standstills
from plumbline.gnss.earth_frames import geodetic_from_ecef
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, InertialBlock, Ints, Solution


def initial_loose_state(station: str) -> LooseState:
    """Before the first input."""
    return LooseState(station)


def receive_samples(state: LooseState, t_gps_ns: Ints, samples: Floats, settings: InertialSettings) -> LooseResult:
    """Apply samples (n, 6) of body axes at times (n,); evenly spaced or not."""
    timeline = add_samples(state.timeline, t_gps_ns, samples)
    if not timeline.t_gps_ns.size:
        return LooseResult(replace(state, timeline=timeline), no_rows())
    width_ns = round(settings.standstill_window_s * NS_PER_S)
    if timeline.nodes:
        for window in standstills(timeline.t_gps_ns, timeline.samples, state.t_window_ns, settings):
            timeline = add_measurement(timeline, window)
    state = replace(state, timeline=timeline, t_window_ns=int(timeline.t_gps_ns[-1]) // width_ns * width_ns - 1)
    return _go_on(state, settings)


def receive_inertial(state: LooseState, block: InertialBlock, settings: InertialSettings) -> LooseResult:
    """Apply a block of samples as it comes."""
    if block.angular_rate_rad_s is None:
        return LooseResult(replace(state, timeline=counted(state.timeline, "inertial_without_rates")), no_rows())
    t_gps_ns, samples = samples_of(block, settings)
    return receive_samples(state, t_gps_ns, samples, settings)


def receive_solution(state: LooseState, solution: Solution, settings: InertialSettings) -> LooseResult:
    """Apply a solution of the first antenna at its own time; one without a usable position is counted."""
    timeline = state.timeline
    clock = timeline.nodes[-1].extra.clock if timeline.nodes else None
    fixes = fixes_of(solution, settings, clock)
    for fix in fixes:
        timeline = add_measurement(timeline, fix)
    if not fixes:
        timeline = counted(timeline, f"solution_{solution.status.value}")
    return _go_on(replace(state, timeline=timeline), settings)


def fixes_of(solution: Solution, settings: InertialSettings, clock: SampleClock | None) -> list[Fix]:
    """A solution as the filter takes it: one fix, or two where its velocity is known to be that of another time.

    With a clock, they are put where their time lies among the samples' stamps, as far as that is known now.

    None where it has no position and covariance to use.
    """
    position, covariance, velocity = solution.position_ecef_m, solution.covariance_enu_m2, solution.velocity_enu_m_s
    if not solution.status.has_position or position is None or covariance is None:
        return []
    if velocity is not None and not np.isfinite(velocity).all():
        velocity = None
    full = np.zeros((6, 6))
    full[:3, :3] = 0.5 * (covariance + covariance.T) + settings.position_sigma_floor_m**2 * np.eye(3)
    sigmas = [solution.extras.get(name, settings.velocity_sigma_m_s) for name in VELOCITY_SIGMAS]
    full[3:, 3:] = np.diag(np.square(sigmas))
    finite = np.isfinite(position).all() and np.isfinite(full).all()
    if not finite or not (np.linalg.eigvalsh(full) > 0.0).all():
        return []
    geodetic = geodetic_from_ecef(np.asarray(position, float))
    t_ns, delay_ns = solution.t_gps_ns, round(settings.velocity_delay_s * NS_PER_S)

    def fix(true_ns: int, place: Floats | None, speed: Floats | None) -> Fix:
        at_ns = true_ns if clock is None else clock.stamp_of(true_ns)
        return Fix(at_ns, place, speed, full, solution.status, true_ns)

    if velocity is None or delay_ns == 0:
        return [fix(t_ns, geodetic, velocity)]
    return [fix(t_ns - delay_ns, None, velocity), fix(t_ns, geodetic, None)]


# ------------------------------------------------------------------------------------------- the filter


def _go_on(state: LooseState, settings: InertialSettings) -> LooseResult:
    """Align if that is still to be done, and run to the last sample."""
    if not state.timeline.nodes:
        state = aligned(state, settings)
    ran = run_timeline(state.timeline, settings)
    innovations = tuple(node.extra.innovation for node in ran.updated if node.extra.innovation is not None)
    return LooseResult(replace(state, timeline=ran.timeline), ran.rows, innovations)


def run_timeline(timeline: LooseTimeline, settings: InertialSettings) -> Ran[Fix | Standstill, LooseExtra]:
    """Run to the last sample."""

    def update(node: LooseNode, measurement: Fix | Standstill, sample: Floats) -> LooseNode:
        if isinstance(measurement, Standstill):
            return update_standstill(node, measurement, settings)
        return update_fix(node, measurement, sample, settings)

    return run(timeline, noise_row(settings), True, update, settings.late_limit_s)
