"""Nominal attitude of a GNSS satellite, and whether it is in the Earth's shadow.

Body axes as the IGS defines them (O. Montenbruck et al., "GNSS satellite geometry and attitude models", Adv. Space Res.
56, 2015): z to the Earth's centre, y along the solar panels' axis, x completing the frame, towards the Sun's side.
"""

import math
from typing import Final

import numpy as np
from numba import njit

from plumbline.constants import EARTH_ROTATION_RATE_RAD_S, EARTH_SEMI_MAJOR_AXIS_M
from plumbline.gnss.orbits_broadcast import is_beidou_geo
from plumbline.records import Floats
from plumbline.signals import N_SATELLITES, SATELLITES_PER_SYSTEM, System

#: Satellites that do not steer to the Sun but keep y along the orbit's negative normal: geostationary BeiDou.
ORBIT_NORMAL: Final = np.array(
    [i // SATELLITES_PER_SYSTEM == System.BEIDOU and is_beidou_geo(i) for i in range(N_SATELLITES)]
)


@njit(cache=True)
def body_axes(position: Floats, velocity: Floats, sun: Floats, orbit_normal: bool) -> Floats:
    """Rows x, y, z of a satellite's body in Earth-fixed coordinates (3, 3); position, velocity, Sun (3,), SI units.

    Yaw steering: y = z × (Sun − satellite), normalised. Orbit-normal mode: y opposite to the orbital angular momentum.
    """
    out = np.empty((3, 3))
    z = -position / math.sqrt(np.dot(position, position))
    if orbit_normal:
        inertial = velocity.copy()
        inertial[0] -= EARTH_ROTATION_RATE_RAD_S * position[1]
        inertial[1] += EARTH_ROTATION_RATE_RAD_S * position[0]
        y = -np.cross(position, inertial)
    else:
        y = np.cross(z, sun - position)
    y = y / math.sqrt(np.dot(y, y))
    out[0] = np.cross(y, z)
    out[1] = y
    out[2] = z
    return out


@njit(cache=True)
def in_shadow(position: Floats, sun: Floats) -> bool:
    """Whether a satellite is in the Earth's shadow, taken as a cylinder: there, yaw is not nominal."""
    along = np.dot(position, sun) / math.sqrt(np.dot(sun, sun))
    if along >= 0.0:
        return False
    return bool(np.dot(position, position) - along * along < EARTH_SEMI_MAJOR_AXIS_M * EARTH_SEMI_MAJOR_AXIS_M)
