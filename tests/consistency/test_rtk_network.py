"""Redundant baselines. Oracles: the distribution of the adjustment's statistic, and the simulation's truth."""

import numpy as np
import pytest
from scipy.stats import chi2

from plumbline.positioning.facts import StationFacts
from plumbline.positioning.rtk_network import NetworkState, adjust, step
from plumbline.positioning.rtk_state import BaseView, no_base
from plumbline.records import Status

from .rtk_world import BASE_ECEF_M, ENU, T_NS, antenna, noisy, settings_of, sine_of, source_of

SIGMAS_M = np.array([0.004, 0.005, 0.009])
PLACES_ENU_M = {"a": np.zeros(3), "b": np.array([90.0, 10.0, 2.0]), "c": np.array([-20.0, 70.0, -1.0])}
ROVER_ENU_M = np.array([40.0, -25.0, 6.0])
SECOND = 1_000_000_000


def _draw(rng: np.random.Generator, k: int) -> np.ndarray:
    """Positions of one antenna from k bases: the rover's noise in all, each base's own, the coordinates' 2 mm."""
    own = rng.normal(size=(k, 3)) * SIGMAS_M * np.sqrt(0.5)
    return BASE_ECEF_M + rng.normal(size=3) * SIGMAS_M * np.sqrt(0.5) + own + rng.normal(size=(k, 3)) * 0.002


def test_the_statistic_is_chi_square_and_the_position_as_good_as_claimed() -> None:
    rng, covariance, runs = np.random.default_rng(1), np.diag(SIGMAS_M**2), 400
    statistics, nees, removed = 0.0, 0.0, 0
    for _ in range(runs):
        found = adjust(_draw(rng, 3), [covariance] * 3)
        removed += bool(found.left_out)
        if not found.left_out:
            statistics += found.statistic
            error = found.position_ecef_m - BASE_ECEF_M
            nees += float(error @ np.linalg.solve(found.covariance_ecef_m2, error))
    kept = runs - removed
    assert removed <= 4  # a significance of a thousandth
    assert chi2.ppf(0.0005, 6 * kept) < statistics < chi2.ppf(0.9995, 6 * kept)
    assert chi2.ppf(0.0005, 3 * kept) < nees < chi2.ppf(0.9995, 3 * kept)


def test_a_base_whose_coordinates_are_wrong_is_named() -> None:
    rng, covariance = np.random.default_rng(2), np.diag(SIGMAS_M**2)
    for wrong in range(3):
        named = 0
        for _ in range(40):
            positions = _draw(rng, 3)
            positions[wrong] += [0.04, -0.03, 0.02]
            named += adjust(positions, [covariance] * 3).left_out == (wrong,)
        assert named >= 38


def test_three_bases_one_of_them_moved() -> None:
    settings = settings_of()
    source, rng, state = source_of(settings), np.random.default_rng(3), NetworkState()
    told = {name: BASE_ECEF_M + ENU.T @ place for name, place in PLACES_ENU_M.items()}
    antennas = {name: antenna(place, 1 + k) for k, (name, place) in enumerate(PLACES_ENU_M.items())}
    rover = antenna(ROVER_ENU_M, 9)
    told["b"] = told["b"] + ENU.T @ np.array([0.05, 0.03, 0.0])
    for k in range(6):
        t = T_NS + k * SECOND
        views = []
        for name, one in antennas.items():
            epoch = one.epoch(t)
            views.append(BaseView(name, noisy(epoch, sine_of(epoch), rng), told[name]))
        if k == 5:
            views[0] = no_base("a", "last data of base a 12 s ago, limit 10 s")
        epoch = rover.epoch(t)
        state, solution, _ = step(
            state, noisy(epoch, sine_of(epoch), rng), views, source, settings, StationFacts("r")
        )  # fmt: skip
        assert solution.status is Status.RTK_FIXED
        if k < 5:
            assert solution.reason == "base b contradicts the others and is left out"
            assert solution.extras["bases"] == 2.0
            error = ENU @ (solution.position_ecef_m - BASE_ECEF_M) - ROVER_ENU_M
            assert np.linalg.norm(error) < 0.02
    assert "bases b and c disagree by" in solution.reason
    assert "last data of base a" in solution.reason


@pytest.mark.parametrize("who", ["a", "b", "rover"])
def test_of_two_bases_the_one_that_moves_is_named_and_a_motion_of_the_rover_is_not(who: str) -> None:
    """6 cm after ten epochs: of a base's antenna (its coordinates stay), or of the rover's."""
    settings = settings_of()
    source, rng, state = source_of(settings), np.random.default_rng(4), NetworkState()
    step_enu_m, told = np.array([0.05, 0.03, 0.0]), {n: BASE_ECEF_M + ENU.T @ PLACES_ENU_M[n] for n in "ab"}
    for k in range(14):
        t, moved = T_NS + k * SECOND, step_enu_m * (k >= 10)
        views = []
        for i, name in enumerate("ab"):
            epoch = antenna(PLACES_ENU_M[name] + moved * (who == name), 1 + i).epoch(t)
            views.append(BaseView(name, noisy(epoch, sine_of(epoch), rng), told[name]))
        epoch = antenna(ROVER_ENU_M + moved * (who == "rover"), 9).epoch(t)
        state, solution, seen = step(
            state, noisy(epoch, sine_of(epoch), rng), views, source, settings, StationFacts("r")
        )  # fmt: skip
        assert solution.status is Status.RTK_FIXED
        assert seen is not None
        error = ENU @ (solution.position_ecef_m - BASE_ECEF_M) - ROVER_ENU_M - moved * (who == "rover")
        assert np.linalg.norm(error) < 0.02
        expected = f"base {who} has moved since the bases agreed and is left out" if who != "rover" and k >= 10 else ""
        assert solution.reason == expected
