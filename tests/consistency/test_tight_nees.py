"""The tight filter believes itself as much as it deserves: NEES and NIS over many short runs (Bar-Shalom 2001, 5.4).

Oracle: the chi-square distribution. Truth, biases, ambiguities and noise are drawn anew in every run from the very
model that the filter has of held integers, starting from errors drawn from its first covariance. Until integers are
held the filter allows for errors that last, which the simulated white ones do not: then it is to be cautious.
"""

import numpy as np
import pytest
from scipy.stats import binom, chi2
from tests.unit.fusion.inertial_scenes import PLACE, measured, sway, truth_of
from tests.unit.fusion.platform_scenes import ARMS, Scene
from tests.unit.fusion.test_strapdown import error_of, nav_ecef

from plumbline.config import InertialSettings, RtkSettings
from plumbline.fusion.error_model import feed_back
from plumbline.fusion.tight_arcs import TightExtra
from plumbline.fusion.tight_multi_antenna import initial_tight_state, receive_epoch, receive_samples, start_tight
from plumbline.fusion.timeline import Node
from plumbline.gnss.earth_frames import rotation_enu_from_ecef

SPAN_S, RATE, EVERY = 3.0, 200, 10
HELD_FROM = 32  # epochs of 0.05 s: integers have been confirmed by then
SETTINGS = InertialSettings(
    lever_arms_body_m=ARMS,
    initial_accelerometer_bias_sigma_m_s2=2e-3, initial_gyroscope_bias_sigma_rad_s=5e-5,
    accelerometer_bias_sigma_m_s2=2.4e-4, gyroscope_bias_sigma_rad_s=4e-6,
    accelerometer_noise_m_s2_sqrt_hz=4.5e-4, gyroscope_noise_rad_s_sqrt_hz=1e-5,
    accelerometer_bias_time_s=1000.0, gyroscope_bias_time_s=1000.0,
)  # fmt: skip
RTK = RtkSettings()
FIRST_SIGMA = np.repeat([0.03, 0.03, 3e-3, 2e-3, 5e-5], 3)


def one_run(truth, navs, seed: int, antennas: tuple[int, ...]) -> tuple[list[float], list[float], list[int]]:  # type: ignore[no-untyped-def]
    """NEES after each epoch, NIS of each, and its degrees of freedom."""
    rng = np.random.default_rng(seed)
    samples, biases = measured(truth, SETTINGS, rng)
    nav = navs[0].copy()
    nav[15:] = biases[0]
    p = np.diag(FIRST_SIGMA**2)
    feed_back(nav, np.eye(15), -FIRST_SIGMA * rng.normal(size=15), False)
    rotation = navs[0, 6:15].reshape(3, 3)
    origin = np.array([navs[0, :3] + rotation @ arm for arm in np.array(ARMS)]) + rng.normal(size=(3, 3))
    scene = Scene(seed, 10, rotation_enu_from_ecef(PLACE[0], PLACE[1])[2], SETTINGS, origin)
    state = start_tight(initial_tight_state("P"), Node(int(truth.t_gps_ns[0]), nav, p, TightExtra()))
    nees, nis, degrees = [], [], []
    for k in range(0, len(samples) - EVERY, EVERY):
        part = slice(k + (k > 0), k + EVERY + 1)
        state = receive_samples(state, truth.t_gps_ns[part], samples[part], SETTINGS, RTK).state
        at = k + EVERY
        epoch = scene.epoch(int(truth.t_gps_ns[at]), navs[at], truth.samples[at, 3:], antennas)
        result = receive_epoch(state, epoch, SETTINGS, RTK)
        state, node = result.state, result.updated[-1]
        true = navs[at].copy()
        true[15:] = biases[at]
        error = error_of(true, node.nav, False)
        nees.append(float(error @ np.linalg.solve(node.p[:15, :15], error)))
        nis.append(node.extra.nis)
        degrees.append(node.extra.degrees)
    assert not any(node.extra.doubts for node in result.updated)
    return nees, nis, degrees


@pytest.mark.parametrize(("antennas", "runs"), [
    ((0,), 15), ((0, 1, 2), 15),
    pytest.param((0,), 100, marks=pytest.mark.soak), pytest.param((0, 1, 2), 100, marks=pytest.mark.soak),
])  # fmt: skip
def test_nees(antennas: tuple[int, ...], runs: int) -> None:
    """The mean NEES of the 15 states over the runs lies in its 95 % band for 95 % of the epochs, about."""
    truth = truth_of(sway, SPAN_S, RATE)
    navs = np.array([nav_ecef(nav) for nav in truth.nav])
    found = [one_run(truth, navs, seed, antennas) for seed in range(runs)]
    every = np.array([run[0] for run in found])
    nis, degrees = (np.array([run[k] for run in found])[:, HELD_FROM:] for k in (1, 2))
    low, high = chi2.ppf([0.025, 0.975], 15 * runs) / runs
    nees = every[:, HELD_FROM:]
    mean = nees.mean(axis=0)
    inside = (mean > low) & (mean < high)
    print(
        f"antennas {antennas}: mean NEES {mean.mean():.2f} (15), band {low:.2f}…{high:.2f}, inside "
        f"{inside.mean():.0%}, NIS {nis.sum() / degrees.sum():.3f} (1); before {every[:, :HELD_FROM].mean():.2f}"
    )
    assert (every[:, :HELD_FROM].mean(axis=0) < high).mean() > 0.9
    assert inside.mean() >= 0.75  # epochs of a run are not independent: a lucky or unlucky start stays
    assert low < nees.mean() < high
    share = (nees < chi2.ppf(0.95, 15)).mean()
    fewest, most = binom.ppf([0.01, 0.99], runs, 0.95) / runs  # a run's epochs are one sample, about
    assert fewest <= share <= most
    assert nis.sum() / degrees.sum() == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / degrees.sum()))
