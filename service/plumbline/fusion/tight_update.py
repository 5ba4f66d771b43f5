"""One epoch of the platform's antennas in the tight filter."""

from dataclasses import replace
from typing import Final

import numpy as np

from plumbline.config import InertialSettings, RtkSettings
from plumbline.fusion.error_model import feed_back
from plumbline.fusion.strapdown import ERROR_SIZE
from plumbline.fusion.tight_arcs import TightExtra, begun, ended, matched, noted, without
from plumbline.fusion.tight_fix import conditioned, confirm, find, is_confirmed, speaks_against, wandered
from plumbline.fusion.tight_kernels import design, fitting, group_medians, informed, normal_equations
from plumbline.fusion.tight_observations import SIGNAL_KEY, TightEpoch, base_share
from plumbline.fusion.timeline import Node
from plumbline.gps_time import NS_PER_S
from plumbline.positioning.state import Records
from plumbline.records import Booleans, Floats, Ints, Status

TightNode = Node[TightExtra]

_CHI2_MEDIAN: Final = 0.4549  # of one degree of freedom
_LEAST_ROWS: Final = 4
_DOUBT_SHARE: Final = 0.4  # of the held phases that do not fit
_DOUBT_NIS: Final = 9.0  # of the held phases, a degree of freedom: three sigma all together
_DOUBT_LIMIT: Final = 10
_RESET_SIGMA_M: Final = 3.0
_FLOAT_SIGMA_M: Final = 0.1  # three-dimensional: a position less certain, without integers, is no displacement yet
_SLIP_CYCLES: Final = 0.4  # off by so much, a held phase is refused however unsure the prediction is
_CODE_MEMORY_S: Final = 60.0  # a resting antenna's code multipath lasts minutes: averaging epochs does not remove it
_CHECK_NS: Final = 10 * NS_PER_S
_CHECK_FAILURE_SHARE: Final = 1e-3  # of the failure rate asked for: a search against what is held has to be surer
_CONTRADICTIONS: Final = 2


def update_epoch(
    node: TightNode, epoch: TightEpoch, rate_rad_s: Floats, settings: InertialSettings, rtk: RtkSettings
) -> TightNode:
    """The node after an epoch: ambiguities begun and ended, phases, range rates and (while some are unknown) codes."""
    done, doubted = _updated(node, epoch, rate_rad_s, settings, rtk)
    if doubted:
        return _begin_again(node, node.extra)
    if not _all_held(done.extra.arcs, epoch) or epoch.t_gps_ns - done.extra.t_checked_gps_ns < _CHECK_NS:
        return done
    return _checked(done, epoch, rate_rad_s, settings, rtk)


