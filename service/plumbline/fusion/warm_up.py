"""Compiles the kernels ahead of the first epoch."""

import numpy as np

from plumbline.fusion import inertial_warm_up
from plumbline.fusion.gravity import gravity_at_m_s2
from plumbline.fusion.kernels import OUTPUTS, propagate
from plumbline.fusion.state import N_STATES


def warm_up() -> None:
    """Compile (or load from the cache) every kernel that a live station uses."""
    samples = np.zeros((2, 3))
    p = np.eye(N_STATES)
    propagate(np.zeros(N_STATES), p, np.zeros(3), samples, 0.01, 0.01, np.ones(5), np.empty((2, OUTPUTS)))
    gravity_at_m_s2((6_378_137.0, 0.0, 0.0))
    inertial_warm_up.warm_up()
