"""How fixes and standstills measure the loose filter's errors."""

from dataclasses import replace

import numpy as np

from plumbline.config import InertialSettings
from plumbline.estimation.kalman import cholesky_lower, innovation_covariance, update_sequential
from plumbline.fusion.error_model import feed_back
from plumbline.fusion.loose_clock import carried, clock_rows, corrected
from plumbline.fusion.loose_state import Fix, Innovation, LooseExtra, LooseNode, SampleClock
from plumbline.fusion.rotations import skew
from plumbline.fusion.strapdown import (
    ERROR_ATTITUDE,
    ERROR_GYROSCOPE_BIAS,
    ERROR_POSITION,
    ERROR_SIZE,
    ERROR_VELOCITY,
    curvature_radii_m,
    earth_rate_local_rad_s,
)
from plumbline.fusion.timeline import Node
from plumbline.fusion.zupt import Standstill, standstill_rows
from plumbline.records import Floats


def fix_rows(
    nav: Floats, rate_rad_s: Floats, lever_arm_body_m: Floats, geodetic: Floats, velocity_enu_m_s: Floats
) -> tuple[Floats, Floats]:
    """Design matrix (6, 15) and innovations (6,) of a position and a velocity of an antenna.

    ``rate_rad_s`` (3,) as measured, ``lever_arm_body_m`` (3,) IMU → antenna, ``geodetic`` (3,) rad, rad, m.
    """
    rotation, earth = nav[6:15].reshape(3, 3), earth_rate_local_rad_s(nav[0])
    arm = rotation @ lever_arm_body_m
    arm_rate = rotation @ np.cross(rate_rad_s - nav[18:21], lever_arm_body_m)
    meridian, across = curvature_radii_m(nav[0])
    h, v = np.zeros((6, ERROR_SIZE)), np.zeros(6)
    h[:3, ERROR_POSITION : ERROR_POSITION + 3] = np.eye(3)
    h[:3, ERROR_ATTITUDE : ERROR_ATTITUDE + 3] = -skew(arm)
    v[0] = (geodetic[1] - nav[1]) * (across + nav[2]) * np.cos(nav[0])
    v[1] = (geodetic[0] - nav[0]) * (meridian + nav[2])
    v[2] = geodetic[2] - nav[2]
    v[:3] -= arm
    h[3:, ERROR_VELOCITY : ERROR_VELOCITY + 3] = np.eye(3)
    h[3:, ERROR_ATTITUDE : ERROR_ATTITUDE + 3] = -skew(arm_rate) + skew(earth) @ skew(arm)
    h[3:, ERROR_GYROSCOPE_BIAS:ERROR_SIZE] = rotation @ skew(lever_arm_body_m)
    v[3:] = velocity_enu_m_s - (nav[3:6] + arm_rate - np.cross(earth, arm))
    return h, v


def rows_of_fix(
    nav: Floats, sample: Floats, fix: Fix, clock: SampleClock | None, at_ns: int, settings: InertialSettings
) -> tuple[Floats, Floats]:
    """Design matrix (6, n) and innovations (6,) of a fix at the stamp ``at_ns``; innovations it has not are NaN."""
    arm, nothing = np.array(settings.lever_arms_body_m[0]), np.full(3, np.nan)
    h, v = fix_rows(
        nav,
        sample[3:6],
        arm,
        nothing if fix.geodetic is None else fix.geodetic,
        nothing if fix.velocity_enu_m_s is None else fix.velocity_enu_m_s,
    )
    if clock is None:
        return h, v
    column, moved = clock_rows(nav, sample, arm, fix, clock, at_ns)
    return np.column_stack([h, column, np.zeros(6)]), v - moved


def update_fix(node: LooseNode, fix: Fix, sample: Floats, settings: InertialSettings) -> LooseNode:
    """The node after a fix; one too far off is refused, until too many in a row have been."""
    clock, p = carried(node, settings)
    at_ns = node.t_gps_ns
    h, v = rows_of_fix(node.nav, sample, fix, clock, at_ns, settings)
    there = np.isfinite(v)
    sigma = np.sqrt(np.diag(innovation_covariance(p, h, np.diag(fix.covariance).astype(np.float64))))
    sigma[~there] = np.nan
    refused = bool((np.abs(v[there]) > settings.innovation_gate_sigma * sigma[there]).any())
    if refused and node.extra.refusals + 1 < settings.max_refusals:
        innovation = Innovation(fix.t_true_ns, v, sigma, v, False)
        extra = replace(node.extra, refusals=node.extra.refusals + 1, innovation=innovation, clock=clock)
        return replace(node, p=p, extra=extra)
    nav = node.nav.copy()
    if refused:  # the GNSS says so again and again: it is the state that is off
        p[:6, :6] += np.diag(np.nan_to_num(v) ** 2)
    error = apply(nav, p, h[there], v[there], fix.covariance[np.ix_(there, there)], local=True)
    clock = corrected(clock, error)
    _, left = rows_of_fix(nav, sample, fix, clock, at_ns, settings)
    innovation = Innovation(fix.t_true_ns, v, sigma, left, True)
    t_fix_ns = at_ns if fix.geodetic is not None else node.extra.t_fix_gps_ns
    return Node(at_ns, nav, p, LooseExtra(0, t_fix_ns, fix.status, innovation, clock))


def update_standstill(node: LooseNode, standstill: Standstill, settings: InertialSettings) -> LooseNode:
    """The node after a standstill; a velocity that speaks against it (a smooth ride) leaves it out."""
    earth = earth_rate_local_rad_s(node.nav[0])
    clock, p = carried(node, settings)
    h, variances, v = standstill_rows(node.nav, earth, standstill, settings, len(p))
    expected = np.sqrt(np.diag(innovation_covariance(p, h, variances)))
    if (np.abs(v) > settings.innovation_gate_sigma * expected).any():
        return node
    nav = node.nav.copy()
    error = apply(nav, p, h, v, np.asarray(np.diag(variances), np.float64), local=True)
    return Node(node.t_gps_ns, nav, p, replace(node.extra, innovation=None, clock=corrected(clock, error)))


def apply(nav: Floats, p: Floats, h: Floats, v: Floats, r: Floats, *, local: bool) -> Floats:
    """Update ``nav`` and ``p``, in place, by correlated observations: whitened, then one by one in Joseph's form.

    Returns the estimated error (n,).
    """
    factor, _ = cholesky_lower(r)
    error = np.zeros(p.shape[0])
    white = np.asarray(np.linalg.solve(factor, np.column_stack([h, v])), np.float64)
    use = np.ones(v.size, np.bool_)
    update_sequential(error, p, np.ascontiguousarray(white[:, :-1]), np.ones(v.size), white[:, -1].copy(), use)
    feed_back(nav, p, error[:ERROR_SIZE], local)
    return error
