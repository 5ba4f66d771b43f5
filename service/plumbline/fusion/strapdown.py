"""Strapdown mechanisation: specific force and angular rate to position, velocity and attitude.

Two frames. *Earth-fixed* (ECEF) serves the tight filter (Dai 2024, section 2.2)::

    Ċ = C [ω×] − [ω_ie×] C            v̇ = C f + g(r) − 2 ω_ie × v            ṙ = v

*Local* is east, north, up at the platform (de Alteriis 2022, eqs 1-7, there written north, east, down)::

    Ċ = C [ω×] − [(ω_ie + ω_en)×] C   v̇ = C f + g − (2 ω_ie + ω_en) × v      φ̇, λ̇, ḣ from v and the ellipsoid's radii

with C the rotation from body to the frame, f and ω the measured specific force and rate less their biases, g gravity
(gravitation and centrifugal), ω_ie the Earth's rate and ω_en the transport rate. Steps are second order in time: the
force is turned by the attitude in the middle of the step.

The navigation state is one array ``nav`` (21,): position (ECEF m, or latitude rad, longitude rad, height m), velocity
m/s, rotation from body row by row, accelerometer bias m/s², gyroscope bias rad/s.

**The error state** (15,) is truth less estimate: position m (local: east, north, up), velocity m/s, attitude ψ rad,
accelerometer bias, gyroscope bias. ψ turns the estimate into the truth, from the left:
``C_true = (I + [ψ×]) C_estimated``, so ``δ(C l) = −[(C l)×] ψ``. (Dai 2024, eq. 7, has the opposite sign of ψ. His
eq. 5 has the Earth-rate term with the wrong sign: by differentiation of ``r + C l`` it is
``v_i = v + C (ω × l_i) − ω_ie × C l_i``.)
"""

import math
from typing import Final

import numpy as np
from numba import njit

from plumbline.constants import (
    EARTH_ECCENTRICITY_SQUARED,
    EARTH_GM_GALILEO_M3_S2,
    EARTH_ROTATION_RATE_RAD_S,
    EARTH_SEMI_MAJOR_AXIS_M,
)
from plumbline.fusion.rotations import multiply, orthonormalise, rotation_exp, turned
from plumbline.records import Floats

NAV_SIZE: Final = 21
POSITION: Final = 0  # offsets in `nav`
VELOCITY: Final = 3
ROTATION: Final = 6
ACCELEROMETER_BIAS: Final = 15
GYROSCOPE_BIAS: Final = 18

ERROR_SIZE: Final = 15
ERROR_POSITION: Final = 0  # offsets in the error state
ERROR_VELOCITY: Final = 3
ERROR_ATTITUDE: Final = 6
ERROR_ACCELEROMETER_BIAS: Final = 9
ERROR_GYROSCOPE_BIAS: Final = 12

_GM: Final = EARTH_GM_GALILEO_M3_S2
_J2: Final = 1.08262982131e-3  # NIMA TR 8350.2, table 3.3
_J4: Final = -2.37091222e-6  # the same
_RATE: Final = EARTH_ROTATION_RATE_RAD_S
_GRAVITY_EQUATOR_M_S2: Final = 9.7803253359  # NIMA TR 8350.2, table 3.4
_SOMIGLIANA_K: Final = 0.00193185265241
_M_RATIO: Final = 0.00344978650684  # ω² a² b / GM, the same table
_CURVATURE_PER_S2: Final = 8.08e-9  # northward gravity above the ellipsoid: the plumb line curves (Groves 2013, 2.140)
_FLATTENING: Final = 1.0 - math.sqrt(1.0 - EARTH_ECCENTRICITY_SQUARED)


@njit(cache=True)
def gravity_ecef_m_s2(position_ecef_m: Floats) -> Floats:
    """Gravity (3,), m/s², Earth-fixed: gravitation of the ellipsoid up to J4, plus the centrifugal acceleration.

    Gradient of ``GM/r (1 − J2 (a/r)² P2 − J4 (a/r)⁴ P4)``, P of the sine of the geocentric latitude (Montenbruck &
    Gill 2000, section 3.2).
    """
    x, y, z = position_ecef_m[0], position_ecef_m[1], position_ecef_m[2]
    r2 = x * x + y * y + z * z
    r = math.sqrt(r2)
    s2 = z * z / r2
    q2 = EARTH_SEMI_MAJOR_AXIS_M * EARTH_SEMI_MAJOR_AXIS_M / r2
    j2 = 1.5 * _J2 * q2
    j4 = 0.625 * _J4 * q2 * q2
    common = -_GM / (r2 * r)
    level = 1.0 + j2 * (1.0 - 5.0 * s2) + j4 * (-3.0 + 42.0 * s2 - 63.0 * s2 * s2)
    polar = 1.0 + j2 * (3.0 - 5.0 * s2) + j4 * (-15.0 + 70.0 * s2 - 63.0 * s2 * s2)
    out = np.empty(3)
    out[0] = common * x * level + _RATE * _RATE * x
    out[1] = common * y * level + _RATE * _RATE * y
    out[2] = common * z * polar
    return out


@njit(cache=True)
def gravity_up_m_s2(latitude_rad: float, height_m: float) -> float:
    """Normal gravity downwards, m/s²: Somigliana, continued upwards (NIMA TR 8350.2, eqs 4-1 and 4-3)."""
    s2 = math.sin(latitude_rad) ** 2
    surface = _GRAVITY_EQUATOR_M_S2 * (1.0 + _SOMIGLIANA_K * s2) / math.sqrt(1.0 - EARTH_ECCENTRICITY_SQUARED * s2)
    a = EARTH_SEMI_MAJOR_AXIS_M
    slope = 2.0 / a * (1.0 + _FLATTENING + _M_RATIO - 2.0 * _FLATTENING * s2)
    return float(surface * (1.0 - slope * height_m + 3.0 / (a * a) * height_m * height_m))


