"""The loose filter's second product: states that also know what came after them.

Rauch, Tung & Striebel 1965 over the filter's own nodes, in the error state. Between two nodes the covariance is
propagated together with a copy of the first node's state that stands still (stochastic cloning, Roumeliotis & Burdick
2002), so the smoother's gain needs no transition of its own::

    A = cov(x_j, x_{j+1}⁻) (P_{j+1}⁻)⁻¹
    e_j = A (e_{j+1} + δ_{j+1})        P_j^s = P_j + A (P_{j+1}^s − P_{j+1}⁻) Aᵀ

with e what is still to be added to the filtered state, and δ what the filter added to its prediction at a node.
Between nodes the samples are run again from the smoothed state.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from plumbline.config import InertialSettings
from plumbline.fusion.error_model import feed_back
from plumbline.fusion.inertial_run import ROW_SIZE, advance
from plumbline.fusion.loose_clock import CLOCK_OFFSET, CLOCKED_SIZE, clock_transition, corrected
from plumbline.fusion.loose_state import LooseNode
from plumbline.fusion.noise import noise_row
from plumbline.fusion.rotations import rotation_log
from plumbline.fusion.strapdown import ERROR_SIZE, curvature_radii_m
from plumbline.fusion.timeline import Rows, no_rows
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, Ints


@dataclass(frozen=True, slots=True)
class _Step:
    """From a node to the next: what was predicted there, and how it hangs together with the node."""

    predicted: Floats  # (n, n) covariance P⁻
    joint: Floats  # (n, n) cov(x_j, x_{j+1}⁻)
    added: Floats  # (n,) δ


def smoothed(
    nodes: Sequence[LooseNode], t_gps_ns: Ints, samples: Floats, settings: InertialSettings
) -> list[LooseNode]:
    """The filter's nodes, ascending, with all later ones known to each; the last is as it was.

    ``t_gps_ns`` (m,) and ``samples`` (m, 6) cover the nodes' time.
    """
    noise = noise_row(settings)
    steps = [
        _step(first, second, *_between(first, second, t_gps_ns, samples), noise, settings)
        for first, second in pairwise(nodes)
    ]
    out = [nodes[-1]]
    error, covariance = np.zeros(len(nodes[-1].p)), nodes[-1].p
    for node, step in zip(reversed(nodes[:-1]), reversed(steps), strict=True):
        gain = _gain(step)
        error = gain @ (error + step.added)
        covariance = node.p + gain @ (covariance - step.predicted) @ gain.T
        out.append(_moved(node, error, covariance))
    return out[::-1]


def rows_between(nodes: Sequence[LooseNode], t_gps_ns: Ints, samples: Floats, settings: InertialSettings) -> list[Rows]:
    """Rows of the samples between smoothed nodes: each stretch is run from its first node. One entry a stretch."""
    noise, out = noise_row(settings), []
    for first, second in pairwise(nodes):
        t_ns, part = _between(first, second, t_gps_ns, samples)
        row_t, rows = np.empty(t_ns.size, np.int64), np.empty((t_ns.size, ROW_SIZE))
        p = first.p[:ERROR_SIZE, :ERROR_SIZE].copy()
        n = advance(
            first.nav.copy(), p, first.t_gps_ns, second.t_gps_ns, t_ns, part, noise, True, row_t, rows
        ) if t_ns.size else 0  # fmt: skip
        out.append(Rows(row_t[:n], rows[:n]) if n else no_rows())
    return out


def _between(first: LooseNode, second: LooseNode, t_gps_ns: Ints, samples: Floats) -> tuple[Ints, Floats]:
    """Samples from two before a node to one after the next, as the filter takes them."""
    begin = max(int(np.searchsorted(t_gps_ns, first.t_gps_ns + 1)) - 2, 0)
    end = int(np.searchsorted(t_gps_ns, second.t_gps_ns)) + 1
    return t_gps_ns[begin:end], samples[begin:end]


def _step(
    first: LooseNode, second: LooseNode, t_ns: Ints, samples: Floats, noise: Floats, settings: InertialSettings
) -> _Step:
    n, nav = len(first.p), first.nav.copy()
    both = np.tile(first.p, (2, 2))
    advance(
        nav, both, first.t_gps_ns, second.t_gps_ns, t_ns, samples, noise, True,
        np.empty(t_ns.size, np.int64), np.empty((t_ns.size, ROW_SIZE)),
    )  # fmt: skip
    predicted, joint = both[:n, :n], both[n:, :n]
    added = np.zeros(n)
    added[:ERROR_SIZE] = _difference(nav, second.nav)
    before, after = first.extra.clock, second.extra.clock
    if before is not None and after is not None:
        since_s = (after.t_gps_ns - before.t_gps_ns) / NS_PER_S
        transition = clock_transition(first.p, since_s)
        predicted, joint = transition @ predicted @ transition.T, joint @ transition.T
        predicted[CLOCK_OFFSET, CLOCK_OFFSET] += settings.inertial_time_walk_s_sqrt_s**2 * since_s
        added[CLOCK_OFFSET:] = after.offset_s - before.offset_at(after.t_gps_ns), after.drift - before.drift
    return _Step(predicted, joint, added)


def _difference(nav: Floats, other: Floats) -> Floats:
    """Error state (15,) that moves one state (21,) to another near by."""
    meridian, across = curvature_radii_m(nav[0])
    out = np.empty(ERROR_SIZE)
    out[0] = (other[1] - nav[1]) * (across + nav[2]) * np.cos(nav[0])
    out[1] = (other[0] - nav[0]) * (meridian + nav[2])
    out[2] = other[2] - nav[2]
    out[3:6] = other[3:6] - nav[3:6]
    out[6:9] = rotation_log(np.ascontiguousarray(other[6:15].reshape(3, 3) @ nav[6:15].reshape(3, 3).T))
    out[9:15] = other[15:21] - nav[15:21]
    return out


def _gain(step: _Step) -> Floats:
    """``joint predicted⁻¹``, the units taken out first."""
    scale = 1.0 / np.sqrt(np.diag(step.predicted))
    solved = np.linalg.solve(step.predicted * np.outer(scale, scale), (step.joint * scale).T).T
    gain: Floats = solved * scale
    return gain


def _moved(node: LooseNode, error: Floats, covariance: Floats) -> LooseNode:
    nav = node.nav.copy()
    feed_back(nav, np.eye(ERROR_SIZE), error[:ERROR_SIZE], True)
    clock = corrected(node.extra.clock, error) if len(error) == CLOCKED_SIZE else None
    return replace(node, nav=nav, p=0.5 * (covariance + covariance.T), extra=replace(node.extra, clock=clock))
