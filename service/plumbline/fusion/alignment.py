"""Initial attitude: levelling, gyro-compassing, heading from common motion with GNSS.

At rest the specific force points up, so its mean gives pitch and roll; the mean rate, less the gyroscope's bias, is the
Earth's, whose horizontal part points north. Where the gyroscope is too coarse for that, the heading is the angle that
turns the velocity changes of a levelled, gyro-stabilised platform into those that GNSS saw (no assumption on which axis
points forward).
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from plumbline.fusion.inertial_run import sample_at
from plumbline.fusion.rotations import angles_from_rotation, multiply, rotation_enu_from_angles, rotation_exp, turned
from plumbline.fusion.strapdown import earth_rate_local_rad_s
from plumbline.records import Floats, Ints


@dataclass(frozen=True, slots=True)
class Alignment:
    """An attitude and what it is worth."""

    rotation_enu_from_body: Floats  # (3, 3)
    sigma_enu_rad: Floats  # (3,) of the error ψ about east, north, up
    levelled_enu_from_body: Floats | None  # (3, 3) attitude at which the accelerometer levelled it: the tilt's error
    # goes with the accelerometer's bias there; None where pitch and roll come from elsewhere


def level(force_body_m_s2: Floats) -> Floats:
    """Rotation (3, 3) from body to the level frame of heading zero, of the mean specific force (3,) at rest."""
    norm = float(np.linalg.norm(force_body_m_s2))
    pitch = math.asin(max(-1.0, min(1.0, force_body_m_s2[1] / norm)))
    roll = math.atan2(-force_body_m_s2[0], force_body_m_s2[2])
    rotation: Floats = rotation_enu_from_angles(0.0, pitch, roll)
    return rotation


def with_heading(rotation_level: Floats, heading_rad: float) -> Floats:
    """The level rotation (3, 3), its heading set to ``heading_rad`` more."""
    rotation: Floats = rotation_exp(np.array([0.0, 0.0, -heading_rad])) @ rotation_level
    return rotation


def gyro_compass(
    rotation_level: Floats, rate_body_rad_s: Floats, latitude_rad: float, rate_sigma_rad_s: float
) -> tuple[float, float]:
    """Heading to be given to :func:`with_heading` and its sigma, rad, from the mean rate (3,) at rest, bias removed."""
    rate = rotation_level @ rate_body_rad_s
    horizontal = float(earth_rate_local_rad_s(latitude_rad)[1])
    return -math.atan2(rate[0], rate[1]), rate_sigma_rad_s / max(horizontal, 1e-12)


@njit(cache=True)
def level_velocity_changes(
    t_ns: Ints, samples: Floats, rotation_level: Floats, bias_rad_s: Floats, from_ns: int, ends_ns: Ints
) -> Floats:
    """Integrals (m, 3), m/s, of the specific force in the level frame between ``from_ns`` and each of ``ends_ns`` (m,).

    The rotation (3, 3) is carried along by the samples' rates less ``bias_rad_s`` (3,), in place; the Earth's rate is
    left out. ``ends_ns`` ascending, not after the last sample.
    """
    out = np.zeros((ends_ns.size, 3))
    sample, part, middle = np.empty(6), np.empty((3, 3)), np.empty((3, 3))
    now = from_ns
    index = int(np.searchsorted(t_ns, from_ns + 1))
    for k in range(ends_ns.size):
        while now < ends_ns[k] and index < t_ns.size:
            end = min(ends_ns[k], t_ns[index])
            sample_at(t_ns, samples, index, now + (end - now) // 2, sample)
            step = (end - now) * 1e-9
            half = rotation_exp(0.5 * step * (sample[3:6] - bias_rad_s))
            part[:, :] = rotation_level
            multiply(part, half, middle)
            multiply(middle, half, rotation_level)
            out[k] += step * turned(middle, sample[0:3])
            now = end
            if now == t_ns[index]:
                index += 1
        if k + 1 < ends_ns.size:
            out[k + 1] = out[k]
    return out


def heading_from_motion(level_change_m_s: Floats, enu_change_m_s: Floats, intervals_s: Floats) -> tuple[float, float]:
    """Heading and its sigma, rad, that turn horizontal velocity changes (m, 2) of the level frame into east, north.

    A constant acceleration over the intervals (m,) is estimated along: tilt and the accelerometer's bias look like one.
    Sigma comes from what is left unexplained; infinite for fewer than four changes, or for none at all.
    """
    inertial = level_change_m_s[:, 0] + 1j * level_change_m_s[:, 1]
    gnss = enu_change_m_s[:, 0] + 1j * enu_change_m_s[:, 1]
    if len(inertial) < 4:
        return 0.0, math.inf
    weight = intervals_s / float(np.sum(intervals_s**2))
    inertial = inertial - intervals_s * np.sum(weight * inertial)
    gnss = gnss - intervals_s * np.sum(weight * gnss)
    power = float(np.sum(np.abs(inertial) ** 2))
    product = complex(np.sum(gnss * np.conj(inertial)))
    if power == 0.0 or product == 0.0:
        return 0.0, math.inf
    turn = product / abs(product)
    left = float(np.sum(np.abs(gnss - turn * inertial) ** 2))
    return -math.atan2(turn.imag, turn.real), math.sqrt(0.5 * left / (len(inertial) - 2) / power)


def describe(alignment: Alignment) -> str:
    """Heading, pitch and roll with sigmas, in words."""
    angles = np.degrees(angles_from_rotation(alignment.rotation_enu_from_body))
    sigma = np.degrees(alignment.sigma_enu_rad)
    return (
        f"heading {angles[0]:.2f}° (σ {sigma[2]:.2f}°), pitch {angles[1]:.2f}°, roll {angles[2]:.2f}° "
        f"(σ {max(sigma[0], sigma[1]):.2f}°)"
    )
