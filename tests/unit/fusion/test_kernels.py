"""The sample loop against plain matrices (Wang 2023, eqs 3-5) and closed forms."""

import numpy as np
import pytest

from plumbline.fusion.kernels import OUTPUTS, propagate
from plumbline.records import Floats

NOISE = np.array([2e-7, 2e-3, 3e-9, 5e-5, 2e-3])


def matrices(t: float, q_a: float, q_u: float) -> tuple[Floats, Floats, Floats]:
    """A (9, 9), B (9, 3), Q (9, 9) of eq. 3, by Kronecker products."""
    one = np.eye(3)
    a = np.kron([[1, t, -t * t / 2], [0, 1, -t], [0, 0, 1]], one)
    b = np.kron([[t * t / 2], [t], [0]], one)
    q = np.kron([[t**3 * q_a / 3, t**2 * q_a / 2, 0], [t**2 * q_a / 2, t * q_a, 0], [0, 0, t * q_u]], one)
    return a, b, q


def twin(x: Floats, p: Floats, last: Floats, samples: Floats, t: float, noise: Floats) -> tuple[Floats, Floats, Floats]:
    """Dense matrices, one step after the other."""
    rows = np.empty((len(samples), OUTPUTS))
    for k, sample in enumerate(samples):
        if np.isnan(sample[0]):
            a, _, q = matrices(t, noise[4], noise[2])
            a[0:6, 6:9] = 0.0
            x = a @ x
        else:
            mean = sample if np.isnan(last[0]) else 0.5 * (last + sample)
            squared = float(((mean - x[6:]) ** 2).sum())
            a, b, q = matrices(t, noise[0] + noise[1] ** 2 * squared, noise[2] + noise[3] ** 2 * squared)
            x = a @ x + b @ mean
        p = a @ p @ a.T + q
        last = sample
        rows[k] = np.concatenate([x[:6], sample - x[6:], p.diagonal()[:3]])
    return x, p, rows


def some_state(rng: np.random.Generator) -> tuple[Floats, Floats]:
    root = rng.normal(size=(9, 9)) * np.repeat([1e-2, 1e-2, 1e-3], 3)[:, None]
    return rng.normal(size=9) * 0.1, root @ root.T


@pytest.mark.parametrize("rate", [50, 100, 200])
def test_agrees_with_dense_matrices_also_over_missing_samples(rate: int) -> None:
    rng = np.random.default_rng(rate)
    x, p = some_state(rng)
    samples = rng.normal(size=(3 * rate, 3))
    samples[rate : rate + 7] = np.nan
    expected_x, expected_p, expected_rows = twin(x, p, samples[0], samples, 1 / rate, NOISE)
    out = np.empty((len(samples), OUTPUTS))
    propagate(x, p, samples[0].copy(), samples, 1 / rate, 1 / rate, NOISE, out)
    np.testing.assert_allclose(x, expected_x, rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(p, expected_p, rtol=1e-10, atol=1e-16)
    np.testing.assert_allclose(out, expected_rows, rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(p, p.T, rtol=1e-12, atol=1e-17)


def test_constant_acceleration_is_a_parabola() -> None:
    acceleration, bias, rate = np.array([0.3, -0.2, 0.1]), np.array([0.05, 0.0, -0.02]), 100
    x, p = np.concatenate([np.zeros(6), bias]), np.zeros((9, 9))
    samples = np.tile(acceleration + bias, (10 * rate, 1))
    out = np.empty((len(samples), OUTPUTS))
    propagate(x, p, samples[0].copy(), samples, 1 / rate, 1 / rate, NOISE, out)
    t = np.arange(1, len(samples) + 1)[:, None] / rate
    np.testing.assert_allclose(out[:, 0:3], acceleration * t**2 / 2, atol=1e-9)
    np.testing.assert_allclose(out[:, 3:6], acceleration * t, atol=1e-10)
    np.testing.assert_allclose(out[:, 6:9], np.tile(acceleration, (len(samples), 1)), atol=1e-14)


def test_covariance_of_integrated_white_noise() -> None:
    """∫∫ and ∫ of white noise of density q: variances q t³/3 and q t (closed form)."""
    x, p, rate, q = np.zeros(9), np.zeros((9, 9)), 50, 4e-7
    samples, out = np.zeros((20 * rate, 3)), np.empty((20 * rate, OUTPUTS))
    propagate(x, p, np.zeros(3), samples, 1 / rate, 1 / rate, np.array([q, 0, 0, 0, 1.0]), out)
    np.testing.assert_allclose(p[0, 0], q * 20.0**3 / 3, rtol=1e-12)
    np.testing.assert_allclose(p[3, 3], q * 20.0, rtol=1e-12)
