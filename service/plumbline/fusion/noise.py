"""The IMU's settings and samples in the form that the filters' kernels take."""

import numpy as np

from plumbline.config import InertialSettings
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, InertialBlock, Ints


def noise_row(settings: InertialSettings) -> Floats:
    """The settings' noise as the kernels take it, (9,)."""
    return np.array(
        [
            settings.accelerometer_noise_m_s2_sqrt_hz, settings.gyroscope_noise_rad_s_sqrt_hz,
            settings.accelerometer_bias_sigma_m_s2, settings.accelerometer_bias_time_s,
            settings.gyroscope_bias_sigma_rad_s, settings.gyroscope_bias_time_s,
            settings.shaking_force_sqrt_s, settings.shaking_rate_sqrt_s, settings.gap_acceleration_m_s2_sqrt_hz,
        ]
    )  # fmt: skip


def samples_of(block: InertialBlock, settings: InertialSettings) -> tuple[Ints, Floats]:
    """Times (n,) and samples (n, 6) of a block in body axes, the time offset added."""
    n = len(block.specific_force_m_s2)
    first = block.t_first_gps_ns + round(settings.inertial_time_offset_s * NS_PER_S)
    rates = block.angular_rate_rad_s if block.angular_rate_rad_s is not None else np.full((n, 3), np.nan)
    turn = np.array(settings.rotation_body_from_sensor)
    return first + block.interval_ns * np.arange(n), np.hstack([block.specific_force_m_s2 @ turn.T, rates @ turn.T])
