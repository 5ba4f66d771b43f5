"""Rotations: matrices, small-angle vectors, and the angles that people read.

Body axes are right (x), forward (y), up (z): with heading, pitch and roll zero they are east, north, up. Heading turns
clockwise from north, pitch lifts the forward axis, roll lowers the right one::

    rotation_enu_from_body = R_z(−heading) · R_x(pitch) · R_y(roll)
"""

import math

import numpy as np
from numba import njit

from plumbline.records import Floats


@njit(cache=True)
def skew(a: Floats) -> Floats:
    """Matrix (3, 3) of the cross product: ``skew(a) @ b = a × b``."""
    out = np.zeros((3, 3))
    out[0, 1], out[0, 2], out[1, 2] = -a[2], a[1], -a[0]
    out[1, 0], out[2, 0], out[2, 1] = a[2], -a[1], a[0]
    return out


@njit(cache=True)
def rotation_exp(vector_rad: Floats) -> Floats:
    """Rotation matrix (3, 3) of a rotation vector (3,), rad (Rodrigues)."""
    x, y, z = vector_rad[0], vector_rad[1], vector_rad[2]
    squared = x * x + y * y + z * z
    if squared < 1e-8:  # series: what is left out is below 1e-16
        a = 1.0 - squared / 6.0
        b = 0.5 - squared / 24.0
    else:
        angle = math.sqrt(squared)
        a = math.sin(angle) / angle
        b = (1.0 - math.cos(angle)) / squared
    out = np.empty((3, 3))
    out[0, 0] = 1.0 - b * (y * y + z * z)
    out[1, 1] = 1.0 - b * (x * x + z * z)
    out[2, 2] = 1.0 - b * (x * x + y * y)
    out[0, 1], out[1, 0] = b * x * y - a * z, b * x * y + a * z
    out[0, 2], out[2, 0] = b * x * z + a * y, b * x * z - a * y
    out[1, 2], out[2, 1] = b * y * z - a * x, b * y * z + a * x
    return out


@njit(cache=True)
def rotation_log(rotation: Floats) -> Floats:
    """Rotation vector (3,), rad, of a rotation matrix by less than half a turn."""
    out = np.empty(3)
    out[0] = 0.5 * (rotation[2, 1] - rotation[1, 2])
    out[1] = 0.5 * (rotation[0, 2] - rotation[2, 0])
    out[2] = 0.5 * (rotation[1, 0] - rotation[0, 1])
    sine = math.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    cosine = 0.5 * (rotation[0, 0] + rotation[1, 1] + rotation[2, 2] - 1.0)
    if sine > 1e-12:
        out *= math.atan2(sine, cosine) / sine
    return out


@njit(cache=True)
def multiply(a: Floats, b: Floats, out: Floats) -> None:
    """``out = a b`` for (3, 3) matrices, without a call into BLAS; ``out`` must be neither."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@njit(cache=True)
def turned(rotation: Floats, vector: Floats) -> Floats:
    """``rotation @ vector`` for (3, 3) and (3,)."""
    out = np.empty(3)
    for i in range(3):
        out[i] = rotation[i, 0] * vector[0] + rotation[i, 1] * vector[1] + rotation[i, 2] * vector[2]
    return out


@njit(cache=True)
def turned_back(rotation: Floats, vector: Floats) -> Floats:
    """``rotation.T @ vector`` for (3, 3) and (3,)."""
    out = np.empty(3)
    for i in range(3):
        out[i] = rotation[0, i] * vector[0] + rotation[1, i] * vector[1] + rotation[2, i] * vector[2]
    return out


@njit(cache=True)
def cross(a: Floats, b: Floats) -> Floats:
    """``a × b`` for (3,)."""
    out = np.empty(3)
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out


@njit(cache=True)
def orthonormalise(rotation: Floats) -> None:
    """One Newton step towards the nearest rotation, in place: enough against the rounding of single steps."""
    gram = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            gram[i, j] = -0.5 * (
                rotation[0, i] * rotation[0, j] + rotation[1, i] * rotation[1, j] + rotation[2, i] * rotation[2, j]
            )
        gram[i, i] += 1.5
    old = rotation.copy()
    multiply(old, gram, rotation)


@njit(cache=True)
def rotation_enu_from_angles(heading_rad: float, pitch_rad: float, roll_rad: float) -> Floats:
    """Matrix (3, 3) that turns body vectors into east, north, up."""
    sh, ch = math.sin(heading_rad), math.cos(heading_rad)
    sp, cp = math.sin(pitch_rad), math.cos(pitch_rad)
    sr, cr = math.sin(roll_rad), math.cos(roll_rad)
    out = np.empty((3, 3))
    out[0, 0], out[0, 1], out[0, 2] = ch * cr + sh * sp * sr, sh * cp, ch * sr - sh * sp * cr
    out[1, 0], out[1, 1], out[1, 2] = -sh * cr + ch * sp * sr, ch * cp, -sh * sr - ch * sp * cr
    out[2, 0], out[2, 1], out[2, 2] = -cp * sr, sp, cp * cr
    return out


@njit(cache=True)
def angles_from_rotation(rotation_enu_from_body: Floats) -> Floats:
    """Heading in 0…2π, pitch in ±π/2 and roll in ±π (3,), rad, of a matrix (3, 3)."""
    c = rotation_enu_from_body
    out = np.empty(3)
    heading = math.atan2(c[0, 1], c[1, 1])
    out[0] = heading if heading >= 0.0 else heading + 2.0 * math.pi
    out[1] = math.asin(min(1.0, max(-1.0, c[2, 1])))
    out[2] = math.atan2(-c[2, 0], c[2, 2])
    return out


@njit(cache=True)
def angle_partials(heading_rad: float, pitch_rad: float) -> Floats:
    """Partials (3, 3) of heading, pitch, roll by a small rotation ψ (east, north, up) with C ← (I + [ψ×]) C.

    ψ is resolved along the axes that the three angles turn about: heading about −up, pitch about the levelled right
    axis, roll about the forward axis. Undefined at pitch ±90°.
    """
    sh, ch = math.sin(heading_rad), math.cos(heading_rad)
    tp, cp = math.tan(pitch_rad), math.cos(pitch_rad)
    out = np.zeros((3, 3))
    out[0, 0], out[0, 1], out[0, 2] = tp * sh, tp * ch, -1.0
    out[1, 0], out[1, 1] = ch, -sh
    out[2, 0], out[2, 1] = sh / cp, ch / cp
    return out
