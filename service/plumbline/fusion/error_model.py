"""How the error state of :mod:`plumbline.fusion.strapdown` moves, and how its estimate is fed back.

Continuous model ``δẋ = F δx + G w`` (Dai 2024, eq. 13), Earth-fixed::

    δṙ = δv
    δv̇ = F_vp δr − 2 [ω_ie×] δv − [(C f)×] ψ − C δb_a − C n_a
    ψ̇  = −[ω_ie×] ψ − C δb_g − C n_g
    δḃ = −δb / T + n_b                                             (first-order Gauss-Markov)

and the same in the local frame with the transport rate and its partials. Signs follow from ``C_true = (I + [ψ×]) C``
and biases that are subtracted (Dai 2024, eq. 15, has the opposite ψ, and prints F_ba where the gyroscope's F_bg
belongs). ``F_vp`` is the gradient of gravitation of a point mass and of the centrifugal acceleration; Dai's eq. 16
keeps its radial part. A step's transition is ``I + F τ + (F τ)²/2``, checked against differences of the
mechanisation itself.
"""

import math
from typing import Final

import numpy as np
from numba import njit

from plumbline.constants import EARTH_GM_GALILEO_M3_S2, EARTH_ROTATION_RATE_RAD_S
from plumbline.fusion.rotations import multiply, orthonormalise, rotation_exp, turned
from plumbline.fusion.strapdown import (
    curvature_radii_m,
    earth_rate_local_rad_s,
    transport_rate_local_rad_s,
)
from plumbline.records import Floats

_GM: Final = EARTH_GM_GALILEO_M3_S2
_RATE: Final = EARTH_ROTATION_RATE_RAD_S

# Columns of a noise row: densities m/s²/√Hz and rad/s/√Hz, then sigma and correlation time of each bias.
NOISE_SIZE: Final = 9
ACCELEROMETER_DENSITY: Final = 0
GYROSCOPE_DENSITY: Final = 1
ACCELEROMETER_BIAS_SIGMA: Final = 2
ACCELEROMETER_BIAS_TIME: Final = 3
GYROSCOPE_BIAS_SIGMA: Final = 4
GYROSCOPE_BIAS_TIME: Final = 5
SHAKING_FORCE: Final = 6  # √s: times the acceleration, added to the accelerometer's density: gain and axis errors
SHAKING_RATE: Final = 7  # √s: times the rate, added to the gyroscope's density
GAP_ACCELERATION: Final = 8  # m/s²/√Hz, added while samples are missing


@njit(cache=True)
def add_skew(f: Floats, row: int, column: int, a: Floats, factor: float) -> None:
    """Add ``factor [a×]`` to the block of ``f`` that begins at (row, column)."""
    f[row, column + 1] -= factor * a[2]
    f[row, column + 2] += factor * a[1]
    f[row + 1, column] += factor * a[2]
    f[row + 1, column + 2] -= factor * a[0]
    f[row + 2, column] -= factor * a[1]
    f[row + 2, column + 1] += factor * a[0]


@njit(cache=True)
def _common_blocks(f: Floats, rotation: Floats, force_frame: Floats, noise: Floats) -> None:
    """What both frames share: δv̇ by ψ and δb_a, ψ̇ by δb_g, and the decay of the biases."""
    add_skew(f, 3, 6, force_frame, -1.0)
    for i in range(3):
        for j in range(3):
            f[3 + i, 9 + j] = -rotation[i, j]
            f[6 + i, 12 + j] = -rotation[i, j]
        f[9 + i, 9 + i] = -1.0 / noise[3]
        f[12 + i, 12 + i] = -1.0 / noise[5]


@njit(cache=True)
def rates_ecef(nav: Floats, force_m_s2: Floats, noise: Floats) -> Floats:
    """F (15, 15) of the Earth-fixed error model at ``nav``, with the measured specific force (3,)."""
    f = np.zeros((15, 15))
    rotation = nav[6:15].reshape(3, 3)
    _common_blocks(f, rotation, turned(rotation, force_m_s2 - nav[15:18]), noise)
    r2 = nav[0] * nav[0] + nav[1] * nav[1] + nav[2] * nav[2]
    pull = _GM / (r2 * math.sqrt(r2))
    for i in range(3):
        f[i, 3 + i] = 1.0
        for j in range(3):
            f[3 + i, j] = 3.0 * pull * nav[i] * nav[j] / r2
        f[3 + i, i] -= pull
    f[3, 0] += _RATE * _RATE
    f[4, 1] += _RATE * _RATE
    f[3, 4] += 2.0 * _RATE
    f[4, 3] -= 2.0 * _RATE
    f[6, 7] += _RATE
    f[7, 6] -= _RATE
    return f


@njit(cache=True)
def _rate_partials_local(nav: Floats) -> tuple[Floats, Floats, Floats]:
    """Partials (3, 3) of the Earth's rate by position, and of the transport rate by position and by velocity."""
    latitude, height, velocity = nav[0], nav[2], nav[3:6]
    meridian, across = curvature_radii_m(latitude)
    m, a = meridian + height, across + height
    s, c = math.sin(latitude), math.cos(latitude)
    t = s / c
    earth = np.zeros((3, 3))
    earth[1, 1] = -_RATE * s / m
    earth[2, 1] = _RATE * c / m
    by_position = np.zeros((3, 3))
    by_position[0, 2] = velocity[1] / (m * m)
    by_position[1, 2] = -velocity[0] / (a * a)
    by_position[2, 2] = -velocity[0] * t / (a * a)
    by_position[2, 1] = velocity[0] / (a * c * c * m)
    by_velocity = np.zeros((3, 3))
    by_velocity[0, 1] = -1.0 / m
    by_velocity[1, 0] = 1.0 / a
    by_velocity[2, 0] = t / a
    return earth, by_position, by_velocity


