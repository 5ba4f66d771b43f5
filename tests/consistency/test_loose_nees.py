"""The loose filter believes itself as much as it deserves, over many simulated drives.

Oracle: the chi-square distribution of NEES and NIS; everything drawn from the model that the filter has.
"""

import numpy as np
from scipy.stats import chi2
from tests.unit.fusion.inertial_scenes import drive, error_local, measured, solution_at, truth_of

from plumbline.config import InertialSettings
from plumbline.fusion.error_model import feed_back
from plumbline.fusion.loose_eskf import initial_loose_state, receive_samples, receive_solution
from plumbline.fusion.loose_start import start
from plumbline.fusion.loose_state import LooseExtra
from plumbline.fusion.timeline import Node

RUNS, EVERY = 100, 25
SETTINGS = InertialSettings(
    lever_arms_body_m=((0.3, -0.5, 0.8),), standstill="off",
    initial_accelerometer_bias_sigma_m_s2=0.02, initial_gyroscope_bias_sigma_rad_s=2e-4,
    accelerometer_bias_sigma_m_s2=2e-3, gyroscope_bias_sigma_rad_s=2e-5,
    accelerometer_bias_time_s=300.0, gyroscope_bias_time_s=300.0,
)  # fmt: skip
FIRST_SIGMA = np.repeat([0.02, 0.05, 0.01, 0.02, 2e-4], 3)


def one_run(truth, seed: int) -> tuple[list[float], list[float]]:  # type: ignore[no-untyped-def]
    """NEES after each solution, and its NIS components' mean square."""
    rng = np.random.default_rng(seed)
    samples, biases = measured(truth, SETTINGS, rng)
    begin = 1100  # on the move
    nav = truth.nav[begin].copy()
    nav[15:] = biases[begin]
    feed_back(nav, np.eye(15), -FIRST_SIGMA * rng.normal(size=15), True)
    node = Node(int(truth.t_gps_ns[begin]), nav, np.diag(FIRST_SIGMA**2), LooseExtra())
    state = start(initial_loose_state("T"), node, "given", SETTINGS)
    nees, nis = [], []
    for k in range(begin - 1, len(samples) - EVERY, EVERY):
        block = slice(k, k + EVERY)
        state = receive_samples(state, truth.t_gps_ns[block], samples[block], SETTINGS).state
        at = k + EVERY - 1
        result = receive_solution(state, solution_at(truth, at, SETTINGS, rng, 0.01, 0.03), SETTINGS)
        state, found = result.state, result.innovations[-1]
        node = state.timeline.nodes[-1]
        error = error_local(truth.nav[at], biases[at], node.nav)
        nees.append(float(error @ np.linalg.solve(node.p, error)))
        nis.append(float(np.mean((found.value / found.sigma) ** 2)))
    return nees, nis


def test_nees_of_100_drives() -> None:
    """The mean NEES of the 15 states lies in its 95 % band over 100 runs; innovations have the variance expected."""
    truth = truth_of(drive, 26.0)
    runs = [one_run(truth, seed) for seed in range(RUNS)]
    nees, nis = np.array([r[0] for r in runs]), np.array([r[1] for r in runs])
    low, high = chi2.ppf([0.025, 0.975], 15 * RUNS) / RUNS
    mean = nees.mean(axis=0)
    inside = ((mean > low) & (mean < high)).mean()
    print(f"mean NEES {mean.mean():.2f} (15), band {low:.2f}…{high:.2f}, inside {inside:.0%}, NIS {nis.mean():.3f}")
    assert low < nees.mean() < high
    assert inside >= 0.75
    assert 0.97 < nis.mean() < 1.03
