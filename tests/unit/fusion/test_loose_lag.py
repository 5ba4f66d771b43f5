"""The age of a receiver's velocities. Oracle: receivers simulated with a known one."""

import math

import numpy as np
import pytest

from plumbline.fusion.loose_lag import velocity_lag_s
from plumbline.gnss.earth_frames import ecef_from_geodetic, rotation_enu_from_ecef
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, Solution, Status

PLACE = np.array([0.7, -1.8, 1600.0])


def path(t: Floats) -> Floats:
    """A winding drive, ENU, m."""
    return np.column_stack([60 * np.sin(0.11 * t) + 8 * t, 45 * np.sin(0.17 * t + 1), 0 * t])


def log(lag_s: float, interval_s: float, n: int, noise_m: float, size: float = 1.0) -> list[Solution]:
    """Positions with noise; velocities the mean over twice the lag, or of the moment."""
    rng, t = np.random.default_rng(2), interval_s * np.arange(n)
    turn, origin = rotation_enu_from_ecef(PLACE[0], PLACE[1]), ecef_from_geodetic(*PLACE)
    half = max(lag_s, 1e-3)
    velocity = (
        size * (path(t) - path(t - 2 * half)) / (2 * half)
        if lag_s
        else size * (path(t + half) - path(t - half)) / (2 * half)
    )
    position = origin + (size * path(t) + noise_m * rng.normal(size=(n, 3))) @ turn
    velocity = velocity + 0.01 * rng.normal(size=(n, 3))
    return [
        Solution(
            "T", round(k * interval_s * NS_PER_S), 0, Status.RTK_FIXED, "", 9, position[k], None, None, velocity[k]
        )
        for k in range(n)
    ]


@pytest.mark.parametrize(("lag_s", "interval_s"), [(0.125, 0.25), (0.0, 0.25), (0.05, 0.1), (0.5, 1.0), (0.1, 1.0)])
def test_the_lag_is_found(lag_s: float, interval_s: float) -> None:
    """Within four sigmas, which are milliseconds; outliers do not count."""
    solutions = log(lag_s, interval_s, 800, 0.005)
    for k in range(0, 800, 60):
        solutions[k].position_ecef_m[:] += 5.0  # type: ignore[index]
    found, sigma = velocity_lag_s(solutions)
    assert sigma < 0.005
    assert found == pytest.approx(lag_s, abs=max(4 * sigma, 0.004))


def test_standing_tells_nothing() -> None:
    """Without motion, or with few positions, there is nothing to tell it by."""
    assert velocity_lag_s(log(0.125, 0.25, 400, 0.005, size=0.0)) == (0.0, math.inf)
    assert velocity_lag_s(log(0.125, 0.25, 30, 0.005)) == (0.0, math.inf)