@njit(cache=True)
def rates_local(nav: Floats, force_m_s2: Floats, noise: Floats) -> Floats:
    """F (15, 15) of the local error model at ``nav`` (Groves 2013, section 14.2.4, in metres and east, north, up).

    The change of the ellipsoid's radii with latitude is left out (a part in 150 of terms of 1e-6).
    """
    f = np.zeros((15, 15))
    rotation = nav[6:15].reshape(3, 3)
    _common_blocks(f, rotation, turned(rotation, force_m_s2 - nav[15:18]), noise)
    latitude, height, velocity = nav[0], nav[2], nav[3:6]
    meridian, across = curvature_radii_m(latitude)
    m, a = meridian + height, across + height
    earth_rate = earth_rate_local_rad_s(latitude)
    transport = transport_rate_local_rad_s(latitude, height, velocity)
    earth, by_position, by_velocity = _rate_partials_local(nav)
    add_skew(f, 3, 3, 2.0 * earth_rate + transport, -1.0)
    add_skew(f, 6, 6, earth_rate + transport, -1.0)
    across_v = np.zeros((3, 3))
    add_skew(across_v, 0, 0, velocity, 1.0)
    for i in range(3):
        f[i, 3 + i] = 1.0
        for j in range(3):
            f[6 + i, j] -= earth[i, j] + by_position[i, j]
            f[6 + i, 3 + j] -= by_velocity[i, j]
            for k in range(3):
                f[3 + i, j] += across_v[i, k] * (2.0 * earth[k, j] + by_position[k, j])
                f[3 + i, 3 + j] += across_v[i, k] * by_velocity[k, j]
    f[5, 2] += 2.0 * _GM / (m * a * math.sqrt(m * a))
    f[0, 0] += velocity[2] / a - velocity[1] * math.tan(latitude) / m
    f[0, 1] += velocity[0] * math.tan(latitude) / m
    f[0, 2] -= velocity[0] / a
    f[1, 1] += velocity[2] / m
    f[1, 2] -= velocity[1] / m
    return f


@njit(cache=True)
def transition_of(f: Floats, step_s: float) -> Floats:
    """``I + F τ + (F τ)²/2``, (15, 15)."""
    scaled = f * step_s
    out = 0.5 * (scaled @ scaled) + scaled
    for i in range(15):
        out[i, i] += 1.0
    return out


@njit(cache=True)
def propagate_covariance(p: Floats, transition: Floats) -> None:
    """``P ← Φ P Φᵀ`` in place, where only the first 15 of the n states of ``p`` (n, n) move."""
    n = p.shape[0]
    p[:15, :15] = transition @ np.ascontiguousarray(p[:15, :15]) @ transition.T
    if n > 15:
        moved = transition @ np.ascontiguousarray(p[:15, 15:])
        p[:15, 15:] = moved
        p[15:, :15] = moved.T


@njit(cache=True)
def add_process_noise(p: Floats, noise: Floats, force: float, rate: float, step_s: float, gap: bool) -> None:
    """Add a step's process noise to ``p`` in place; ``force`` m/s² and ``rate`` rad/s are how hard it shakes."""
    q_a = noise[0] ** 2 + (noise[6] * force) ** 2
    q_g = noise[1] ** 2 + (noise[7] * rate) ** 2
    if gap:
        q_a += noise[8] ** 2
        q_g += (noise[8] / 9.8) ** 2
    grown_a = noise[2] ** 2 * (1.0 - math.exp(-2.0 * step_s / noise[3]))
    grown_g = noise[4] ** 2 * (1.0 - math.exp(-2.0 * step_s / noise[5]))
    for i in range(3):
        p[i, i] += q_a * step_s**3 / 3.0
        p[i, 3 + i] += q_a * step_s**2 / 2.0
        p[3 + i, i] += q_a * step_s**2 / 2.0
        p[3 + i, 3 + i] += q_a * step_s
        p[6 + i, 6 + i] += q_g * step_s
        p[9 + i, 9 + i] += grown_a
        p[12 + i, 12 + i] += grown_g


@njit(cache=True)
def feed_back(nav: Floats, p: Floats, error: Floats, local: bool) -> None:
    """Move ``nav`` by an estimated error (15,) and reset the error state, in place.

    The attitude error that is left is ``(I + [ψ/2 ×]) (ψ_true − ψ)`` to first order, so its covariance turns along
    (Markley 2003, J. Guidance 26(2); Solà 2017, section 6.3).
    """
    if local:
        meridian, across = curvature_radii_m(nav[0])
        nav[1] += error[0] / ((across + nav[2]) * math.cos(nav[0]))
        nav[0] += error[1] / (meridian + nav[2])
        nav[2] += error[2]
    else:
        nav[0:3] += error[0:3]
    nav[3:6] += error[3:6]
    rotation = nav[6:15].reshape(3, 3)
    old = rotation.copy()
    multiply(rotation_exp(error[6:9]), old, rotation)
    orthonormalise(rotation)
    nav[15:21] += error[9:15]
    reset = np.eye(3)
    add_skew(reset, 0, 0, error[6:9], 0.5)
    p[6:9, :] = reset @ np.ascontiguousarray(p[6:9, :])
    p[:, 6:9] = np.ascontiguousarray(p[:, 6:9]) @ reset.T
