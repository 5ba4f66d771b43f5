"""The filter's own opinion of itself against data that fit its model: NIS and NEES lie in their bands; and twins of
it.
"""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.signal import butter, sosfilt
from scipy.stats import chi2
from tests.unit.fusion.scenes import T0, S, block, solution

from plumbline.config import FusionSettings
from plumbline.fusion import initial_state, receive_inertial, receive_solution
from plumbline.fusion.offline import FusedSeries, fuse_series
from plumbline.records import Floats

RATE = 50
SETTINGS = FusionSettings(shaking_noise_sqrt_s=0.0, shaking_drift_sqrt_hz=0.0, baseline_drift_m_s2_sqrt_s=3e-5)


def simulated(rng: np.random.Generator, n_s: int, factor: Floats) -> tuple[Floats, Floats, Floats]:
    """A sway, its samples and its solutions, with the noises of SETTINGS and a full solution covariance.

    Returns truth (n_s, 9) at the solutions, samples (n_s · RATE, 3), solutions (n_s, 3).
    """
    dt, n = 1 / RATE, n_s * RATE
    t = np.arange(n) * dt
    omega = 2 * np.pi * 0.3
    axes = np.array([1.0, 0.5, -0.3])
    displacement = np.outer(0.03 * np.sin(omega * t), axes)
    velocity = np.outer(0.03 * omega * np.cos(omega * t) - 0.03 * omega, axes)  # at rest at the start
    displacement -= np.outer(0.03 * omega * t, axes)
    acceleration = np.outer(-0.03 * omega**2 * np.sin(omega * t), axes)
    drift = np.cumsum(rng.normal(0, SETTINGS.baseline_drift_m_s2_sqrt_s * np.sqrt(dt), (n, 3)), axis=0)
    noise = rng.normal(0, SETTINGS.acceleration_noise_m_s2_sqrt_hz / np.sqrt(dt), (n, 3))
    measured = displacement[::RATE] + rng.normal(size=(n_s, 3)) @ factor.T
    truth = np.hstack([displacement, velocity, drift])[::RATE]
    return truth, acceleration + drift + noise, measured


