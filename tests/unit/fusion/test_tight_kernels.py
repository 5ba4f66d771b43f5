"""The tight filter's measurement equations.

Oracles: central differences of the prediction itself for every Jacobian; a dense least-squares solution for the update;
the covariance of simulated differences; the definition of a median.
"""

import numpy as np
import pytest
from tests.unit.fusion.platform_scenes import ARMS, antenna_state, sky
from tests.unit.fusion.test_strapdown import nav_ecef, nav_local

from plumbline.fusion.error_model import feed_back
from plumbline.fusion.tight_kernels import design, differences, group_medians, informed, references, whitened

RATE = np.array([0.3, -0.4, 0.9])
LINES = sky(np.random.default_rng(4), 7, np.array([0.0, 0.0, 1.0]))
ANTENNA = np.array([0, 1, 2, 0, 1, 2, 0])
SIZES = np.repeat([1.0, 1.0, 1e-3, 1e-2, 1e-4], 3)


def origins() -> np.ndarray:
    """Assumed places of the antennas, metres off."""
    nav = nav_ecef(nav_local())
    places = [antenna_state(nav, RATE, np.array(arm))[0] for arm in ARMS]
    return np.array(places) + np.array([[1.0, -2.0, 0.5], [0.3, 0.2, -0.1], [5.0, 4.0, -3.0]])


def predicted(nav: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Predictions of the kernel at a state."""
    _, z, _, z_rate = design(nav, RATE, np.array(ARMS), origins(), ANTENNA, LINES)
    return z, z_rate


def test_predictions_are_ranges() -> None:
    """Oracle: −e · (antenna − origin) and −e · antenna velocity, by differentiation of r + C l, in NumPy."""
    nav = nav_ecef(nav_local())
    z, z_rate = predicted(nav)
    for i, a in enumerate(ANTENNA):
        place, speed = antenna_state(nav, RATE - nav[18:21], np.array(ARMS[a]))
        assert z[i] == pytest.approx(-LINES[i] @ (place - origins()[a]), abs=1e-9)
        assert z_rate[i] == pytest.approx(-LINES[i] @ speed, abs=1e-12)


def test_antenna_velocity_is_the_derivative_of_its_place() -> None:
    """Oracle: differences of r + C l over time with the mechanisation, which settles the Earth-rate term's sign."""
    from plumbline.fusion.strapdown import step_ecef

    nav, arm, h = nav_ecef(nav_local()), np.array([30.0, -80.0, 50.0]), 1e-3
    ahead, unused = nav.copy(), np.zeros(3)
    force = np.array([0.1, 0.2, 9.8])
    place, speed = antenna_state(nav, RATE - nav[18:21], arm)
    step_ecef(ahead, force, RATE, h, unused)
    moved, later = antenna_state(ahead, RATE - nav[18:21], arm)
    np.testing.assert_allclose((moved - place) / h, 0.5 * (speed + later), atol=2e-5)
    assert np.linalg.norm(np.cross([0, 0, 7.29e-5], nav[6:15].reshape(3, 3) @ arm)) > 1e-3  # the sign would show


@pytest.mark.parametrize("column", range(15))
def test_designs_are_derivatives(column: int) -> None:
    """Oracle: central differences of the predictions by each error."""
    nav = nav_ecef(nav_local())
    h, _, h_rate, _ = design(nav, RATE, np.array(ARMS), origins(), ANTENNA, LINES)
    both = []
    for sign in (1.0, -1.0):
        moved, error = nav.copy(), np.zeros(15)
        error[column] = sign * SIZES[column]
        feed_back(moved, np.eye(15), error, False)
        both.append(predicted(moved))
    np.testing.assert_allclose((both[0][0] - both[1][0]) / (2 * SIZES[column]), h[:, column], atol=1e-6)
    np.testing.assert_allclose((both[0][1] - both[1][1]) / (2 * SIZES[column]), h_rate[:, column], atol=1e-6)


def test_covariance_of_differences() -> None:
    """Oracle: the matrix product D Σ Dᵀ with Σ written out, and positive definiteness."""
    group = np.array([1, 1, 1, 2, 2, 2, 2])
    link = np.array([10, 11, 12, 10, 11, 12, 13])
    sine = np.array([0.3, 0.9, 0.5, 0.2, 0.8, 0.4, 0.95])
    variance = np.linspace(1.0, 2.0, 7)
    use = np.ones(7, np.bool_)
    reference = references(group, sine, use, np.array([0, 0, 0, 1, 0, 0, 0], np.bool_))
    np.testing.assert_array_equal(reference, [1, 1, 1, 3, 3, 3, 3])
    _, v, r = differences(np.eye(7, 3), np.arange(7.0), reference, variance, link, 0.5)
    sigma = np.diag(variance)
    for i in range(7):
        for j in range(7):
            if i != j and link[i] == link[j]:
                sigma[i, j] = 0.5 * np.sqrt(variance[i] * variance[j])
    d = np.array([np.eye(7)[i] - np.eye(7)[reference[i]] for i in range(7) if reference[i] != i])
    np.testing.assert_allclose(r, d @ sigma @ d.T, atol=1e-15)
    np.testing.assert_allclose(v, d @ np.arange(7.0))
    assert np.linalg.eigvalsh(r).min() > 0


def test_update_is_bayes() -> None:
    """Oracle: (P⁻¹ + Hᵀ R⁻¹ H)⁻¹ written out."""
    rng = np.random.default_rng(0)
    a = rng.normal(size=(18, 18))
    p, h, v = a @ a.T * 1e-3 + np.eye(18) * 1e-5, rng.normal(size=(40, 18)), rng.normal(size=40)
    b = rng.normal(size=(40, 40))
    r = b @ b.T + np.eye(40)
    white_h, white_v, regular = whitened(h, v, r)
    assert regular
    x, q = informed(p, white_h, white_v)
    expected = np.linalg.inv(np.linalg.inv(p) + h.T @ np.linalg.solve(r, h))
    np.testing.assert_allclose(q, expected, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(x, expected @ h.T @ np.linalg.solve(r, v), rtol=1e-8, atol=1e-12)
    assert not whitened(h, v, -r)[2]


def test_group_medians() -> None:
    """Oracle: numpy.median by group; groups of fewer than three have none."""
    group, values = np.array([1, 2, 1, 2, 1, 3, 2]), np.array([5.0, 1.0, 7.0, 2.0, 6.0, 9.0, 30.0])
    use = np.array([1, 1, 1, 1, 1, 1, 1], np.bool_)
    np.testing.assert_allclose(group_medians(group, values, use), [6, 2, 6, 2, 6, np.nan, 2])
