"""GLONASS broadcast orbits: the message's state vector, integrated in PZ-90 (GLONASS ICD L1, L2, 5.1, A.3.1.2)."""

import math

import numpy as np
from numba import njit

from plumbline.constants import EARTH_GM_GLONASS_M3_S2, EARTH_ROTATION_RATE_GLONASS_RAD_S
from plumbline.records import Floats

STEP_S = 60.0  # of the fourth-order Runge-Kutta integration: below a millimetre over 15 minutes
_RADIUS_M = 6_378_136.0  # PZ-90.11
_J2 = 1.0826257e-3  # PZ-90.11, normalised −484165e-9 · −√5


@njit(cache=True)
def _derivative(state: Floats, luni_solar_m_s2: Floats, out: Floats) -> None:
    """d/dt of (position, velocity) in the turning frame: ICD eq. A.1, the luni-solar acceleration held constant."""
    x, y, z = state[0], state[1], state[2]
    r2 = x * x + y * y + z * z
    r = math.sqrt(r2)
    central = -EARTH_GM_GLONASS_M3_S2 / (r2 * r)
    oblate = 1.5 * _J2 * EARTH_GM_GLONASS_M3_S2 * _RADIUS_M * _RADIUS_M / (r2 * r2 * r)
    polar = 5.0 * z * z / r2
    omega = EARTH_ROTATION_RATE_GLONASS_RAD_S
    out[0], out[1], out[2] = state[3], state[4], state[5]
    horizontal = central - oblate * (1.0 - polar) + omega * omega
    out[3] = horizontal * x + 2.0 * omega * state[4] + luni_solar_m_s2[0]
    out[4] = horizontal * y - 2.0 * omega * state[3] + luni_solar_m_s2[1]
    out[5] = (central - oblate * (3.0 - polar)) * z + luni_solar_m_s2[2]


@njit(cache=True)
def integrate(state: Floats, luni_solar_m_s2: Floats, duration_s: float) -> Floats:
    """State (6,) [m, m/s] in PZ-90 after ``duration_s`` (either sign), by Runge-Kutta steps of at most ``STEP_S``."""
    x = state.copy()
    if duration_s == 0.0:
        return x
    steps = math.ceil(abs(duration_s) / STEP_S)
    h = duration_s / steps
    k1, k2, k3, k4, trial = np.empty(6), np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    for _ in range(steps):
        _derivative(x, luni_solar_m_s2, k1)
        for i in range(6):
            trial[i] = x[i] + 0.5 * h * k1[i]
        _derivative(trial, luni_solar_m_s2, k2)
        for i in range(6):
            trial[i] = x[i] + 0.5 * h * k2[i]
        _derivative(trial, luni_solar_m_s2, k3)
        for i in range(6):
            trial[i] = x[i] + h * k3[i]
        _derivative(trial, luni_solar_m_s2, k4)
        for i in range(6):
            x[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
    return x
