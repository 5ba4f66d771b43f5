"""Takes the navigation state and its covariance through the samples up to a time, compiled.

Between two samples the force and the rate are taken as linear, so a step uses their value in its middle, and a step may
begin or end anywhere: at a measurement's own time.
"""

from typing import Final

import numpy as np
from numba import njit

from plumbline.fusion.error_model import (
    add_process_noise,
    propagate_covariance,
    rates_ecef,
    rates_local,
    transition_of,
)
from plumbline.fusion.strapdown import step_ecef, step_local
from plumbline.records import Floats, Ints

# Columns of a row: the state, the covariances of position, velocity and attitude (3 × 3 each), the acceleration.
ROW_NAV: Final = 0
ROW_POSITION_COVARIANCE: Final = 21
ROW_VELOCITY_COVARIANCE: Final = 30
ROW_ATTITUDE_COVARIANCE: Final = 39
ROW_ACCELERATION: Final = 48
ROW_SIZE: Final = 51
_GAP_FACTOR: Final = 3  # a step of so many sample intervals is a gap


@njit(cache=True)
def write_row(nav: Floats, p: Floats, acceleration: Floats, row: Floats) -> None:
    """Fill a row (51,) from the state."""
    row[0:21] = nav
    for block in range(3):
        for i in range(3):
            for j in range(3):
                row[21 + 9 * block + 3 * i + j] = p[3 * block + i, 3 * block + j]
    row[48:51] = acceleration


@njit(cache=True)
def sample_at(t_ns: Ints, samples: Floats, index: int, time_ns: int, out: Floats) -> None:
    """Sample (6,) at a time between the stamps ``index − 1`` and ``index``, linear; held before the first."""
    if index == 0:
        out[:] = samples[0]
        return
    span = t_ns[index] - t_ns[index - 1]
    share = (time_ns - t_ns[index - 1]) / span
    for i in range(6):
        out[i] = samples[index - 1, i] + share * (samples[index, i] - samples[index - 1, i])


@njit(cache=True)
def _step(
    nav: Floats, p: Floats, sample: Floats, step_s: float, noise: Floats, gap: bool, local: bool, acceleration: Floats
) -> None:
    force, rate = sample[0:3], sample[3:6]
    f = rates_local(nav, force, noise) if local else rates_ecef(nav, force, noise)
    propagate_covariance(p, transition_of(f, step_s))
    if local:
        step_local(nav, force, rate, step_s, acceleration)
    else:
        step_ecef(nav, force, rate, step_s, acceleration)
    for i in range(6):
        nav[15 + i] *= np.exp(-step_s / (noise[3] if i < 3 else noise[5]))
    shaking = np.sqrt(acceleration[0] ** 2 + acceleration[1] ** 2 + acceleration[2] ** 2)
    turning = np.sqrt(rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2)
    add_process_noise(p, noise, shaking, turning, step_s, gap)


@njit(cache=True)
def advance(
    nav: Floats,
    p: Floats,
    from_ns: int,
    to_ns: int,
    t_ns: Ints,
    samples: Floats,
    noise: Floats,
    local: bool,
    row_t_ns: Ints,
    rows: Floats,
) -> int:
    """Take ``nav`` (21,) and ``p`` (n, n), in place, from one time to another that is not after the last sample.

    ``t_ns`` (m,) ascending and ``samples`` (m, 6): specific force m/s², rate rad/s, body axes, NaN nowhere. ``noise``
    (9,), see :mod:`plumbline.fusion.error_model`. A row is written for each sample passed, and counted.
    """
    sample, acceleration = np.empty(6), np.zeros(3)
    index = int(np.searchsorted(t_ns, from_ns + 1))
    usual_ns = (t_ns[-1] - t_ns[0]) / max(t_ns.size - 1, 1)
    now_ns, n_rows = from_ns, 0
    while now_ns < to_ns and index < t_ns.size:
        end_ns = min(to_ns, t_ns[index])
        sample_at(t_ns, samples, index, now_ns + (end_ns - now_ns) // 2, sample)
        gap = bool(index > 0 and t_ns[index] - t_ns[index - 1] > _GAP_FACTOR * usual_ns)
        _step(nav, p, sample, (end_ns - now_ns) * 1e-9, noise, gap, local, acceleration)
        now_ns = end_ns
        if now_ns == t_ns[index]:
            row_t_ns[n_rows] = now_ns
            write_row(nav, p, acceleration, rows[n_rows])
            n_rows += 1
            index += 1
    return n_rows
