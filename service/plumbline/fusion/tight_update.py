"""One epoch of the platform's antennas in the tight filter."""

from dataclasses import replace
from typing import Final

import numpy as np

from plumbline.config import InertialSettings, RtkSettings
from plumbline.estimation.ambiguity import resolve
from plumbline.fusion.error_model import feed_back
from plumbline.fusion.strapdown import ERROR_SIZE
from plumbline.fusion.tight_arcs import TightExtra, begun, ended, matched, without
from plumbline.fusion.tight_kernels import design, differences, group_medians, informed, references, whitened
from plumbline.fusion.tight_observations import SIGNAL_KEY, TightEpoch, base_share
from plumbline.fusion.timeline import Node
from plumbline.gps_time import NS_PER_S
from plumbline.positioning.state import Records
from plumbline.records import Booleans, Floats, Ints, Status

TightNode = Node[TightExtra]

_LEAST_ROWS: Final = 4
_DOUBT_SHARE: Final = 0.4  # of the held phases that do not fit
_DOUBT_LIMIT: Final = 10
_RESET_SIGMA_M: Final = 3.0
_MOST_SETS: Final = 6  # of ambiguities tried at an epoch
_SLIP_CYCLES: Final = 0.4  # off by so much, a held phase is refused however unsure the prediction is


