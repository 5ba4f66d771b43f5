"""Who is wrong where GNSS and accelerometer contradict each other: detection, identification, adaptation.

A motion that the accelerometer feels is in the prediction, so a solution that is off its prediction is an error of one
of the two. *Detection* is the global test of the innovation, ``vᵀ S⁻¹ v`` (χ² of three degrees of freedom) against the
square of the gate. The alternatives, and what becomes of each:

* an outlier of GNSS: off once; the solution is refused;
* an accelerometer's fault since the last solution: samples that spike, stick or clip, where the sensor did none of it
  before, and without which the solution fits; they are taken as missing, which widens the state;
* a lasting error: solutions stay off. If the misfit stays alike GNSS has jumped, unfelt by the accelerometer; if it
  grows, the accelerometer's samples drift. Either way the filter starts anew from the solution and says which it was.

The minimal detectable bias is the error of one component that the gate finds with the power stated.
"""

from dataclasses import replace
from enum import StrEnum
from functools import lru_cache
from typing import Final

import numpy as np
from scipy.optimize import brentq
from scipy.stats import ncx2, norm

from plumbline.fusion.state import Second
from plumbline.gps_time import NS_PER_S
from plumbline.records import Booleans, Floats

_AXES: Final = 3
_WIDE_SIGMA: Final = 30.0  # beyond it the error's own direction decides alone
_FLAT: Final = 5  # samples alike in a row: sensors have noise
_ALIKE_M_S2: Final = 1e-9
_SPIKE_SCATTERS: Final = 12.0  # of the deviations from neighbours' medians
_SPIKE_LEAST_M_S2: Final = 0.2
_BEFORE: Final = 5  # seconds in which the sensor must have been innocent of sticking


class Cause(StrEnum):
    """Why a solution did not fit its prediction."""

    NONE = ""
    OUTLIER = "gnss_outlier"
    SPIKE = "accelerometer_spike"
    STUCK = "accelerometer_stuck_or_clipped"
    JUMP = "gnss_jump_unfelt"
    DRIFT = "accelerometer_drift"


@lru_cache(maxsize=64)
def root_noncentrality(gate_sigma: float, power: float) -> float:
    """Size of an error, in sigmas of its own estimate, that the gate finds with a power (ncx², three dimensions)."""
    if gate_sigma > _WIDE_SIGMA:
        return float(gate_sigma + norm.ppf(power))
    missed = lambda root: ncx2.sf(gate_sigma**2, _AXES, root**2) - power  # noqa: E731
    return float(brentq(missed, 1e-3, gate_sigma + 10.0))


def spikes(samples: Floats) -> Booleans:
    """Samples (n, 3) that stand alone: far from the median of their neighbours on an axis, NaN missing, (n,)."""
    n = len(samples)
    if n < 2 * _FLAT:
        return np.zeros(n, np.bool_)
    padded = np.pad(samples, ((2, 2), (0, 0)), mode="edge")
    neighbours = np.stack([padded[k : k + n] for k in (0, 1, 3, 4)])
    with np.errstate(invalid="ignore"):
        away = np.abs(samples - np.median(neighbours, axis=0))
        limit = np.maximum(_SPIKE_SCATTERS * np.nan_to_num(np.nanmedian(away, axis=0)), _SPIKE_LEAST_M_S2)
        found: Booleans = (away > limit).any(axis=1)
    return found


def flat(samples: Floats, rotation_enu_from_sensor: Floats) -> Booleans:
    """Samples (n, 3), ENU, in runs that are alike on a sensor axis: it sticks or is clipped, (n,)."""
    n, found = len(samples), np.zeros(len(samples), np.bool_)
    if n < _FLAT:
        return found
    sensor = samples @ rotation_enu_from_sensor
    with np.errstate(invalid="ignore"):
        same = np.abs(np.diff(sensor, axis=0)) < _ALIKE_M_S2
    for axis in range(_AXES):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], same[:, axis].view(np.int8), [0]])))
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            if last - first + 1 >= _FLAT:
                found[first : last + 1] = True
    return found


def without_faults(
    seconds: tuple[Second, ...], since_ns: int, until_ns: int, rotation_enu_from_sensor: Floats
) -> tuple[tuple[Second, ...], Cause, int, int]:
    """Seconds with the samples between two times that look like a fault taken as missing.

    Returns also what kind of fault, how many samples, and the first second that changed; no fault: nothing.
    """
    at = [i for i, s in enumerate(seconds) if s.second >= since_ns // NS_PER_S and s.second * NS_PER_S <= until_ns]
    if not at or any(
        flat(s.acceleration_m_s2, rotation_enu_from_sensor).any() for s in seconds[max(at[0] - _BEFORE, 0) : at[0]]
    ):
        return seconds, Cause.NONE, 0, 0
    changed, n, first, cause = list(seconds), 0, 0, Cause.NONE
    for i in at:
        samples = seconds[i].acceleration_m_s2
        stuck, spike = flat(samples, rotation_enu_from_sensor), spikes(samples)
        bad = (stuck | spike) & ~np.isnan(samples).any(axis=1)
        if bad.any():
            kept = samples.copy()
            kept[bad] = np.nan
            changed[i] = replace(seconds[i], acceleration_m_s2=kept)
            first = seconds[i].second if n == 0 else first
            n += int(np.count_nonzero(bad))
            cause = Cause.STUCK if (stuck & bad).any() or cause is Cause.STUCK else Cause.SPIKE
    return tuple(changed), cause, n, first


def lasting_cause(t_before_ns: int, off: tuple[tuple[int, Floats], ...]) -> Cause:
    """Jump or drift, of misfits (time, (3,) m) in a row since the last solution that fitted, by least squares."""
    if len(off) < 2:
        return Cause.JUMP
    t_s = np.array([(t - t_before_ns) / NS_PER_S for t, _ in off])
    v = np.array([misfit for _, misfit in off])
    left = [v - np.outer(shape, shape @ v / (shape @ shape)) for shape in (np.ones_like(t_s), t_s, t_s**2)]
    squares = [float(np.sum(one**2)) for one in left]
    return Cause.JUMP if squares[0] <= min(squares[1:]) else Cause.DRIFT
