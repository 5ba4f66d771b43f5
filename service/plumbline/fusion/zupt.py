"""Standing still: found in the samples, and used to estimate the biases (zero-velocity and zero-rate updates).

A window stands still when each axis of force and rate spreads less than a sensor at rest does with a margin (the
detector of Skog et al. 2010, IEEE Trans. Biomed. Eng. 57(11), with the mean taken out so that biases do not matter).
Windows lie on a grid of absolute time, so what is found does not depend on how samples arrive in blocks.

A standstill says two things: the velocity is zero, and the mean rate is the gyroscope's bias and the Earth's rate
(de Alteriis 2022, section 2: the standing condition exploited to estimate the biases).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from plumbline.config import InertialSettings
from plumbline.fusion.rotations import skew
from plumbline.fusion.strapdown import ERROR_ATTITUDE, ERROR_GYROSCOPE_BIAS, ERROR_SIZE, ERROR_VELOCITY
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, Ints

_LEAST_SAMPLES: Final = 8
_LEAST_SHARE: Final = 0.8  # of a window's span that its samples must cover


@dataclass(frozen=True, slots=True)
class Standstill:
    """A window at rest; it belongs to its last sample."""

    t_gps_ns: int
    t_first_ns: int
    mean_force_m_s2: Floats  # (3,) body axes
    mean_rate_rad_s: Floats  # (3,) body axes
    span_s: float

    @property
    def rank(self) -> int:
        """After the GNSS measurements of the same time."""
        return 1


def standstills(t_gps_ns: Ints, samples: Floats, after_ns: int, settings: InertialSettings) -> list[Standstill]:
    """Windows at rest that are complete, and end after a time.

    ``t_gps_ns`` (n,) and ``samples`` (n, 6). A window is complete once a sample beyond it is there.
    """
    if settings.standstill == "off" or not t_gps_ns.size:
        return []
    width = round(settings.standstill_window_s * NS_PER_S)
    numbers = np.arange(max(after_ns, int(t_gps_ns[0])) // width, int(t_gps_ns[-1]) // width)
    found = []
    for number in numbers:
        first, last = np.searchsorted(t_gps_ns, [number * width, (number + 1) * width])
        if last > first and int(t_gps_ns[last - 1]) > after_ns:
            window = _window(t_gps_ns[first:last], samples[first:last], width, settings)
            found += [window] if window is not None else []
    return found


def _window(t_gps_ns: Ints, samples: Floats, width_ns: int, settings: InertialSettings) -> Standstill | None:
    span_ns = int(t_gps_ns[-1] - t_gps_ns[0])
    if t_gps_ns.size < _LEAST_SAMPLES or span_ns < _LEAST_SHARE * width_ns:
        return None
    spread = samples.std(axis=0)
    if (
        spread[:3].max() > settings.standstill_force_sigma_m_s2
        or spread[3:].max() > settings.standstill_rate_sigma_rad_s
    ):
        return None
    mean = samples.mean(axis=0)
    return Standstill(int(t_gps_ns[-1]), int(t_gps_ns[0]), mean[:3], mean[3:], span_ns / NS_PER_S)


def standstill_rows(
    nav: Floats, earth_rate_frame_rad_s: Floats, standstill: Standstill, settings: InertialSettings, n_states: int
) -> tuple[Floats, Floats, Floats]:
    """Design matrix (6, n), variances (6,) and innovations (6,) of a standstill: zero velocity, known mean rate.

    The mean rate should be ``b_g + Cᵀ ω_ie``, and ``δ(Cᵀ ω_ie) = Cᵀ [ω_ie×] ψ``.
    """
    h, v = np.zeros((6, n_states)), np.zeros(6)
    rotation = nav[6:15].reshape(3, 3)
    h[0:3, ERROR_VELOCITY : ERROR_VELOCITY + 3] = np.eye(3)
    v[0:3] = -nav[3:6]
    h[3:6, ERROR_ATTITUDE : ERROR_ATTITUDE + 3] = rotation.T @ skew(earth_rate_frame_rad_s)
    h[3:6, ERROR_GYROSCOPE_BIAS:ERROR_SIZE] = np.eye(3)
    v[3:6] = standstill.mean_rate_rad_s - nav[18:21] - rotation.T @ earth_rate_frame_rad_s
    rate_variance = (
        settings.gyroscope_noise_rad_s_sqrt_hz**2 / standstill.span_s + settings.standstill_bias_sigma_rad_s**2
    )
    return h, np.repeat([settings.standstill_velocity_sigma_m_s**2, rate_variance], 3), v
