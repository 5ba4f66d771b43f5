"""The multirate filter's sample loop (Wang 2023, eqs 3-5), compiled.

State (9,): displacement m, velocity m/s, baseline m/s², each east, north, up. With I the 3 × 3 identity, A couples
equal axes only, so A P Aᵀ is done as row and column additions instead of matrix products.
"""

import math

import numpy as np
from numba import njit

from plumbline.records import Floats

OUTPUTS = 12  # columns of a row: displacement, velocity, acceleration, displacement variance, each ENU


@njit(cache=True)
def transition_covariance(p: Floats, t: float, drift_arm: float) -> None:
    """P ← A P Aᵀ in place, with A of eq. 3: d += t v − drift_arm t/2 u, v −= drift_arm u.

    ``drift_arm`` is t where an accelerometer's samples drive the state, 0 where the baseline has no part in it.
    """
    half = 0.5 * t * drift_arm
    for i in range(3):
        for j in range(9):
            p[i, j] += t * p[3 + i, j] - half * p[6 + i, j]
            p[3 + i, j] -= drift_arm * p[6 + i, j]
    for i in range(3):
        for j in range(9):
            p[j, i] += t * p[j, 3 + i] - half * p[j, 6 + i]
            p[j, 3 + i] -= drift_arm * p[j, 6 + i]


@njit(cache=True)
def add_process_noise(p: Floats, t: float, q_a: float, q_u: float) -> None:
    """P ← P + Q in place, Q of eq. 3."""
    for i in range(3):
        p[i, i] += t * t * t * q_a / 3.0
        p[i, 3 + i] += t * t * q_a / 2.0
        p[3 + i, i] += t * t * q_a / 2.0
        p[3 + i, 3 + i] += t * q_a
        p[6 + i, 6 + i] += t * q_u


@njit(cache=True)
def step_driven(x: Floats, p: Floats, acceleration: Floats, t: float, noise: Floats) -> None:
    """One step of ``t`` s in place, eqs 3-5, driven by an acceleration (3,) m/s² held through it.

    While it shakes, q_a grows by (``noise[1]`` × acceleration)², since gain and axis errors are in proportion to what a
    sensor feels, and q_u by (``noise[3]`` × acceleration)², since strong shaking tilts it (Boore 2001, BSSA 91(5)).
    """
    squared = 0.0
    for i in range(3):
        true = acceleration[i] - x[6 + i]
        squared += true * true
        x[i] += t * x[3 + i] + 0.5 * t * t * true
        x[3 + i] += t * true
    transition_covariance(p, t, t)
    add_process_noise(p, t, noise[0] + noise[1] ** 2 * squared, noise[2] + noise[3] ** 2 * squared)


@njit(cache=True)
def step_coasting(x: Floats, p: Floats, t: float, q_coasting: float, q_u: float) -> None:
    """One step of ``t`` s in place without a sample: uniform motion, the acceleration is noise of density
    ``q_coasting``.
    """
    for i in range(3):
        x[i] += t * x[3 + i]
    transition_covariance(p, t, 0.0)
    add_process_noise(p, t, q_coasting, q_u)


@njit(cache=True)
def propagate(
    x: Floats, p: Floats, last: Floats, samples: Floats, first_step_s: float, step_s: float, noise: Floats, out: Floats
) -> None:
    """Take ``x`` (9,), ``p`` (9, 9) and ``last`` (3,), in place, through ``samples`` (n, 3) m/s², NaN missing.

    The acceleration of a step is the mean of the samples at its ends (eq. 3's a_k; a sample held from its instant on
    would delay the motion by half a step). ``last`` is the sample before, at ``first_step_s`` before the first; a
    first step of 0 s moves nothing. ``noise`` (5,): q_a, shaking noise, q_u, shaking drift, q_coasting. ``out`` (n,
    12): a row after each step.
    """
    mean = np.empty(3)
    for k in range(samples.shape[0]):
        t = first_step_s if k == 0 else step_s
        has_sample = not math.isnan(samples[k, 0])
        if has_sample and t <= 1.5 * step_s:
            held = math.isnan(last[0])
            for i in range(3):
                mean[i] = samples[k, i] if held else 0.5 * (last[i] + samples[k, i])
            if t > 0.0:
                step_driven(x, p, mean, t, noise)
        else:
            step_coasting(x, p, t, noise[4], noise[2])
        for i in range(3):
            last[i] = samples[k, i]
            out[k, i] = x[i]
            out[k, 3 + i] = x[3 + i]
            out[k, 6 + i] = samples[k, i] - x[6 + i]
            out[k, 9 + i] = p[i, i]
