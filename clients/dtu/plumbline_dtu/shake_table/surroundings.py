"""Multipath from where it comes from: walls and railings around an antenna, each sending a copy of every signal.

A copy arrives later by ``|p − a| − u · (p − a)`` (scatterer p, antenna a, u towards the satellite), and the receiver
tracks the sum. So its error is slow for a resting antenna as the satellite moves (minutes for metres of distance),
constant for a geostationary satellite, different at antennas a metre apart although the walls are the same, larger for
low satellites, which the antenna's pattern favours less over its surroundings, and it moves with the vibration itself.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit

from plumbline.records import Floats

_NEAR: Final = (4, 3.0, 12.0, -1.0, 4.0)  # how many, distance and height from … to, m: the platform itself
_FAR: Final = (4, 12.0, 40.0, -10.0, 20.0)  # the buildings around
_CODE_REACH_M: Final = 4.0  # a correlator that mitigates multipath lets later copies than this move the code no further
_ZENITH_SHARE: Final = 0.3  # of the reflection at the horizon


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Scatterers (k, 3), ENU from the antennas' platform at rest, and by satellite (s, k) their strength and phase."""

    scatterer_enu_m: Floats
    strength: Floats
    phase_rad: Floats


def surroundings(n_satellites: int, reflection: float, seed: list[int]) -> Surroundings:
    """A place of its own for every seed; strengths are Rayleigh's (rough walls), ``reflection`` in all."""
    random = np.random.default_rng(seed)
    places = np.vstack([_scatterers(random, *kind) for kind in (_NEAR, _FAR)])
    shape = (n_satellites, len(places))
    strength = random.rayleigh(math.sqrt(0.5), shape) * reflection / math.sqrt(len(places))
    return Surroundings(places, strength, random.uniform(0.0, 2.0 * math.pi, shape))


def _scatterers(
    random: np.random.Generator, n: int, nearest_m: float, farthest_m: float, lowest_m: float, highest_m: float
) -> Floats:
    azimuth, distance_m = random.uniform(0.0, 2.0 * math.pi, n), random.uniform(nearest_m, farthest_m, n)
    up_m = random.uniform(lowest_m, highest_m, n)
    return np.column_stack([distance_m * np.sin(azimuth), distance_m * np.cos(azimuth), up_m])


@njit(cache=True)
def multipath(
    unit_enu: Floats,
    antenna_enu_m: Floats,
    scatterer_enu_m: Floats,
    strength: Floats,
    phase_rad: Floats,
    wavelength_m: Floats,
) -> tuple[Floats, Floats]:
    """Errors of phase and code, m, (e, s) each, at e epochs and s satellites.

    ``unit_enu`` (e, s, 3) towards the satellites, ``antenna_enu_m`` (e, 3), and the fields of :class:`Surroundings`.
    The phase error is that of the sum of direct and delayed signals; the code's is that of a loop for short delays.
    """
    n_epochs, n_satellites = unit_enu.shape[0], unit_enu.shape[1]
    phase_m, code_m = np.zeros((n_epochs, n_satellites)), np.zeros((n_epochs, n_satellites))
    for e in range(n_epochs):
        for s in range(n_satellites):
            u = unit_enu[e, s]
            gain = _ZENITH_SHARE + (1.0 - _ZENITH_SHARE) * math.sqrt(max(0.0, 1.0 - u[2] * u[2]))
            along, across = 1.0, 0.0
            for k in range(scatterer_enu_m.shape[0]):
                away = scatterer_enu_m[k] - antenna_enu_m[e]
                detour_m = math.sqrt(np.sum(away * away)) - np.sum(u * away)
                turn = 2.0 * math.pi * detour_m / wavelength_m[s] + phase_rad[s, k]
                copy = gain * strength[s, k]
                along += copy * math.cos(turn)
                across += copy * math.sin(turn)
                code_m[e, s] += copy * math.cos(turn) * min(detour_m, _CODE_REACH_M)
            phase_m[e, s] = wavelength_m[s] * math.atan2(across, along) / (2.0 * math.pi)
    return phase_m, code_m
