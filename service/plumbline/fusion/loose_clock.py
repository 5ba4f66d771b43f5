"""The clock that stamped the samples, as two more states of the loose filter: its offset and its drift.

A logger stamps samples by its own clock, or by when they were read: late by a tenth of a second, and by another tenth
ten minutes later. What moves is then measured where it was not: ``v δt`` of position, ``a δt`` of velocity. With
``t_true = stamp + τ`` a fix of the true time t, applied at the stamp s, measures

    r(t) = r(s) + v (t − s − τ)          δz_r = … − v δτ          δz_v = … − a δτ

to first order, which is enough: a fix is applied at the stamp that the offset, as it was known on arrival, gives it.
Offset and drift are a random walk and a constant. Nothing is learnt of them while nothing accelerates.
"""

from typing import Final

import numpy as np

from plumbline.config import InertialSettings
from plumbline.fusion.inertial_run import ROW_ACCELERATION
from plumbline.fusion.loose_state import Fix, LooseNode, SampleClock
from plumbline.fusion.strapdown import (
    ERROR_SIZE,
    curvature_radii_m,
    earth_rate_local_rad_s,
    gravity_up_m_s2,
    transport_rate_local_rad_s,
)
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, Ints

CLOCK_OFFSET: Final = ERROR_SIZE  # places in the error state, s and s/s
CLOCK_DRIFT: Final = ERROR_SIZE + 1
CLOCKED_SIZE: Final = ERROR_SIZE + 2


def with_clock(p: Floats, fix: Fix, settings: InertialSettings) -> tuple[Floats, SampleClock | None]:
    """The covariance (15, 15) at a first fix with the clock's (17, 17), and the clock that put the fix at its stamp.

    Unchanged, and None, where the stamps are right.
    """
    if settings.inertial_time_offset_sigma_s == 0.0:
        return p, None
    wider = np.zeros((CLOCKED_SIZE, CLOCKED_SIZE))
    wider[:ERROR_SIZE, :ERROR_SIZE] = p
    wider[CLOCK_OFFSET, CLOCK_OFFSET] = settings.inertial_time_offset_sigma_s**2
    wider[CLOCK_DRIFT, CLOCK_DRIFT] = settings.inertial_time_drift_sigma**2
    return wider, SampleClock(fix.t_gps_ns, (fix.t_true_ns - fix.t_gps_ns) / NS_PER_S)


def clock_transition(p: Floats, since_s: float) -> Floats:
    """Transition (n, n) of the clock over ``since_s``, for a covariance (n, n); the other states stand."""
    out = np.eye(len(p))
    if len(p) == CLOCKED_SIZE:
        out[CLOCK_OFFSET, CLOCK_DRIFT] = since_s
    return out


def carried(node: LooseNode, settings: InertialSettings) -> tuple[SampleClock | None, Floats]:
    """The clock at the node's time, and the node's covariance (n, n) with the clock's moved there."""
    clock = node.extra.clock
    if clock is None:
        return None, node.p.copy()
    since_s = (node.t_gps_ns - clock.t_gps_ns) / NS_PER_S
    transition = clock_transition(node.p, since_s)
    p = transition @ node.p @ transition.T
    p[CLOCK_OFFSET, CLOCK_OFFSET] += settings.inertial_time_walk_s_sqrt_s**2 * abs(since_s)
    return SampleClock(node.t_gps_ns, clock.offset_at(node.t_gps_ns), clock.drift), p


def corrected(clock: SampleClock | None, error: Floats) -> SampleClock | None:
    """The clock, moved by its part of an estimated error (n,)."""
    if clock is None:
        return None
    offset_s, drift = clock.offset_s + float(error[CLOCK_OFFSET]), clock.drift + float(error[CLOCK_DRIFT])
    return SampleClock(clock.t_gps_ns, offset_s, drift)


def clock_rows(
    nav: Floats, sample: Floats, lever_arm_body_m: Floats, fix: Fix, clock: SampleClock, at_ns: int
) -> tuple[Floats, Floats]:
    """Column (6,) of the offset in the design of a fix, and what its innovations (6,) lose to the time between.

    ``nav`` (21,) at the stamp ``at_ns``, ``sample`` (6,) there.
    """
    rotation = nav[6:15].reshape(3, 3)
    rate = sample[3:6] - nav[18:21]
    arm_rate = np.cross(rate, lever_arm_body_m)
    motion = np.concatenate(
        [nav[3:6] + rotation @ arm_rate, acceleration_enu_m_s2(nav, sample) + rotation @ np.cross(rate, arm_rate)]
    )
    between_s = (fix.t_true_ns - at_ns) / NS_PER_S - clock.offset_at(at_ns)
    return -motion, motion * between_s


def acceleration_enu_m_s2(nav: Floats, sample: Floats) -> Floats:
    """Acceleration (3,), east, north, up, relative to the Earth, of a sample (6,)."""
    rotation, velocity = nav[6:15].reshape(3, 3), nav[3:6]
    turning = 2.0 * earth_rate_local_rad_s(nav[0]) + transport_rate_local_rad_s(nav[0], nav[2], velocity)
    out: Floats = rotation @ (sample[:3] - nav[15:18]) - np.cross(turning, velocity)
    out[2] -= gravity_up_m_s2(nav[0], nav[2])
    return out


def at_true_times(rows: Floats, clock: SampleClock | None, t_gps_ns: Ints) -> Floats:
    """Rows (n, 51) of the stamps ``t_gps_ns`` (n,) taken for true times: moved back by what the clock is off.

    Position and velocity by the motion of the moment; attitude, which turns little meanwhile, as it is.
    """
    if clock is None or not len(rows):
        return rows
    out = rows.copy()
    offset_s = (clock.offset_s + clock.drift * (t_gps_ns - clock.t_gps_ns) / NS_PER_S)[:, None]
    acceleration = rows[:, ROW_ACCELERATION:]
    moved = 0.5 * offset_s**2 * acceleration - offset_s * rows[:, 3:6]
    meridian, across = curvature_radii_m(rows[0, 0])
    out[:, 0] += moved[:, 1] / (meridian + rows[:, 2])
    out[:, 1] += moved[:, 0] / ((across + rows[:, 2]) * np.cos(rows[:, 0]))
    out[:, 2] += moved[:, 2]
    out[:, 3:6] -= offset_s * acceleration
    return out