def _updated(
    node: TightNode, epoch: TightEpoch, rate_rad_s: Floats, settings: InertialSettings, rtk: RtkSettings
) -> tuple[TightNode, bool]:
    """The node after an epoch, and whether its integers are in doubt for too long."""
    arms = np.array(settings.lever_arms_body_m)
    extra = node.extra
    p, arcs = without(node.p, extra.arcs, ended(extra.arcs, epoch))
    interval_s = None if extra.t_gnss_gps_ns is None else (epoch.t_gps_ns - extra.t_gnss_gps_ns) / NS_PER_S
    if interval_s is not None:
        p = wandered(p, arcs, epoch, interval_s)
    h, z, h_rate, z_rate = design(node.nav, rate_rad_s, arms, epoch.origin_ecef_m, epoch.antenna, epoch.line)
    phase = epoch.phase_m - z
    p, arcs = begun(p, arcs, epoch, phase / epoch.wavelength_m)
    arcs = arcs.copy()
    at = matched(arcs["key"], epoch.key)
    phase = phase - epoch.wavelength_m * arcs["value"][at]
    use = _fitting(p, h, phase, arcs["held"][at], epoch, settings)
    young = arcs["count"][at] == 0
    refused = noted(arcs, at, use, np.isfinite(phase), epoch.lock_time_s, epoch.t_gps_ns)
    if int(use.sum()) < _LEAST_ROWS:
        doubts = extra.doubts + 1 if refused > _DOUBT_SHARE else 0
        return replace(node, p=p, extra=replace(extra, arcs=arcs, doubts=doubts)), doubts >= _DOUBT_LIMIT
    column = _columns(arcs, at)
    some_float = bool((column >= 0).any())
    variance = _variance(epoch, young, interval_s, settings)
    if some_float:
        variance[:, 1] *= _code_factor(p, h, epoch, epoch.code_m - z)
    kinds = [(0, h, phase, use, column), (2, h_rate, epoch.rate_m_s - z_rate, use, np.full_like(column, -1))]
    if some_float:
        kinds.append((1, h, epoch.code_m - z, use, np.full_like(column, -1)))
    normals = [
        normal_equations(d, v, np.ascontiguousarray(variance[:, kind]), epoch.link, epoch.group, rows & np.isfinite(v),
                         base_share(), columns, epoch.wavelength_m, p.shape[0])
        for kind, d, v, rows, columns in kinds
    ]  # fmt: skip
    information, right = np.sum([n[0] for n in normals], axis=0), np.sum([n[1] for n in normals], axis=0)
    x, p = informed(p, information, right)
    nav = node.nav.copy()
    feed_back(nav, p, x[:ERROR_SIZE], False)
    arcs["value"][~arcs["held"]] += x[ERROR_SIZE:]
    nis, degrees = float(sum(n[2] for n in normals) - right @ x), sum(n[3] for n in normals)
    doubts = extra.doubts + 1 if refused > _DOUBT_SHARE or nis > _DOUBT_NIS * degrees else 0
    extra = replace(
        extra, arcs=arcs, t_gnss_gps_ns=epoch.t_gps_ns, doubts=doubts, n_rows=int(use.sum()), nis=nis, degrees=degrees,
        n_satellites=int(np.unique(epoch.link[use] // SIGNAL_KEY).size),
    )  # fmt: skip
    done = _with_integers(Node(node.t_gps_ns, nav, p, extra), epoch, rtk)
    return done, doubts >= _DOUBT_LIMIT


def _variance(epoch: TightEpoch, young: Booleans, interval_s: float | None, settings: InertialSettings) -> Floats:
    """Variances (m, 3) of the epoch for errors that last: epochs closer than that say the same thing again.

    Of errors with the autocorrelation exp(−t/τ), a mean over a long time has the variance of white ones of
    ``(1 + 2 τ/Δt) σ²`` (Δt the interval of epochs). A code says all it has when its arc begins (``young``).
    """
    variance = epoch.variance.copy()
    if interval_s is not None:
        variance[:, 0] *= 1.0 + 2.0 * settings.phase_correlation_s / interval_s
        variance[:, 1] *= np.where(young, 1.0, 1.0 + 2.0 * _CODE_MEMORY_S / interval_s)
    return variance


def _code_factor(p: Floats, h: Floats, epoch: TightEpoch, code_m: Floats) -> float:
    """Variance factor of the codes, one at least: the median of their squares about their group, in expected ones."""
    there = np.isfinite(code_m)
    off = code_m - group_medians(epoch.group, code_m, there)
    known = np.isfinite(off)
    if known.sum() < _LEAST_ROWS:
        return 1.0
    expected = epoch.variance[:, 1] + np.einsum("ij,jk,ik->i", h, p[:ERROR_SIZE, :ERROR_SIZE], h)
    return max(float(np.median(off[known] ** 2 / expected[known])) / _CHI2_MEDIAN, 1.0)


def _fitting(
    p: Floats, h: Floats, phase: Floats, held: Booleans, epoch: TightEpoch, settings: InertialSettings
) -> Booleans:
    """Rows whose phase fits what is expected: held ones are compared with the median of their group."""
    fits: Booleans = fitting(
        np.ascontiguousarray(p[:ERROR_SIZE, :ERROR_SIZE]), h, phase, held, epoch.group,
        np.ascontiguousarray(epoch.variance[:, 0]), _SLIP_CYCLES * epoch.wavelength_m, settings.innovation_gate_sigma,
    )  # fmt: skip
    return fits


def _begin_again(node: TightNode, extra: TightExtra) -> TightNode:
    """Forget all ambiguities, and doubt the position."""
    p = node.p[:ERROR_SIZE, :ERROR_SIZE].copy()
    p[:3, :] = 0.0
    p[:, :3] = 0.0
    p[:3, :3] = _RESET_SIGMA_M**2 * np.eye(3)
    again = TightExtra(status=Status.CONVERGING, t_gnss_gps_ns=extra.t_gnss_gps_ns, t_fixed_gps_ns=extra.t_fixed_gps_ns)
    return replace(node, p=p, extra=again)


def _columns(arcs: Records, at: Ints) -> Ints:
    """State (m,) of each row's ambiguity, −1 where it is held."""
    place = np.full(arcs.size, -1)
    states = np.flatnonzero(~arcs["held"])
    place[states] = ERROR_SIZE + np.arange(states.size)
    return place[at]


def _with_integers(node: TightNode, epoch: TightEpoch, rtk: RtkSettings) -> TightNode:
    """The node with the integers held that have been confirmed by now, and its status."""
    extra, nav, p = node.extra, node.nav, node.p
    arcs, pending = extra.arcs, None
    if not arcs["held"].all():
        found = find(p, arcs, epoch, rtk, rtk.min_success_rate)
        pending = confirm(extra.pending, found, arcs, epoch.t_gps_ns)
        if found is not None and is_confirmed(pending, epoch.t_gps_ns):
            change, p, arcs = conditioned(p, arcs, found)
            nav, pending = nav.copy(), None
            feed_back(nav, p, change, False)
    fixed = _all_held(arcs, epoch)
    extra = replace(
        extra, arcs=arcs, pending=pending, status=Status.RTK_FIXED if fixed else _float_status(p),
        t_fixed_gps_ns=epoch.t_gps_ns if fixed else extra.t_fixed_gps_ns,
    )  # fmt: skip
    return Node(node.t_gps_ns, nav, p, extra)


def _float_status(p: Floats) -> Status:
    """What a position is without its integers: float where it is known to centimetres, else it is still on its way."""
    return Status.RTK_FLOAT if np.trace(p[:3, :3]) < _FLOAT_SIGMA_M**2 else Status.CONVERGING


def _checked(
    node: TightNode, epoch: TightEpoch, rate_rad_s: Floats, settings: InertialSettings, rtk: RtkSettings
) -> TightNode:
    """The node, its integers compared with a search over this epoch that knows nothing of them."""
    blank = _begin_again(node, TightExtra())
    free, _ = _updated(blank, epoch, rate_rad_s, settings, rtk)
    certain = 1.0 - _CHECK_FAILURE_SHARE * (1.0 - rtk.min_success_rate)
    found = find(free.p, free.extra.arcs, epoch, rtk, certain)
    extra = replace(node.extra, t_checked_gps_ns=epoch.t_gps_ns)
    if found is None:
        return replace(node, extra=extra)
    if not speaks_against(found, free.extra.arcs, extra.arcs):
        return replace(node, extra=replace(extra, contradictions=0))
    if extra.contradictions + 1 >= _CONTRADICTIONS:
        return _begin_again(node, extra)
    return replace(node, extra=replace(extra, contradictions=extra.contradictions + 1))


def _all_held(arcs: Records, epoch: TightEpoch) -> bool:
    """Whether enough of the epoch's ambiguities are integers for the position to rest on them."""
    held = arcs["held"][matched(arcs["key"], epoch.key)] if arcs.size else np.zeros(0, np.bool_)
    return int(held.sum()) >= 5 and float(held.mean()) > 0.5
