"""What the atmosphere and the surroundings add: ionosphere, wet delay, multipath, noise."""

import math
from typing import Final

import numpy as np

from plumbline.gps_time import DAY_NS, NS_PER_S
from plumbline.records import Floats

_SHELL_M: Final = 350e3
_RADIUS_M: Final = 6_371e3
_TECU_DELAY: Final = 40.3e16  # m Hz² per TECU
_HOUR_NS: Final = 3600 * NS_PER_S


def slant_tecu(t_gps_ns: int, longitude_rad: float, elevation_rad: Floats, azimuth_rad: Floats) -> Floats:
    """Slant electron content through a thin shell at 350 km: a daily bulge at 14 h local time, and a gradient south."""
    local_h = (t_gps_ns % DAY_NS) / _HOUR_NS + longitude_rad * 12.0 / math.pi
    vertical = 6.0 + 14.0 * max(0.0, math.cos((local_h - 14.0) * math.pi / 12.0))
    sine_zenith = _RADIUS_M * np.cos(elevation_rad) / (_RADIUS_M + _SHELL_M)
    piercing = math.pi / 2 - elevation_rad - np.arcsin(sine_zenith)  # angle at the Earth's centre
    south = 1.0 - 1.5 * piercing * np.cos(azimuth_rad)
    return np.asarray(vertical * south / np.sqrt(1.0 - sine_zenith**2))


def ionosphere_m(tecu: Floats, frequency_hz: Floats) -> Floats:
    """Code delay, m (the phase's is its negative)."""
    return _TECU_DELAY * tecu / frequency_hz**2


def wet_departure_m(t_gps_ns: int, seed: int) -> float:
    """Departure of the zenith wet delay from its climatological value, m: slow waves of about 1.5 cm."""
    hours = (t_gps_ns % (7 * DAY_NS)) / _HOUR_NS
    return 0.010 * math.sin(hours * 0.9 + seed) + 0.005 * math.sin(hours * 2.3 + 2.0 * seed)


class CorrelatedNoise:
    """First-order Gauss–Markov noise by key, unit variance, deterministic in the order of calls."""

    def __init__(self, random: np.random.Generator, time_constant_s: float) -> None:
        self._random, self._time_constant_s = random, time_constant_s
        self._values: dict[int, float] = {}

    def next(self, keys: list[int], step_s: float) -> Floats:
        """The next value of each key, (n,)."""
        memory = math.exp(-step_s / self._time_constant_s)
        fresh = self._random.normal(0.0, 1.0, len(keys))
        for k, key in enumerate(keys):
            before = self._values.get(key)
            value = fresh[k] if before is None else memory * before + math.sqrt(1.0 - memory * memory) * fresh[k]
            self._values[key] = float(value)
        return np.array([self._values[key] for key in keys])


def repeating_multipath(azimuth_rad: Floats, elevation_rad: Floats, band: int) -> Floats:
    """What comes back whenever a satellite stands in the same direction, about unit size at low elevation, (n,)."""
    fringes = 25.0 + 6.0 * band
    wave = np.sin(fringes * np.sin(elevation_rad) + 3.0 * azimuth_rad + band)
    return np.asarray(wave * np.cos(elevation_rad) ** 2)
