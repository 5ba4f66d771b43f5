"""A MEMS accelerometer on the structure: specific force in its own axes, with the errors of its kind."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from plumbline.constants import STANDARD_GRAVITY_M_S2
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, InertialBlock
from plumbline_dtu.simulation.motion import Motion

_G: Final = STANDARD_GRAVITY_M_S2


@dataclass(frozen=True, slots=True)
class Accelerometer:
    """Errors of a sensor, one sigma, per axis; ``rotation_enu_from_sensor`` is its mounting."""

    noise_m_s2: tuple[float, float, float]  # white, at the sampling rate itself
    bias_m_s2: tuple[float, float, float]
    drift_m_s2_sqrt_s: float = 1e-6  # random walk of the bias
    resolution_m_s2: float = _G / 5400.0
    rotation_enu_from_sensor: tuple[tuple[float, float, float], ...] = (
        (1.0, 0.0, 0.0),
        (0.0, 1.0, 0.0),
        (0.0, 0.0, 1.0),
    )
    jitter_m_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)  # differenced white noise: above the band that integrates


def sca3300(rate_hz: float, seed: int, tilt_deg: float = 0.8) -> Accelerometer:
    """Murata SCA3300-D01 (data sheet): 37 µg/√Hz, offset ±20 mg, ±1.5 g at 5400 LSB/g, mounted nearly level."""
    random = np.random.default_rng([seed, 3300])
    noise = 37e-6 * _G * math.sqrt(rate_hz / 2.0)
    bias = random.normal(0.0, 7e-3 * _G, 3)
    rotation = small_rotation(random.normal(0.0, math.radians(tilt_deg), 3))
    return Accelerometer((noise, noise, noise), _triple(bias), rotation_enu_from_sensor=rotation)


def wang_2023() -> Accelerometer:
    """The same sensor as Wang 2023 saw it on a roof at 50 Hz: scatter and offsets of table 3.

    White noise of table 3's scatter would walk 0.7 mm/s within a second, as much as table 4's velocities scatter after
    fusion: most of it must lie above the band that integrates. So the data sheet's density is white, in the axes'
    proportion, and the rest is differenced noise.
    """
    scatter = np.array([4.777e-3, 3.381e-3, 4.844e-3])  # table 3
    white = 37e-6 * _G * math.sqrt(50 / 2.0) * scatter / scatter.mean()
    resolution = _G / 5400.0
    jitter = np.sqrt((scatter**2 - white**2 - resolution**2 / 12.0) / 2.0)
    bias = (0.12812, 0.147064, 9.760765 - _G)
    return Accelerometer(_triple(white), bias, resolution_m_s2=resolution, jitter_m_s2=_triple(jitter))


def small_rotation(angles_rad: Sequence[float] | Floats) -> tuple[tuple[float, float, float], ...]:
    """Rotation by small angles about east, north and up, as rows."""
    a, b, c = (float(angle) for angle in angles_rad)
    rx = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    ry = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    rz = np.array([[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]])
    return tuple(_triple(row) for row in rz @ ry @ rx)


def _triple(values: Floats) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


class Sampler:
    """Blocks of samples in order; the drift is the only memory."""

    def __init__(self, sensor: Accelerometer, motion: Motion, rate_hz: int, seed: int) -> None:
        self._sensor, self._motion, self._rate_hz = sensor, motion, rate_hz
        self._random = np.random.default_rng([seed, 77])
        self._drift = np.zeros(3)
        self._last_jitter = np.zeros((1, 3))

    def block(self, t_first_gps_ns: int, first: int, n: int) -> InertialBlock:
        """Samples ``first`` … ``first + n − 1`` of the second that begins at ``t_first_gps_ns``."""
        interval_ns = NS_PER_S // self._rate_hz
        times = t_first_gps_ns + interval_ns * np.arange(first, first + n, dtype=np.int64)
        force = self._motion(times).acceleration_m_s2 + np.array([0.0, 0.0, _G])
        force = force @ np.array(self._sensor.rotation_enu_from_sensor)  # rows: Rᵀ f
        steps = self._random.normal(0.0, self._sensor.drift_m_s2_sqrt_s / math.sqrt(self._rate_hz), (n, 3))
        drift = self._drift + np.cumsum(steps, axis=0)
        self._drift = drift[-1]
        noise = self._random.normal(0.0, 1.0, (n, 3)) * self._sensor.noise_m_s2 + self._jitter(n)
        raw = force + self._sensor.bias_m_s2 + drift + noise
        resolution = self._sensor.resolution_m_s2
        return InertialBlock(
            t_first_gps_ns=int(times[0]),
            t_receive_ns=int(times[-1]),
            interval_ns=interval_ns,
            specific_force_m_s2=np.round(raw / resolution) * resolution,
            temperature_c=20.0,
        )

    def _jitter(self, n: int) -> Floats:
        if not any(self._sensor.jitter_m_s2):
            return np.zeros((n, 3))
        steps = np.vstack((self._last_jitter, self._random.normal(0.0, 1.0, (n, 3)) * self._sensor.jitter_m_s2))
        self._last_jitter = steps[-1:]
        return np.asarray(np.diff(steps, axis=0), float)
