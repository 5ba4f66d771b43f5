"""The IMU of the experiment: specific force and angular rate at 200 Hz in its own axes, as inertial frames."""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np
from scipy.signal import lfilter

from plumbline.constants import EARTH_ROTATION_RATE_RAD_S
from plumbline.fusion.strapdown import gravity_ecef_m_s2
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, InertialBlock, Ints
from plumbline_dtu.encoding import inertial_frame
from plumbline_dtu.shake_table.experiment import (
    IMU_RATE_HZ,
    START_GPS_NS,
    Experiment,
    ImuErrors,
    rotation_enu_from_body,
    table_motion,
)

STATION: Final = 1  # the IMU speaks for the platform
_SAMPLES: Final = 50  # a frame: a quarter of a second


def true_samples(experiment: Experiment, t_gps_ns: Ints) -> tuple[Floats, Floats]:
    """Specific force, m/s², and rate, rad/s, (n, 3) each, body axes, of the platform at GPS times (n,).

    ``f = Cᵀ (a − g + 2 ω_ie × v)`` and ``ω = Cᵀ ω_ie`` with C from body to Earth-fixed: the table shifts and does not
    turn.
    """
    motion = table_motion(experiment.schedule, t_gps_ns)
    enu = experiment.enu
    earth = np.array([0.0, 0.0, EARTH_ROTATION_RATE_RAD_S])
    velocity, acceleration = motion.velocity_m_s @ enu, motion.acceleration_m_s2 @ enu
    force = acceleration - gravity_ecef_m_s2(experiment.platform_ecef_m) + 2.0 * np.cross(earth, velocity)
    ecef_from_body = enu.T @ rotation_enu_from_body()
    return force @ ecef_from_body, np.tile(earth @ ecef_from_body, (len(t_gps_ns), 1))


def sample(experiment: Experiment) -> Iterator[tuple[int, bytes]]:
    """Frames of the IMU, (GPS time of the last sample, bytes)."""
    for block in measure(experiment):
        yield block.t_receive_ns, inertial_frame(block, STATION)


def measure(experiment: Experiment) -> Iterator[InertialBlock]:
    """What the IMU measures, a quarter of a second at a time."""
    n = round(experiment.schedule.duration_s * IMU_RATE_HZ)
    interval_ns = NS_PER_S // IMU_RATE_HZ
    times = START_GPS_NS + interval_ns * np.arange(n, dtype=np.int64)
    force, rate = true_samples(experiment, times)
    errors, random = experiment.imu, np.random.default_rng([experiment.seed, 31])
    force += _errors(random, n, errors.acceleration_noise_m_s2_sqrt_hz, errors.acceleration_instability_m_s2, errors)
    rate += _errors(random, n, errors.rate_noise_rad_s_sqrt_hz, errors.rate_instability_rad_s, errors)
    for first in range(0, n, _SAMPLES):
        part = slice(first, min(first + _SAMPLES, n))
        yield InertialBlock(int(times[part][0]), int(times[part][-1]), interval_ns, force[part], rate[part])


def _errors(random: np.random.Generator, n: int, density: float, instability: float, errors: ImuErrors) -> Floats:
    """Three axes (n, 3): white noise of a (two-sided) density, a bias at switching on, and a slow wander about it."""
    memory = math.exp(-1.0 / (IMU_RATE_HZ * errors.bias_time_s))
    steps = random.normal(0.0, instability * math.sqrt(1.0 - memory * memory), (n, 3))
    start = random.normal(0.0, errors.start_factor * instability, 3)
    wander = lfilter([1.0], [1.0, -memory], steps, axis=0)
    return random.normal(0.0, density * math.sqrt(IMU_RATE_HZ), (n, 3)) + start + wander
