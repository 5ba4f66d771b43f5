"""Phase wind-up: the carrier phase turns with the two antennas (J. T. Wu et al., Manuscripta Geodaetica 18, 1993)."""

import math

import numpy as np
from numba import njit

from plumbline.records import Floats


@njit(cache=True)
def _dipole(unit: Floats, x: Floats, y: Floats, sign: float) -> Floats:
    """Effective dipole x − k (k·x) ± k × y: eqs 28 (transmitter, minus) and 29 (receiver, plus)."""
    dipole: Floats = x - unit * np.dot(unit, x) + sign * np.cross(unit, y)
    return dipole


@njit(cache=True)
def windup_cycles(to_receiver: Floats, body: Floats, north: Floats, west: Floats, previous_cycles: float) -> float:
    """Wind-up, cycles, *added* to the modelled phase; continuous with ``previous_cycles`` (NaN: an arc begins).

    ``to_receiver`` unit vector satellite → receiver (3,), ``body`` satellite axes as rows (3, 3), ``north`` and
    ``west`` the receiver antenna's x and y (3,); all Earth-fixed.
    """
    transmitter = _dipole(to_receiver, body[0], body[1], -1.0)
    receiver = _dipole(to_receiver, north, west, 1.0)
    norm = math.sqrt(np.dot(transmitter, transmitter) * np.dot(receiver, receiver))
    cosine = min(1.0, max(-1.0, np.dot(transmitter, receiver) / norm))
    phase = math.acos(cosine) / (2.0 * math.pi)
    if np.dot(to_receiver, np.cross(transmitter, receiver)) < 0.0:
        phase = -phase
    if math.isnan(previous_cycles):
        return phase
    return phase + math.floor(previous_cycles - phase + 0.5)