@njit(cache=True)
def curvature_radii_m(latitude_rad: float) -> tuple[float, float]:
    """Radii of the ellipsoid along the meridian and across it (prime vertical), m."""
    s = math.sin(latitude_rad)
    w2 = 1.0 - EARTH_ECCENTRICITY_SQUARED * s * s
    across = EARTH_SEMI_MAJOR_AXIS_M / math.sqrt(w2)
    return across * (1.0 - EARTH_ECCENTRICITY_SQUARED) / w2, across


@njit(cache=True)
def earth_rate_local_rad_s(latitude_rad: float) -> Floats:
    """The Earth's rate (3,), rad/s, east, north, up."""
    out = np.zeros(3)
    out[1] = _RATE * math.cos(latitude_rad)
    out[2] = _RATE * math.sin(latitude_rad)
    return out


@njit(cache=True)
def transport_rate_local_rad_s(latitude_rad: float, height_m: float, velocity_enu_m_s: Floats) -> Floats:
    """Rate (3,), rad/s, at which east, north, up turn as the platform moves over the ellipsoid."""
    meridian, across = curvature_radii_m(latitude_rad)
    out = np.empty(3)
    out[0] = -velocity_enu_m_s[1] / (meridian + height_m)
    out[1] = velocity_enu_m_s[0] / (across + height_m)
    out[2] = out[1] * math.tan(latitude_rad)
    return out


@njit(cache=True)
def rotation_of(nav: Floats) -> Floats:
    """The rotation from body to the frame, a view (3, 3) into ``nav``."""
    return nav[6:15].reshape(3, 3)


@njit(cache=True)
def _turn(nav: Floats, rate_rad_s: Floats, frame_rate_rad_s: Floats, step_s: float) -> Floats:
    """Turn the attitude through a step, in place; returns the rotation (3, 3) in the middle of it."""
    rotation = nav[6:15].reshape(3, 3)
    half_body = rotation_exp(0.5 * step_s * rate_rad_s)
    half_frame = rotation_exp(-0.5 * step_s * frame_rate_rad_s)
    part, middle = np.empty((3, 3)), np.empty((3, 3))
    multiply(rotation, half_body, part)
    multiply(half_frame, part, middle)
    multiply(middle, half_body, part)
    multiply(half_frame, part, rotation)
    orthonormalise(rotation)
    return middle


@njit(cache=True)
def step_ecef(nav: Floats, force_m_s2: Floats, rate_rad_s: Floats, step_s: float, acceleration: Floats) -> None:
    """One step of ``step_s`` s of the Earth-fixed mechanisation, in place.

    ``force_m_s2`` and ``rate_rad_s`` (3,) as measured, means over the step; biases are taken off here.
    ``acceleration`` (3,) receives the acceleration relative to the Earth, m/s², Earth-fixed.
    """
    frame_rate = np.zeros(3)
    frame_rate[2] = _RATE
    middle = _turn(nav, rate_rad_s - nav[18:21], frame_rate, step_s)
    acceleration[:] = turned(middle, force_m_s2 - nav[15:18])
    position, velocity = nav[0:3], nav[3:6]
    acceleration += gravity_ecef_m_s2(position + 0.5 * step_s * velocity)
    vx = velocity[0] + 0.5 * step_s * (acceleration[0] + 2.0 * _RATE * velocity[1])
    vy = velocity[1] + 0.5 * step_s * (acceleration[1] - 2.0 * _RATE * velocity[0])
    acceleration[0] += 2.0 * _RATE * vy
    acceleration[1] -= 2.0 * _RATE * vx
    for i in range(3):
        position[i] += step_s * (velocity[i] + 0.5 * step_s * acceleration[i])
        velocity[i] += step_s * acceleration[i]


@njit(cache=True)
def step_local(nav: Floats, force_m_s2: Floats, rate_rad_s: Floats, step_s: float, acceleration: Floats) -> None:
    """One step of ``step_s`` s of the local mechanisation, in place; arguments as in :func:`step_ecef`.

    ``acceleration`` (3,) is east, north, up.
    """
    latitude, height = nav[0], nav[2]
    velocity = nav[3:6]
    earth = earth_rate_local_rad_s(latitude)
    transport = transport_rate_local_rad_s(latitude, height, velocity)
    middle = _turn(nav, rate_rad_s - nav[18:21], earth + transport, step_s)
    acceleration[:] = turned(middle, force_m_s2 - nav[15:18])
    acceleration[1] -= _CURVATURE_PER_S2 * height * math.sin(2.0 * latitude)
    acceleration[2] -= gravity_up_m_s2(latitude, height + 0.5 * step_s * velocity[2])
    coriolis = 2.0 * earth + transport
    mean = velocity + 0.5 * step_s * acceleration
    acceleration[0] -= coriolis[1] * mean[2] - coriolis[2] * mean[1]
    acceleration[1] -= coriolis[2] * mean[0] - coriolis[0] * mean[2]
    acceleration[2] -= coriolis[0] * mean[1] - coriolis[1] * mean[0]
    mean[:] = velocity + 0.5 * step_s * acceleration
    meridian, across = curvature_radii_m(latitude)
    nav[0] += step_s * mean[1] / (meridian + height)
    nav[1] += step_s * mean[0] / ((across + height) * math.cos(latitude))
    nav[2] += step_s * mean[2]
    for i in range(3):
        velocity[i] += step_s * acceleration[i]
