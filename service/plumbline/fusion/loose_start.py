"""The loose filter's start: what it keeps while it has no attitude, and how it gets one.

Level from the last standstill (or, on a structure that never quite stands still, from the mean of ten seconds in which
GNSS sees no travel), the gyroscope's bias from its mean rate there. The heading is the one given, else the
gyroscope's compass where its bias is known well enough, else the one that makes the velocity changes since that
standstill agree with GNSS.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from plumbline.config import InertialSettings
from plumbline.constants import STANDARD_GRAVITY_M_S2
from plumbline.fusion.alignment import (
    Alignment,
    describe,
    gyro_compass,
    heading_from_motion,
    level,
    level_velocity_changes,
    with_heading,
)
from plumbline.fusion.loose_clock import with_clock
from plumbline.fusion.loose_state import Fix, LooseExtra, LooseNode, LooseState, LooseTimeline, SampleClock
from plumbline.fusion.strapdown import curvature_radii_m, earth_rate_local_rad_s
from plumbline.fusion.timeline import Node, add_measurement
from plumbline.fusion.zupt import Standstill, standstills
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, Ints

_KEEP_NS: Final = 120 * NS_PER_S
_TRY_EVERY_NS: Final = NS_PER_S // 2
_REST_S: Final = 2.0  # at rest, at least so long
_SLOW_M_S: Final = 0.1  # no travel
_AVERAGE_S: Final = 10.0
_LEAST_SAMPLES: Final = 50  # in that time
_HEADING_SIGMA_RAD: Final = math.radians(3.0)  # good enough to begin with
_COMPASS_SIGMA_RAD: Final = math.radians(3.0)
_TILT_SIGMA_RAD: Final = 1e-4  # of levelling itself, beside the accelerometer's bias
_COMPASS_SPAN_S: Final = 60.0
_OFFSET_REACH: Final = 3.0  # sigmas of the stamps' offset that are searched
_OFFSET_STEP_S: Final = 0.02
_VELOCITY_AGE_SIGMA_M_S: Final = 0.5  # of the last velocity at the last position, where their times differ


@dataclass(frozen=True, slots=True)
class Rest:
    """Mean samples of a span at rest."""

    t_end_ns: int
    span_s: float
    force_m_s2: Floats
    rate_rad_s: Floats
    quiet: bool  # the gyroscope stood still too, so its mean is its bias


def aligned(state: LooseState, settings: InertialSettings) -> LooseState:
    """The state, running if an attitude was found; else with what is too old forgotten."""
    timeline = state.timeline
    fixes = [m for m in timeline.measurements if isinstance(m, Fix)]
    if not fixes or not timeline.t_gps_ns.size:
        return state
    end_ns = min(fixes[-1].t_gps_ns, int(timeline.t_gps_ns[-1]))
    if end_ns < state.t_aligned_try_ns + _TRY_EVERY_NS:
        return state
    state = replace(state, timeline=_kept(timeline, end_ns - _KEEP_NS), t_aligned_try_ns=end_ns)
    usable = [f for f in fixes if timeline.t_gps_ns[0] <= f.t_gps_ns <= timeline.t_gps_ns[-1]]
    rest = _rest(state.timeline.t_gps_ns, state.timeline.samples, usable, settings)
    if rest is None or not usable:
        return state
    offset_s = _offset_s(state.timeline, rest, usable, settings)
    state = replace(state, timeline=_stamped(state.timeline, offset_s))
    usable = [f for f in state.timeline.measurements if isinstance(f, Fix)]
    usable = [f for f in usable if timeline.t_gps_ns[0] <= f.t_gps_ns <= timeline.t_gps_ns[-1]]
    node, alignment = _first_node(state.timeline, rest, usable, settings)
    return state if node is None or alignment is None else start(state, node, describe(alignment), settings)


def _kept(timeline: LooseTimeline, oldest_ns: int) -> LooseTimeline:
    first = int(np.searchsorted(timeline.t_gps_ns, oldest_ns))
    return replace(
        timeline,
        t_gps_ns=timeline.t_gps_ns[first:],
        samples=timeline.samples[first:],
        measurements=tuple(m for m in timeline.measurements if m.t_gps_ns >= oldest_ns),
    )


# ------------------------------------------------------------------------------------------- rest


def _rest(t_ns: Ints, samples: Floats, fixes: list[Fix], settings: InertialSettings) -> Rest | None:
    """The last standstill that is long enough, or ten seconds without travel."""
    windows = standstills(t_ns, samples, 0, settings)
    group: list[Standstill] = []
    for window in reversed(windows):
        joined = not group or group[-1].t_first_ns - window.t_gps_ns < 0.5 * settings.standstill_window_s * NS_PER_S
        if not joined:
            if sum(w.span_s for w in group) >= _REST_S:
                break
            group = []
        group.append(window)
    if sum(w.span_s for w in group) >= _REST_S:
        weights = np.array([w.span_s for w in group])
        force = np.average([w.mean_force_m_s2 for w in group], axis=0, weights=weights)
        rate = np.average([w.mean_rate_rad_s for w in group], axis=0, weights=weights)
        return Rest(group[0].t_gps_ns, float(weights.sum()), force, rate, True)
    return _slow(t_ns, samples, fixes, settings)


def _slow(t_ns: Ints, samples: Floats, fixes: list[Fix], settings: InertialSettings) -> Rest | None:
    """The mean of the last ten seconds in which GNSS saw no travel; what the stamps may be off is left out."""
    seen = [f for f in fixes if f.velocity_enu_m_s is not None]
    if not seen:
        return None
    span_ns = round(_AVERAGE_S * NS_PER_S)
    times = np.array([f.t_gps_ns for f in seen], np.int64)
    travels = np.array([np.linalg.norm(f.velocity_enu_m_s) > _SLOW_M_S for f in seen])  # type: ignore[arg-type]
    since_ns = np.maximum.accumulate(np.where(travels, times, max(times[0], t_ns[0]) - 1))
    still = np.flatnonzero(times - since_ns > span_ns)
    if not still.size:
        return None
    end_ns = int(times[still[-1]]) - round(_OFFSET_REACH * settings.inertial_time_offset_sigma_s * NS_PER_S)
    part = samples[(t_ns >= end_ns - span_ns) & (t_ns <= end_ns)]
    if len(part) < _LEAST_SAMPLES:
        return None
    return Rest(end_ns, _AVERAGE_S, part[:, :3].mean(axis=0), part[:, 3:].mean(axis=0), False)


# ------------------------------------------------------------------------------------------- time


def _offset_s(timeline: LooseTimeline, rest: Rest, fixes: list[Fix], settings: InertialSettings) -> float:
    """The offset of the stamps at which the samples agree best with GNSS velocities; 0 where they are right."""
    reach_s = _OFFSET_REACH * settings.inertial_time_offset_sigma_s
    if reach_s == 0.0:
        return 0.0
    reach_ns, last_ns = round(reach_s * NS_PER_S), int(timeline.t_gps_ns[-1])
    moving = [f for f in fixes if f.velocity_enu_m_s is not None]
    moving = [f for f in moving if rest.t_end_ns + reach_ns <= f.t_true_ns <= last_ns - reach_ns]
    if not _moved(moving):
        return 0.0
    true_ns = np.array([f.t_true_ns for f in moving], np.int64)
    bias = rest.rate_rad_s if rest.quiet else np.zeros(3)

    def sigma_at(offset_s: float) -> float:
        changes, _ = _carried(timeline, rest, bias, true_ns - round(offset_s * NS_PER_S))
        return _heading_by_motion(moving, changes)[1]

    offsets = np.arange(-reach_s, reach_s + _OFFSET_STEP_S, _OFFSET_STEP_S)
    return float(min(offsets, key=sigma_at))


def _stamped(timeline: LooseTimeline, offset_s: float) -> LooseTimeline:
    """The timeline, its fixes where an offset puts them among the stamps."""
    clock = SampleClock(0, offset_s)
    moved = [
        replace(m, t_gps_ns=clock.stamp_of(m.t_true_ns)) if isinstance(m, Fix) else m for m in timeline.measurements
    ]
    return replace(timeline, measurements=tuple(sorted(moved, key=lambda m: (m.t_gps_ns, m.rank))))


# ------------------------------------------------------------------------------------------- heading


def _first_node(
    timeline: LooseTimeline, rest: Rest, fixes: list[Fix], settings: InertialSettings
) -> tuple[LooseNode | None, Alignment | None]:
    """The first node of the filter, at the last position, if the heading is known by then."""
    after = [f for f in fixes if f.t_gps_ns >= rest.t_end_ns]
    last = next((f for f in reversed(after) if f.geodetic is not None), None)
    if last is None or last.geodetic is None:
        return None, None
    bias = rest.rate_rad_s if rest.quiet else np.zeros(3)
    moving = [f for f in after if f.velocity_enu_m_s is not None]
    changes, _ = _carried(timeline, rest, bias, np.array([f.t_gps_ns for f in moving], np.int64))
    _, rotation = _carried(timeline, rest, bias, np.array([last.t_gps_ns], np.int64))
    heading, sigma = _heading(rest, moving, changes, last.geodetic[0], settings)
    if sigma > _HEADING_SIGMA_RAD:
        return None, None
    tilt = math.hypot(_TILT_SIGMA_RAD, 0.0 if rest.quiet else 2e-3)
    levelled = with_heading(level(rest.force_m_s2), heading)
    alignment = Alignment(with_heading(rotation, heading), np.array([tilt, tilt, sigma]), levelled)
    velocity = moving[-1].velocity_enu_m_s if moving else None
    unsure = 1.0 if velocity is None else (0.0 if last is moving[-1] else _VELOCITY_AGE_SIGMA_M_S)
    node = _node_at(last, last.geodetic, alignment, velocity, unsure, settings)
    return (_with_bias(node, rest, alignment, settings) if rest.quiet else node), alignment


def _carried(timeline: LooseTimeline, rest: Rest, bias: Floats, ends_ns: Ints) -> tuple[Floats, Floats]:
    """Velocity changes (m, 3) in the level frame since the rest, and the level rotation (3, 3) at the last time."""
    rotation = level(rest.force_m_s2)
    changes = level_velocity_changes(timeline.t_gps_ns, timeline.samples, rotation, bias, rest.t_end_ns, ends_ns)
    return changes, rotation


def _heading(
    rest: Rest, moving: list[Fix], changes: Floats, latitude_rad: float, settings: InertialSettings
) -> tuple[float, float]:
    """Heading of the level frame and its sigma, rad; infinite where it cannot be told yet."""
    if settings.heading_deg is not None:
        return math.radians(settings.heading_deg), math.radians(settings.heading_sigma_deg)
    noise = settings.gyroscope_noise_rad_s_sqrt_hz / math.sqrt(rest.span_s)
    bias_sigma = math.hypot(settings.initial_gyroscope_bias_sigma_rad_s, noise)
    compass = gyro_compass(level(rest.force_m_s2), rest.rate_rad_s, latitude_rad, bias_sigma)
    if rest.quiet and rest.span_s >= _COMPASS_SPAN_S and compass[1] < _COMPASS_SIGMA_RAD:
        return compass
    return _heading_by_motion(moving, changes) if _moved(moving) else (0.0, math.inf)


def _moved(moving: list[Fix]) -> bool:
    """Whether velocities changed by more than their noise."""
    if len(moving) < 4:
        return False
    velocity = np.diff(np.array([f.velocity_enu_m_s for f in moving])[:, :2], axis=0)
    noise_power = float(sum(np.trace(f.covariance[3:5, 3:5]) for f in moving))
    return float(np.sum(velocity**2)) > 4.0 * noise_power


def _heading_by_motion(moving: list[Fix], changes: Floats) -> tuple[float, float]:
    """Heading and its sigma of velocities and of what the samples made of them (m, 3)."""
    velocity = np.diff(np.array([f.velocity_enu_m_s for f in moving])[:, :2], axis=0)
    intervals = np.diff([f.t_true_ns for f in moving]) / NS_PER_S
    return heading_from_motion(np.diff(changes[:, :2], axis=0), velocity, intervals)


def _node_at(
    fix: Fix,
    geodetic: Floats,
    alignment: Alignment,
    velocity_enu_m_s: Floats | None,
    velocity_sigma_m_s: float,
    settings: InertialSettings,
) -> LooseNode:
    """The navigation state at a fix, and the covariance of its errors."""
    arm = alignment.rotation_enu_from_body @ np.array(settings.lever_arms_body_m[0])
    meridian, across = curvature_radii_m(geodetic[0])
    nav = np.zeros(21)
    nav[0] = geodetic[0] - arm[1] / (meridian + geodetic[2])
    nav[1] = geodetic[1] - arm[0] / ((across + geodetic[2]) * math.cos(geodetic[0]))
    nav[2] = geodetic[2] - arm[2]
    nav[3:6] = 0.0 if velocity_enu_m_s is None else velocity_enu_m_s
    nav[6:15] = alignment.rotation_enu_from_body.ravel()
    p = first_covariance(alignment, settings)
    p[0:3, 0:3] += 4.0 * fix.covariance[:3, :3]
    p[3:6, 3:6] += 4.0 * fix.covariance[3:, 3:] + velocity_sigma_m_s**2 * np.eye(3)
    p, clock = with_clock(p, fix, settings)
    return Node(fix.t_gps_ns, nav, p, LooseExtra(0, fix.t_gps_ns, fix.status, clock=clock))


def _with_bias(node: LooseNode, rest: Rest, alignment: Alignment, settings: InertialSettings) -> LooseNode:
    """The node, its gyroscope's bias taken from the mean rate at rest less the Earth's."""
    nav, p = node.nav.copy(), node.p.copy()
    earth_body = alignment.rotation_enu_from_body.T @ earth_rate_local_rad_s(nav[0])
    nav[18:21] = rest.rate_rad_s - earth_body
    sigma = settings.gyroscope_noise_rad_s_sqrt_hz / math.sqrt(rest.span_s) + settings.standstill_bias_sigma_rad_s
    turn = float(np.linalg.norm(earth_body)) * float(alignment.sigma_enu_rad[2])
    p[12:15, 12:15] = np.eye(3) * (sigma**2 + turn**2)
    return replace(node, nav=nav, p=p)


def first_covariance(alignment: Alignment, settings: InertialSettings) -> Floats:
    """Covariance (15, 15) of a fresh alignment; position and velocity still without theirs.

    Levelling takes the accelerometer's bias for tilt: ψ_N = (C b)_E / g, ψ_E = −(C b)_N / g.
    """
    p = np.zeros((15, 15))
    p[6:9, 6:9] = np.diag(alignment.sigma_enu_rad**2)
    p[9:12, 9:12] = np.eye(3) * settings.initial_accelerometer_bias_sigma_m_s2**2
    p[12:15, 12:15] = np.eye(3) * settings.initial_gyroscope_bias_sigma_rad_s**2
    if alignment.levelled_enu_from_body is not None:
        tilt = np.zeros((3, 3))
        tilt[0, 1], tilt[1, 0] = -1.0 / STANDARD_GRAVITY_M_S2, 1.0 / STANDARD_GRAVITY_M_S2
        by_bias = tilt @ alignment.levelled_enu_from_body
        p[6:9, 9:12] = by_bias @ p[9:12, 9:12]
        p[9:12, 6:9] = p[6:9, 9:12].T
        p[6:9, 6:9] += by_bias @ p[9:12, 9:12] @ by_bias.T
    return p


def start(state: LooseState, node: LooseNode, how: str, settings: InertialSettings) -> LooseState:
    """Begin to run from a node; measurements and samples before it are dropped."""
    measurements = tuple(m for m in state.timeline.measurements if m.t_gps_ns > node.t_gps_ns)
    timeline = replace(state.timeline, nodes=(node,), measurements=measurements)
    for window in standstills(timeline.t_gps_ns, timeline.samples, node.t_gps_ns, settings):
        timeline = add_measurement(timeline, window)
    return replace(state, timeline=timeline, aligned=how)
