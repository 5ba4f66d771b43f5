"""Whether the filter's claims of accuracy are true: NEES and NIS over drawn worlds that obey its noise model.

Bands: 99.9 % of chi-square (Bar-Shalom, Li & Kirubarajan 2001, 5.4).
"""

import numpy as np
import pytest
from scipy.stats import chi2

from plumbline.positioning import ppp
from plumbline.positioning.ppp import step_with_quality
from plumbline.positioning.ppp_noise import tuning_of
from plumbline.positioning.state import initial_state

from . import ppp_world
from .ppp_world import Receiver, Sky, settings_of

_RUNS = 10
_EPOCHS = 100


def _run(sky, settings, seed):
    """States of a run: (solution, quality) of every epoch."""
    receiver, state = Receiver(sky, settings, seed), initial_state()
    for _ in range(_EPOCHS):
        state, solution, quality = step_with_quality(state, receiver.observe(), sky, settings, receiver.facts)
        assert solution.status.has_position, solution.reason
        yield solution, quality


@pytest.mark.parametrize("motion", ["kinematic", "static"])
def test_position_errors_are_as_large_as_claimed(motion):
    """Oracle: the chi-square distribution of NEES with 3 degrees of freedom a run, at four instants."""
    instants, totals = (1, 20, 60, _EPOCHS - 1), np.zeros(4)
    for seed in range(_RUNS):
        run = list(_run(Sky(), settings_of(motion=motion), seed))
        for i, k in enumerate(instants):
            error_m, covariance_m2 = run[k][0].displacement_enu_m, run[k][0].covariance_enu_m2
            totals[i] += error_m @ np.linalg.solve(covariance_m2, error_m)
    for total in totals:
        assert chi2.ppf(0.0005, 3 * _RUNS) < total < chi2.ppf(0.9995, 3 * _RUNS)


@pytest.mark.parametrize("motion", ["kinematic", "static"])
def test_innovations_are_as_large_as_claimed(motion, monkeypatch):
    """Oracle: the chi-square distribution of NIS, where the codes have white noise alone and the gains the true model.

    The receiver clock, a kinematic position and new ambiguities are free in an epoch: each takes a degree of freedom.
    """
    white = tuning_of(settings_of(motion=motion))._replace(gps_bias_m=0.0, galileo_bias_m=0.0)
    white = white._replace(ambiguity_error_m_sqrt_s=white.ambiguity_m_sqrt_s)
    for module in (ppp, ppp_world):
        monkeypatch.setattr(module, "tuning_of", lambda settings: white)
    total, freedom = 0.0, 0.0
    for seed in range(6):
        for solution, quality in list(_run(Sky(), settings_of(motion=motion), seed))[20:]:
            total += quality.nis
            free = (4 if motion == "kinematic" else 1) + solution.extras["new_ambiguities"]
            freedom += quality.used.sum() - free
    assert chi2.ppf(0.0005, freedom) < total < chi2.ppf(0.9995, freedom)