def update_epoch(
    node: TightNode, epoch: TightEpoch, rate_rad_s: Floats, settings: InertialSettings, rtk: RtkSettings
) -> TightNode:
    """The node after an epoch: ambiguities begun and ended, phases, range rates and (while some are unknown) codes."""
    arms = np.array(settings.lever_arms_body_m)
    extra = node.extra
    p, arcs = without(node.p.copy(), extra.arcs, ended(extra.arcs, epoch))
    h, z, h_rate, z_rate = design(node.nav, rate_rad_s, arms, epoch.origin_ecef_m, epoch.antenna, epoch.line)
    phase = epoch.phase_m - z
    p, arcs = begun(p, arcs, epoch, phase / epoch.wavelength_m)
    at = matched(arcs, epoch.key)
    phase = phase - epoch.wavelength_m * arcs["value"][at]
    use = _fitting(p, h, phase, arcs, at, epoch, settings)
    arcs, doubts = _noted(arcs.copy(), at, use, epoch, extra.doubts)
    if doubts >= _DOUBT_LIMIT:
        return _begin_again(node, extra)
    if int(use.sum()) < _LEAST_ROWS:
        return replace(node, p=p, extra=replace(extra, arcs=arcs, doubts=doubts))
    full, place = _with_ambiguities(h, arcs, at, epoch.wavelength_m)
    weighed = _decorrelated(epoch, extra.t_gnss_gps_ns, settings)
    blocks = [_block(full, phase, use, weighed, arcs["held"][at], 0)]
    rate_v = epoch.rate_m_s - z_rate
    wide = np.zeros_like(full)
    wide[:, :ERROR_SIZE] = h_rate
    blocks.append(_block(wide, rate_v, use & np.isfinite(rate_v), epoch, arcs["held"][at], 2))
    if place:
        code = np.zeros_like(full)
        code[:, :ERROR_SIZE] = h
        code_v = epoch.code_m - z
        blocks.append(_block(code, code_v, use & np.isfinite(code_v), epoch, arcs["held"][at], 1))
    nav, p, arcs = _applied(node.nav.copy(), p, arcs, blocks)
    if place:
        nav, p, arcs = _resolved(nav, p, arcs, rtk)
    status = Status.RTK_FIXED if _all_held(arcs, epoch) else Status.RTK_FLOAT
    n_satellites = int(np.unique(epoch.link[use] // SIGNAL_KEY).size)
    nis = float(sum(v @ v for _, v in blocks)) if not place else np.nan
    degrees = sum(v.size for _, v in blocks)
    extra = TightExtra(arcs, status, epoch.t_gps_ns, doubts, n_satellites, int(use.sum()), nis, degrees)
    return Node(node.t_gps_ns, nav, p, extra)


def _decorrelated(epoch: TightEpoch, t_last_ns: int | None, settings: InertialSettings) -> TightEpoch:
    """The epoch with phase variances for errors that last: epochs closer than that say the same thing again.

    Of errors with the autocorrelation exp(−t/τ), a mean over a long time has the variance of white ones of
    ``(1 + 2 τ/Δt) σ²`` (Δt the interval of epochs).
    """
    if settings.phase_correlation_s == 0.0 or t_last_ns is None:
        return epoch
    interval_s = max((epoch.t_gps_ns - t_last_ns) / NS_PER_S, 1e-3)
    variance = epoch.variance.copy()
    variance[:, 0] *= 1.0 + 2.0 * settings.phase_correlation_s / interval_s
    return replace(epoch, variance=variance)


def _fitting(
    p: Floats, h: Floats, phase: Floats, arcs: Records, at: Ints, epoch: TightEpoch, settings: InertialSettings
) -> Booleans:
    """Rows whose phase fits what is expected: held ones are compared with the median of their group."""
    there = np.isfinite(phase)
    held = arcs["held"][at] & there
    middle = group_medians(epoch.group, phase, held)
    spread = np.sqrt(np.einsum("ij,jk,ik->i", h, p[:ERROR_SIZE, :ERROR_SIZE], h) + epoch.variance[:, 0])
    limit = np.minimum(settings.innovation_gate_sigma * spread, _SLIP_CYCLES * epoch.wavelength_m)
    with np.errstate(invalid="ignore"):
        off = held & (np.abs(phase - middle) > limit)
    fits: Booleans = there & ~off
    return fits


def _noted(arcs: Records, at: Ints, use: Booleans, epoch: TightEpoch, doubts: int) -> tuple[Records, int]:
    """Arcs with the epoch noted, and how many epochs in a row spoke against most of the integers."""
    used, refused = at[use], at[~use & np.isfinite(epoch.phase_m)]
    arcs["count"][used] += 1
    arcs["refused"][used] = 0
    arcs["refused"][refused] += 1
    arcs["t_last_ns"][at] = epoch.t_gps_ns
    arcs["lock_time_s"][at] = epoch.lock_time_s
    held = arcs["held"][at]
    share = float((held & ~use).sum()) / max(int(held.sum()), 1)
    return arcs, doubts + 1 if share > _DOUBT_SHARE else 0


def _begin_again(node: TightNode, extra: TightExtra) -> TightNode:
    """Forget all ambiguities, and doubt the position."""
    p = node.p[:ERROR_SIZE, :ERROR_SIZE].copy()
    p[:3, :] = 0.0
    p[:, :3] = 0.0
    p[:3, :3] = _RESET_SIGMA_M**2 * np.eye(3)
    return replace(node, p=p, extra=TightExtra(status=Status.RTK_FLOAT, t_gnss_gps_ns=extra.t_gnss_gps_ns))


def _with_ambiguities(h: Floats, arcs: Records, at: Ints, wavelength_m: Floats) -> tuple[Floats, bool]:
    """Design (m, 15 + states) with each row's ambiguity where that is a state; and whether any is."""
    states = np.flatnonzero(~arcs["held"])
    if not states.size:
        return h, False
    place = np.full(arcs.size, -1)
    place[states] = ERROR_SIZE + np.arange(states.size)
    full = np.zeros((h.shape[0], ERROR_SIZE + states.size))
    full[:, :ERROR_SIZE] = h
    column = place[at]
    rows = np.flatnonzero(column >= 0)
    full[rows, column[rows]] = wavelength_m[rows]
    return full, True


def _block(h: Floats, v: Floats, use: Booleans, epoch: TightEpoch, held: Booleans, kind: int) -> tuple[Floats, Floats]:
    """Whitened differences of one kind: 0 phase, 1 code, 2 range rate."""
    reference = references(epoch.group, epoch.sine, use, held)
    variance = np.ascontiguousarray(epoch.variance[:, kind])
    dd_h, dd_v, r = differences(h, v, reference, variance, epoch.link, base_share())
    white_h, white_v, regular = whitened(dd_h, dd_v, r)
    return (white_h, white_v) if regular else (np.zeros((0, h.shape[1])), np.zeros(0))


def _applied(
    nav: Floats, p: Floats, arcs: Records, blocks: list[tuple[Floats, Floats]]
) -> tuple[Floats, Floats, Records]:
    """State, covariance and arcs after whitened observations."""
    h, v = np.concatenate([b[0] for b in blocks]), np.concatenate([b[1] for b in blocks])
    x, p = informed(p, h, v)
    feed_back(nav, p, x[:ERROR_SIZE], False)
    arcs["value"][~arcs["held"]] += x[ERROR_SIZE:]
    return nav, p, arcs


def _resolved(nav: Floats, p: Floats, arcs: Records, rtk: RtkSettings) -> tuple[Floats, Floats, Records]:
    """State, covariance and arcs with the ambiguities resolved that can be: the largest of the nested sets tried.

    Sets grow with the variance of what they add, so multipath near the horizon does not stand in the way of the rest.
    """
    states = np.flatnonzero(~arcs["held"])
    wanted = np.flatnonzero(arcs["integer"][states])
    variance = np.diag(p)[ERROR_SIZE + wanted]
    wanted = wanted[np.argsort(variance, kind="stable")]
    for size in _set_sizes(wanted.size):
        chosen = np.sort(wanted[:size])
        at = ERROR_SIZE + chosen
        values = arcs["value"][states[chosen]]
        found = resolve(values, p[np.ix_(at, at)], rtk.min_ratio, rtk.min_success_rate, partial=False)
        if found.complete:
            return _held(nav, p, arcs, states[chosen], at, found.integers.astype(float) - values, found.integers)
    return nav, p, arcs


def _set_sizes(n: int) -> list[int]:
    """Sizes of the sets tried, falling by a quarter."""
    sizes = []
    while n > 0:
        sizes.append(n)
        n = min(n - 1, (3 * n) // 4)
    return sizes[:_MOST_SETS]


def _held(
    nav: Floats, p: Floats, arcs: Records, which: Ints, at: Ints, change: Floats, integers: Ints
) -> tuple[Floats, Floats, Records]:
    """Condition everything else on integers, and take them out of the state."""
    rest = np.setdiff1d(np.arange(p.shape[0]), at)
    gain = np.linalg.solve(p[np.ix_(at, at)], p[np.ix_(at, rest)]).T
    moved = gain @ change
    left = p[np.ix_(rest, rest)] - gain @ p[np.ix_(at, rest)]
    left = np.ascontiguousarray(0.5 * (left + left.T))
    arcs = arcs.copy()
    remaining = np.setdiff1d(np.flatnonzero(~arcs["held"]), which)
    arcs["value"][remaining] += moved[ERROR_SIZE:]
    arcs["value"][which], arcs["held"][which] = integers, True
    feed_back(nav, left, moved[:ERROR_SIZE].copy(), False)
    return nav, left, arcs


def _all_held(arcs: Records, epoch: TightEpoch) -> bool:
    """Whether enough of the epoch's ambiguities are integers for the position to rest on them."""
    held = arcs["held"][matched(arcs, epoch.key)] if arcs.size else np.zeros(0, np.bool_)
    return int(held.sum()) >= 5 and float(held.mean()) > 0.5
