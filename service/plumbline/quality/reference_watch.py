"""Whether a reference station stands still: a two-sided CUSUM on its own precise position (Page 1954; Hawkins &
Olwell 1998, ch. 3).

``C⁺ ← max(0, C⁺ + z − k)`` and ``C⁻ ← max(0, C⁻ − z − k)`` of the standardised deviation z of each axis from the
position that it had; either beyond ``h`` says that it moves. With k = 1 and h = 6 a shift of two sigmas is found after
about seven samples. The allowance is wide because mean and sigma are learned, from ``_LEARNING`` samples, and not
known. Precise positions are correlated over minutes, so that samples are means over such spans.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from plumbline.records import Floats, Solution, Status

_ALLOWANCE: Final = 1.0  # k
_LIMIT: Final = 6.0  # h
_SPAN_NS: Final = 600_000_000_000  # of a sample: longer than precise positions are correlated
_LEAST_SIGMA_M: Final = 0.002
_LEARNING: Final = 36  # samples that the reference position and its scatter are learned from
_TRUSTED: Final = frozenset({Status.PPP_FLOAT, Status.PPP_FIXED})
_AXES: Final = ("east", "north", "up")


@dataclass(frozen=True, slots=True)
class Watch:
    """A reference station's sums, (3,) east, north, up each, as tuples: small and picklable."""

    t_span_gps_ns: int | None = None  # the running sample's begin
    total_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    count: int = 0
    learned: tuple[tuple[float, ...], ...] = ()
    upper: tuple[float, ...] = (0.0, 0.0, 0.0)
    lower: tuple[float, ...] = (0.0, 0.0, 0.0)
    moved: str = ""  # empty: it stands; else what it does, in words


def watch(state: Watch, solution: Solution) -> Watch:
    """Take one epoch of the reference station's own precise positioning."""
    if solution.status not in _TRUSTED or solution.displacement_enu_m is None:
        return state
    if state.t_span_gps_ns is None:
        state = replace(state, t_span_gps_ns=solution.t_gps_ns)
    assert state.t_span_gps_ns is not None
    if solution.t_gps_ns - state.t_span_gps_ns >= _SPAN_NS and state.count:
        sample = np.array(state.total_m) / state.count
        state = replace(_sampled(state, sample), t_span_gps_ns=solution.t_gps_ns, total_m=(0.0, 0.0, 0.0), count=0)
    total = np.array(state.total_m) + solution.displacement_enu_m
    return replace(state, total_m=tuple(total.tolist()), count=state.count + 1)


def _sampled(state: Watch, sample_m: Floats) -> Watch:
    """Learn from a sample, or judge it."""
    if len(state.learned) < _LEARNING:
        return replace(state, learned=(*state.learned, tuple(sample_m.tolist())))
    learned = np.array(state.learned)
    sigma = np.maximum(learned.std(axis=0, ddof=1), _LEAST_SIGMA_M)
    z = (sample_m - learned.mean(axis=0)) / sigma
    upper = np.maximum(0.0, np.array(state.upper) + z - _ALLOWANCE)
    lower = np.maximum(0.0, np.array(state.lower) - z - _ALLOWANCE)
    beyond = np.flatnonzero((upper > _LIMIT) | (lower > _LIMIT))
    words = ", ".join(f"{(sample_m - learned.mean(axis=0))[i] * 1e3:+.1f} mm {_AXES[i]}" for i in beyond)
    moved = f"the reference station has moved: {words}" if beyond.size else ""
    return replace(state, upper=tuple(upper.tolist()), lower=tuple(lower.tolist()), moved=moved)