def test_nis_and_nees_lie_in_their_95_percent_bands() -> None:
    """Bar-Shalom, Li & Kirubarajan 2001, section 5.4: sums of NIS over an honest run are chi-squared."""
    rng = np.random.default_rng(42)
    factor = np.array([[5e-3, 0, 0], [2e-3, 4e-3, 0], [-3e-3, 1e-3, 9e-3]])
    n_s, skipped = 600, 30
    truth, samples, measured = simulated(rng, n_s, factor)
    state, nis, nees = initial_state("A"), [], []
    for k in range(n_s):
        made = solution(T0 + k * S, measured[k], covariance_enu_m2=factor @ factor.T)
        state, _, _ = receive_solution(state, made, SETTINGS)
        piece = samples[k * RATE : (k + 1) * RATE]
        state, _, met = receive_inertial(state, block(T0 + k * S, piece, S // RATE), SETTINGS)
        nis += [v.nis for v in met]
        entry = state.seconds[-1].entry
        if k >= skipped and k % 20 == 0 and entry.t_gps_ns is not None:
            error = entry.x - truth[k] - np.concatenate([-truth[k, 3:6] / RATE, np.zeros(6)])
            error[3:6] = entry.x[3:6] - truth[k, 3:6] + (samples[k * RATE] - truth[k, 6:9]) / RATE
            nees.append(float(error @ np.linalg.solve(entry.p, error)))
    used = nis[skipped:]
    low, high = chi2.ppf([0.025, 0.975], 3 * len(used))
    assert low < sum(used) < high
    low, high = chi2.ppf([0.0005, 0.9995], 9 * len(nees))
    assert low < sum(nees) < high


def test_innovations_are_white() -> None:
    """Lag-one correlation of the whitened innovations of an honest run is zero within its 99 % band (1/√n)."""
    rng = np.random.default_rng(3)
    _, samples, measured = simulated(rng, 800, np.diag([5e-3, 5e-3, 1e-2]))
    fused = fuse_series(T0 + S * np.arange(800), measured, T0, S // RATE, samples, SETTINGS, gravity_removed=True)
    white = np.array([v.whitened for v in fused.innovations])[30:]
    correlation = (white[1:] * white[:-1]).mean(axis=0) / (white**2).mean(axis=0)
    assert np.abs(correlation).max() < 2.58 / np.sqrt(len(white))


# ------------------------------------------------------------------------------------------- Wang 2023, tables 3 and 4

TABLE_3_STD_M_S2 = np.array([4.777, 3.381, 4.844]) * 1e-3
SCA3300_DENSITY_M_S2 = 37e-6 * 9.80665  # data sheet, one-sided, per √Hz


def static_station(white_m: Floats, slow_m: Floats, seed: int = 1, n_s: int = 2400) -> FusedSeries:
    """A station that stands, with Wang's sensors.

    Samples: white noise of the SCA3300's density (between the axes in the proportion of table 3), roof vibration
    above 5 Hz up to table 3's scatter, mounting bias of table 3. Solutions: white noise and a slow part (first-order
    Gauss-Markov, 300 s), and the covariance of their sum.
    """
    rng = np.random.default_rng(seed)
    n = n_s * RATE
    density = SCA3300_DENSITY_M_S2 * TABLE_3_STD_M_S2 / TABLE_3_STD_M_S2.max()
    samples = rng.normal(size=(n, 3)) * density * np.sqrt(RATE / 2)
    roof = sosfilt(butter(4, 5, "high", fs=RATE, output="sos"), rng.normal(size=(n, 3)), axis=0)
    samples += roof / roof.std(axis=0) * np.sqrt(TABLE_3_STD_M_S2**2 - samples.var(axis=0))
    samples += np.array([0.1286, 0.1471, 9.7602 - 9.80665])
    slow, keep = np.zeros((n_s, 3)), np.exp(-1 / 300)
    for k in range(1, n_s):
        slow[k] = keep * slow[k - 1] + rng.normal(size=3) * np.sqrt(1 - keep**2)
    measured = rng.normal(size=(n_s, 3)) * white_m + slow * slow_m
    times = T0 + S * np.arange(n_s)
    sigma = np.hypot(white_m, slow_m)
    settings = FusionSettings()
    return fuse_series(
        times, measured, T0, S // RATE, samples, settings, gravity_removed=True, sigma_displacement_m=sigma
    )


def test_static_station_is_as_quiet_as_wang_tables_3_and_4() -> None:
    """Scatter of 30 minutes after ten of settling.

    The white part of the solutions (3/3/4.5 mm) decides over table 4: an optimal filter's velocity scatter is
    √(√2 q^¾ r^¼), so 5/5/10 mm would leave 0.65/0.58/0.86 mm/s whatever the filter.
    """
    fused = static_station(np.array([3e-3, 3e-3, 4.5e-3]), np.array([3e-3, 3e-3, 1e-3]))
    settled = slice(600 * RATE, None)
    displacement = fused.displacement_enu_m[settled].std(axis=0) * 1e3
    velocity = fused.velocity_enu_m_s[settled].std(axis=0) * 1e3
    acceleration = fused.acceleration_enu_m_s2[settled].std(axis=0) * 1e3
    print("static station, mm, mm/s, mm/s²:", displacement, velocity, acceleration)
    assert (displacement <= [4.8, 11.1, 3.1]).all()
    assert (velocity <= [0.704, 0.515, 0.711]).all()
    assert (acceleration <= [4.807, 3.395, 4.85]).all()
    assert np.abs(fused.acceleration_enu_m_s2[settled].mean(axis=0)).max() < 2e-5  # table 3: 0.0001 cm/s²


def steps(n: int) -> tuple[Floats, Floats]:
    """A and Q of eq. 3 for one axis over ``n`` samples, (3, 3) each."""
    t, q_a, q_u = 1 / RATE, SETTINGS.acceleration_noise_m_s2_sqrt_hz**2, SETTINGS.baseline_drift_m_s2_sqrt_s**2
    one = np.array([[1, t, -t * t / 2], [0, 1, -t], [0, 0, 1]])
    noise = np.array([[t**3 * q_a / 3, t**2 * q_a / 2, 0], [t**2 * q_a / 2, t * q_a, 0], [0, 0, t * q_u]])
    a, q = np.eye(3), np.zeros((3, 3))
    for _ in range(n):
        a, q = one @ a, one @ q @ one.T + noise
    return a, q


@pytest.mark.parametrize("sigma_m", [0.003, 0.01])
def test_steady_state_is_the_riccati_equations(sigma_m: float) -> None:
    """Covariance against SciPy's solution of the discrete Riccati equation."""
    n_s = 600
    fused = fuse_series(
        T0 + S * np.arange(n_s),
        np.zeros((n_s, 3)),
        T0,
        S // RATE,
        np.zeros((n_s * RATE, 3)),
        SETTINGS,
        gravity_removed=True,
        sigma_displacement_m=(sigma_m,) * 3,
    )
    a, q = steps(RATE)
    h, r = np.array([[1.0, 0.0, 0.0]]), np.array([[sigma_m**2]])
    prior = solve_discrete_are(a.T, h.T, q, r)
    posterior = prior - prior @ h.T @ np.linalg.inv(h @ prior @ h.T + r) @ h @ prior
    a, q = steps(RATE - 1)  # the head is the last sample of a second
    np.testing.assert_allclose(fused.state.head.p[0::3, 0::3], a @ posterior @ a.T + q, rtol=1e-6)
