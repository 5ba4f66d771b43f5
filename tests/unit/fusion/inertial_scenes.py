"""Platforms in motion with known truth, and the IMU and GNSS that they carry."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from plumbline.config import InertialSettings
from plumbline.fusion.rotations import rotation_enu_from_angles
from plumbline.fusion.strapdown import earth_rate_local_rad_s, gravity_up_m_s2, step_local
from plumbline.gnss.earth_frames import ecef_from_geodetic, rotation_enu_from_ecef
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, Ints, Solution, Status

T0 = 1_400_000_000 * NS_PER_S
PLACE = np.array([0.39, 1.99, 50.0])
FINE = 10  # truth steps a sample

Motion = Callable[[float], tuple[Floats, Floats]]  # time s → acceleration ENU m/s², rate relative to the Earth, body


@dataclass(frozen=True)
class Truth:
    """States (n, 21) at the samples' times, and the samples without errors."""

    t_gps_ns: Ints
    nav: Floats
    samples: Floats  # (n, 6)


def drive(t: float) -> tuple[Floats, Floats]:
    """Stands for 10 s, then a car-like motion with turns, bumps and braking."""
    if t < 10.0:
        return np.zeros(3), np.zeros(3)
    s = t - 10.0
    rate = np.array([0.03 * np.sin(1.3 * s), 0.02 * np.sin(1.7 * s), 0.35 * np.sin(0.25 * s)])
    return np.array([1.5 * np.cos(0.3 * s), 1.1 * np.sin(0.23 * s), 0.3 * np.sin(0.9 * s)]), rate


def sway(t: float) -> tuple[Floats, Floats]:
    """A structure: two tones, a slow tilt."""
    acceleration = np.array([0.19 * np.sin(np.pi * t), 0.1 * np.cos(0.68 * np.pi * t), 0.01 * np.sin(2.0 * t)])
    return acceleration, np.array([2e-3 * np.cos(0.5 * t), 1e-3 * np.sin(0.7 * t), 1e-3 * np.cos(0.3 * t)])


def rest(t: float) -> tuple[Floats, Floats]:
    """At rest."""
    return np.zeros(3), np.zeros(3)


def truth_of(
    motion: Motion,
    duration_s: float,
    rate_hz: int = 100,
    angles: tuple[float, float, float] = (0.5, 0.02, -0.03),
    velocity_enu_m_s: Floats | None = None,
    fine: int = FINE,
) -> Truth:
    """Integrate a motion at ten times the sample rate with the local mechanisation."""
    nav = np.zeros(21)
    nav[0:3], nav[6:15] = PLACE, rotation_enu_from_angles(*angles).ravel()
    nav[3:6] = 0.0 if velocity_enu_m_s is None else velocity_enu_m_s
    n, step = round(duration_s * rate_hz), 1.0 / (rate_hz * fine)
    states, samples, unused = np.empty((n + 1, 21)), np.empty((n + 1, 6)), np.zeros(3)
    for k in range(n + 1):
        states[k], samples[k] = nav, _sample(nav, motion(k / rate_hz))
        for i in range(fine):
            middle = _sample(nav, motion(k / rate_hz + (i + 0.5) * step))
            step_local(nav, middle[:3], middle[3:], step, unused)
    times = T0 + np.arange(n + 1, dtype=np.int64) * (NS_PER_S // rate_hz)
    return Truth(times, states, samples)


def _sample(nav: Floats, wanted: tuple[Floats, Floats]) -> Floats:
    rotation, earth = nav[6:15].reshape(3, 3), earth_rate_local_rad_s(nav[0])
    up = np.array([0.0, 0.0, gravity_up_m_s2(nav[0], nav[2])])
    force = rotation.T @ (wanted[0] + up + np.cross(2 * earth, nav[3:6]))
    return np.concatenate([force, wanted[1] + rotation.T @ earth])


def measured(
    truth: Truth, settings: InertialSettings, rng: np.random.Generator, bias_scale: float = 1.0
) -> tuple[Floats, Floats]:
    """Samples (n, 6) with noise and Gauss-Markov biases of the settings; and the biases (n, 6)."""
    n = len(truth.samples)
    interval = float(truth.t_gps_ns[1] - truth.t_gps_ns[0]) / NS_PER_S
    start = np.repeat([settings.initial_accelerometer_bias_sigma_m_s2, settings.initial_gyroscope_bias_sigma_rad_s], 3)
    steady = np.repeat([settings.accelerometer_bias_sigma_m_s2, settings.gyroscope_bias_sigma_rad_s], 3)
    tau = np.repeat([settings.accelerometer_bias_time_s, settings.gyroscope_bias_time_s], 3)
    decay = np.exp(-interval / tau)
    biases = np.empty((n, 6))
    biases[0] = bias_scale * start * rng.normal(size=6)
    kicks = rng.normal(size=(n, 6)) * steady * np.sqrt(1 - decay**2)
    for k in range(1, n):
        biases[k] = decay * biases[k - 1] + kicks[k]
    density = np.repeat([settings.accelerometer_noise_m_s2_sqrt_hz, settings.gyroscope_noise_rad_s_sqrt_hz], 3)
    return truth.samples + biases + rng.normal(size=(n, 6)) * density / np.sqrt(interval), biases


def solution_at(
    truth: Truth, k: int, settings: InertialSettings, rng: np.random.Generator, sigma_m: float, sigma_m_s: float
) -> Solution:
    """What GNSS says of the first antenna at sample ``k``."""
    nav, arm = truth.nav[k], np.array(settings.lever_arms_body_m[0])
    rotation, earth = nav[6:15].reshape(3, 3), earth_rate_local_rad_s(nav[0])
    turn = rotation_enu_from_ecef(nav[0], nav[1])
    offset = rotation @ arm
    velocity = nav[3:6] + rotation @ np.cross(truth.samples[k, 3:], arm) - np.cross(earth, offset)
    position = ecef_from_geodetic(nav[0], nav[1], nav[2]) + turn.T @ (offset + sigma_m * rng.normal(size=3))
    return Solution(
        "T", int(truth.t_gps_ns[k]), int(truth.t_gps_ns[k]), Status.RTK_FIXED, "", 20, position, None,
        np.eye(3) * sigma_m**2, velocity + sigma_m_s * rng.normal(size=3),
        extras=dict.fromkeys(("sigma_ve_m_s", "sigma_vn_m_s", "sigma_vu_m_s"), sigma_m_s),
    )  # fmt: skip


def error_local(truth: Floats, biases: Floats, estimate: Floats) -> Floats:
    """Error state (15,): truth less estimate, local frame."""
    turn = rotation_enu_from_ecef(estimate[0], estimate[1])
    out = np.empty(15)
    out[0:3] = turn @ (ecef_from_geodetic(*truth[0:3]) - ecef_from_geodetic(*estimate[0:3]))
    out[3:6] = truth[3:6] - estimate[3:6]
    difference = truth[6:15].reshape(3, 3) @ estimate[6:15].reshape(3, 3).T
    out[6:9] = 0.5 * np.array(
        [
            difference[2, 1] - difference[1, 2],
            difference[0, 2] - difference[2, 0],
            difference[1, 0] - difference[0, 1],
        ]
    )
    out[9:15] = biases - estimate[15:21]
    return out
