"""The tight filter's first state: attitude from antennas, or by levelling and gyro-compassing; position from RTK."""

import math
from typing import Final

import numpy as np

from plumbline.config import InertialSettings
from plumbline.fusion.alignment import Alignment, gyro_compass, level, with_heading
from plumbline.fusion.loose_start import first_covariance
from plumbline.fusion.rotations import angle_partials
from plumbline.fusion.strapdown import earth_rate_local_rad_s
from plumbline.fusion.tight_arcs import TightExtra
from plumbline.fusion.tight_update import TightNode
from plumbline.fusion.timeline import Node
from plumbline.gnss.earth_frames import geodetic_from_ecef, rotation_enu_from_ecef
from plumbline.records import Floats

_TILT_SIGMA_RAD: Final = 1e-4  # of levelling itself, beside the accelerometer's bias
_ANTENNA_SIGMA_M: Final = 0.01  # of a baseline between antennas, integers known: multipath of both


def align_at_rest(
    force_body_m_s2: Floats,
    rate_body_rad_s: Floats,
    span_s: float,
    latitude_rad: float,
    settings: InertialSettings,
) -> Alignment:
    """Attitude from mean samples (3,) at rest: levelling, and the heading given or else the gyroscope's compass."""
    rotation = level(force_body_m_s2)
    if settings.heading_deg is not None:
        heading, sigma = math.radians(settings.heading_deg), math.radians(settings.heading_sigma_deg)
    else:
        noise = settings.gyroscope_noise_rad_s_sqrt_hz / math.sqrt(span_s)
        rate_sigma = math.hypot(settings.initial_gyroscope_bias_sigma_rad_s, noise)
        heading, sigma = gyro_compass(rotation, rate_body_rad_s, latitude_rad, rate_sigma)
    return _levelled(rotation, heading, sigma, span_s, settings)


def align_by_antennas(
    baselines_enu_m: Floats, arms_body_m: Floats, force_body_m_s2: Floats, span_s: float, settings: InertialSettings
) -> Alignment:
    """Attitude from the mean specific force (3,) at rest and the heading of baselines, integers known.

    ``baselines_enu_m`` (k, 3) primary → auxiliaries, ``arms_body_m`` (k, 3) the same in body axes. The accelerometer
    levels to hundredths of a degree, a metre between antennas among reflections to half a degree: of the antennas only
    the heading is taken, that turns the levelled arms into the baselines (least squares in the plane).
    """
    rotation = level(force_body_m_s2)
    arms = arms_body_m @ rotation.T
    across = float(np.sum(arms[:, 1] * baselines_enu_m[:, 0] - arms[:, 0] * baselines_enu_m[:, 1]))
    along = float(np.sum(arms[:, :2] * baselines_enu_m[:, :2]))
    sigma = _ANTENNA_SIGMA_M / math.sqrt(float(np.sum(arms[:, :2] ** 2)) + 1e-12)
    return _levelled(rotation, math.atan2(across, along), max(sigma, 1e-4), span_s, settings)


def _levelled(
    rotation_level: Floats, heading_rad: float, heading_sigma_rad: float, span_s: float, settings: InertialSettings
) -> Alignment:
    """The level rotation (3, 3) with a heading, and what it is worth beside the accelerometer's bias."""
    attitude = with_heading(rotation_level, heading_rad)
    noise = settings.accelerometer_noise_m_s2_sqrt_hz / math.sqrt(span_s) / 9.8
    tilt = math.hypot(_TILT_SIGMA_RAD, noise)
    return Alignment(attitude, np.array([tilt, tilt, heading_sigma_rad]), attitude)


def first_tight_node(
    t_gps_ns: int,
    position_ecef_m: Floats,
    position_sigma_m: float,
    alignment: Alignment,
    settings: InertialSettings,
    antenna: int = 0,
    velocity_sigma_m_s: float = 0.05,
) -> TightNode:
    """The filter's first node, at rest, from the position (3,) of one antenna and an attitude."""
    place = geodetic_from_ecef(position_ecef_m)
    turn = rotation_enu_from_ecef(place[0], place[1])
    rotation = turn.T @ alignment.rotation_enu_from_body
    nav = np.zeros(21)
    nav[0:3] = position_ecef_m - rotation @ np.array(settings.lever_arms_body_m[antenna])
    nav[6:15] = rotation.ravel()
    p = first_covariance(alignment, settings)
    p[0:3, 0:3] = position_sigma_m**2 * np.eye(3)
    p[3:6, 3:6] = velocity_sigma_m_s**2 * np.eye(3)
    whole = np.eye(15)
    whole[6:9, 6:9] = turn.T
    return Node(t_gps_ns, nav, whole @ p @ whole.T, TightExtra())


def gyroscope_bias_at_rest(rate_body_rad_s: Floats, alignment: Alignment, latitude_rad: float) -> Floats:
    """The gyroscope's bias (3,), rad/s, of a mean rate (3,) at rest: what is left without the Earth's."""
    earth: Floats = alignment.rotation_enu_from_body.T @ earth_rate_local_rad_s(latitude_rad)
    bias: Floats = rate_body_rad_s - earth
    return bias


def angle_sigmas_rad(covariance_enu_rad2: Floats, heading_rad: float, pitch_rad: float) -> Floats:
    """Sigmas (3,) of heading, pitch, roll from the covariance (3, 3) of ψ in east, north, up."""
    partials = angle_partials(heading_rad, pitch_rad)
    sigma: Floats = np.sqrt(np.diag(partials @ covariance_enu_rad2 @ partials.T))
    return sigma
