"""What a static record says of an inertial sensor's noise: Allan deviation, and the filters' parameters read from it.

The overlapping Allan deviation comes from `allantools`. On its curve (IEEE Std 952-1997, annex C): white noise of
density N falls as ``N / √τ``; the flicker floor is ``0.664 B`` with the bias instability B; a rate random walk K rises
as ``K √(τ/3)``. The filters model the bias as a first-order Gauss-Markov process, whose Allan deviation has its top of
``0.618 σ`` near ``1.89 T``: σ and T are taken from the top that follows the floor, or where none does from the floor.
"""

from dataclasses import dataclass
from typing import Final

import allantools
import numpy as np

from plumbline.errors import ContractError
from plumbline.records import Floats

_FLICKER: Final = 0.6642824703  # √(2 ln 2 / π)
_MARKOV_TOP: Final = 0.618
_MARKOV_PLACE: Final = 1.89
_RISE: Final = 1.25  # more than the scatter of a deviation from some tens of clusters
_LEAST_SAMPLES: Final = 1000
_LEAST_CLUSTERS: Final = 9  # averages that a deviation rests on, at least


@dataclass(frozen=True, slots=True)
class AllanCurve:
    """Overlapping Allan deviation of axes."""

    tau_s: Floats  # (k,)
    deviation: Floats  # (k, c), the samples' unit


@dataclass(frozen=True, slots=True)
class Characteristics:
    """Noise parameters of axes (c,), SI; ``at_most`` where the curve still falls at its end: the floor is below."""

    density: Floats  # two-sided white noise, unit/√Hz: numerically the random walk in unit·√s
    instability: Floats  # B
    instability_at_s: Floats  # τ of the floor
    at_most: "np.ndarray[tuple[int], np.dtype[np.bool_]]"
    markov_sigma: Floats
    markov_time_s: Floats


def allan_curve(samples: Floats, rate_hz: float) -> AllanCurve:
    """Curve of samples (n, c) at an even rate, at some sixty intervals up to a ninth of the record.

    Raises ContractError for fewer than 1000 samples or missing ones.
    """
    n = len(samples)
    if n < _LEAST_SAMPLES or not np.isfinite(samples).all():
        raise ContractError(f"an Allan deviation wants {_LEAST_SAMPLES} samples without gaps")
    counts = np.unique(np.geomspace(1, n // _LEAST_CLUSTERS, 60).astype(int))
    columns = []
    for axis in samples.T:
        tau, deviation, _, _ = allantools.oadev(axis, rate=rate_hz, data_type="freq", taus=counts / rate_hz)
        columns.append(deviation)
    return AllanCurve(np.asarray(tau, float), np.column_stack(columns))


def characteristics_of(curve: AllanCurve) -> Characteristics:
    """Parameters read from a curve, axis by axis."""
    found = [_axis(curve.tau_s, deviation) for deviation in curve.deviation.T]
    density, floor, place, ends, top, top_place = (np.array(column) for column in zip(*found, strict=True))
    return Characteristics(
        density=density,
        instability=floor / _FLICKER,
        instability_at_s=place,
        at_most=ends.astype(np.bool_),
        markov_sigma=top / _MARKOV_TOP,
        markov_time_s=top_place / _MARKOV_PLACE,
    )


def _axis(tau: Floats, deviation: Floats) -> tuple[float, float, float, bool, float, float]:
    """White noise density, floor, its τ, whether the curve still falls at its end, top after the floor, its τ."""
    first = int(np.argmax(deviation[: tau.size // 2]))  # a sensor's own low-pass filter makes the curve rise at first
    lowest = _floor(deviation, first)
    slope = np.gradient(np.log(deviation), np.log(tau))
    index = np.arange(tau.size)
    white = np.flatnonzero((np.abs(slope + 0.5) < 0.12) & (index >= first) & (index <= lowest))
    part = white if white.size else np.arange(first, min(first + 3, tau.size))
    density = float(np.median(deviation[part] * np.sqrt(tau[part])))
    top = lowest + int(np.argmax(deviation[lowest:]))
    ends = lowest >= tau.size - 2
    return density, float(deviation[lowest]), float(tau[lowest]), ends, float(deviation[top]), float(tau[top])


def _floor(deviation: Floats, first: int) -> int:
    """Where the curve is lowest before it rises again by more than chance."""
    best = first
    for k in range(first, deviation.size):
        if deviation[k] < deviation[best]:
            best = k
        elif deviation[k] > _RISE * deviation[best]:
            break
    return best
