"""Noise of a static record, and the mounting of a sensor.

Oracles: closed forms of the Allan deviation (white noise, Gauss-Markov), NIST's published example, the rotation that a
simulated sensor was given.
"""

import numpy as np
import pytest
from scipy.signal import lfilter

from plumbline.errors import ContractError
from plumbline.structure.allan import allan_curve, characteristics_of
from plumbline.structure.misalignment import mounting_of

RATE = 100.0


def test_overlapping_deviation_of_nist_sp_1065() -> None:
    """Oracle: NIST SP 1065, table 31, 1000-point frequency data: 2.922319e-1, 9.159953e-2, 3.241343e-2."""
    values, n = np.empty(1000), 1234567890
    for k in range(1000):
        values[k] = n / 2147483647.0
        n = 16807 * n % 2147483647
    curve = allan_curve(values[:, None], 1.0)
    for tau, expected in ((1, 2.922319e-1), (10, 9.159953e-2), (100, 3.241343e-2)):
        if tau in curve.tau_s:
            assert curve.deviation[np.flatnonzero(curve.tau_s == tau)[0], 0] == pytest.approx(expected, rel=1e-6)
    assert {1.0, 10.0} <= set(curve.tau_s)


def test_white_noise() -> None:
    """Oracle: N / √τ."""
    rng = np.random.default_rng(0)
    density = np.array([1e-3, 5e-4, 2e-4])
    samples = rng.normal(size=(200_000, 3)) * density * np.sqrt(RATE) + [0.1, -0.2, 9.8]
    curve = allan_curve(samples, RATE)
    early = curve.tau_s < 2.0
    np.testing.assert_allclose(curve.deviation[early] * np.sqrt(curve.tau_s[early])[:, None] / density, 1.0, atol=0.05)
    np.testing.assert_allclose(characteristics_of(curve).density, density, rtol=0.05)


def test_gauss_markov_bias() -> None:
    """Oracle: the process's own parameters, to the factor of two that one record allows."""
    rng = np.random.default_rng(1)
    n, sigma, time_s, density = 2_000_000, 2e-3, 20.0, 1e-3
    memory = np.exp(-1 / (RATE * time_s))
    bias = lfilter([1.0], [1.0, -memory], rng.normal(0, sigma * np.sqrt(1 - memory**2), n))
    found = characteristics_of(allan_curve((bias + rng.normal(0, density * np.sqrt(RATE), n))[:, None], RATE))
    assert found.density[0] == pytest.approx(density, rel=0.1)
    assert 0.5 < found.markov_sigma[0] / sigma < 2.0
    assert 0.5 < found.markov_time_s[0] / time_s < 2.0
    assert not found.at_most[0]


def test_a_short_or_broken_record_is_refused() -> None:
    with pytest.raises(ContractError):
        allan_curve(np.zeros((999, 3)), RATE)
    with pytest.raises(ContractError):
        allan_curve(np.full((2000, 1), np.nan), RATE)


def test_mounting_is_found_and_offered() -> None:
    """Oracle: the rotation that the simulated sensor has about the vertical."""
    rng = np.random.default_rng(2)
    t, tg = np.arange(0, 400, 0.01), np.arange(0, 400, 1.0)

    def motion(at: np.ndarray) -> np.ndarray:
        return np.column_stack([0.1 * np.sin(0.9 * at), 0.06 * np.sin(0.7 * at + 1), 0.02 * np.sin(0.8 * at)])

    angle = np.radians(15.0)
    c, s = np.cos(angle), np.sin(angle)
    acceleration = -motion(t) * [0.81, 0.49, 0.64]
    sensor = acceleration @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]).T  # E' = E cos + N sin undoes it
    noisy = sensor + rng.normal(size=sensor.shape) * 0.005 + [0.02, -0.01, 9.8]
    gnss = motion(tg) + rng.normal(size=(tg.size, 3)) * 0.004
    found = mounting_of((tg * 1e9).astype(np.int64), gnss, 0, 10_000_000, noisy, (0.05, 0.3))
    assert np.degrees(found.angle_about_up_rad) == pytest.approx(15.0, abs=0.7)
    assert found.explained > 0.97
    assert found.explained_unturned < found.explained - 0.05
    assert "--rotation-deg=" in found.describe()
    with pytest.raises(ContractError):
        mounting_of((tg * 1e9).astype(np.int64), gnss, 0, 10_000_000, noisy, (0.05, 0.7))
