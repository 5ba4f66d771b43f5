"""The tight filter's measurement equations.

Oracles: central differences of the prediction itself for every Jacobian; a dense least-squares solution for the update;
double differences written out; the definition of a median.
"""

import numpy as np
import pytest
from tests.unit.fusion.platform_scenes import ARMS, antenna_state, sky
from tests.unit.fusion.test_strapdown import nav_ecef, nav_local

from plumbline.fusion.error_model import feed_back
from plumbline.fusion.tight_kernels import design, fitting, group_medians, informed, normal_equations

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


def double_differences(group: np.ndarray, link: np.ndarray, variance: np.ndarray, use: np.ndarray) -> tuple:  # type: ignore[type-arg]
    """Differencing matrix to each group's first used row, and the covariance of single differences, written out."""
    sigma = np.diag(variance)
    for i in range(group.size):
        for j in range(group.size):
            if i != j and link[i] == link[j]:
                sigma[i, j] = 0.5 * np.sqrt(variance[i] * variance[j])
    rows = []
    for g in np.unique(group[use]):
        first, *others = np.flatnonzero(use & (group == g))
        rows += [np.eye(group.size)[i] - np.eye(group.size)[first] for i in others]
    return np.array(rows), sigma


def test_normal_equations_are_those_of_double_differences() -> None:
    """Oracle: Hᵀ Dᵀ (D Σ Dᵀ)⁻¹ D H with D and Σ written out; clocks of kilometres do not matter."""
    rng = np.random.default_rng(2)
    group = np.array([1, 1, 1, 2, 2, 2, 2, 3])
    link = np.array([10, 11, 12, 10, 11, 12, 13, 10])
    use = np.array([1, 1, 1, 1, 0, 1, 1, 1], np.bool_)
    column = np.array([-1, 15, -1, -1, 16, 17, 18, -1])
    variance, wavelength = np.linspace(1.0, 2.0, 8), np.full(8, 0.19)
    h, v = rng.normal(size=(8, 15)), rng.normal(size=8)
    full = np.hstack([h, np.zeros((8, 4))])
    full[np.flatnonzero(column >= 0), column[column >= 0]] = 0.19
    d, sigma = double_differences(group, link, variance, use)
    weight = d.T @ np.linalg.inv(d @ sigma @ d.T) @ d
    clock = 1e5 * group
    n, b, squares, degrees = normal_equations(h, v + clock, variance, link, group, use, 0.5, column, wavelength, 19)
    np.testing.assert_allclose(n, full.T @ weight @ full, atol=1e-9)
    np.testing.assert_allclose(b, full.T @ weight @ v, atol=1e-8)
    assert squares == pytest.approx(v @ weight @ v, abs=1e-8)
    assert degrees == len(d)


def test_update_is_bayes() -> None:
    """Oracle: (P⁻¹ + N)⁻¹ written out."""
    rng = np.random.default_rng(0)
    a, h = rng.normal(size=(18, 18)), rng.normal(size=(40, 18))
    p, v = a @ a.T * 1e-3 + np.eye(18) * 1e-5, rng.normal(size=40)
    x, q = informed(p, h.T @ h, h.T @ v)
    expected = np.linalg.inv(np.linalg.inv(p) + h.T @ h)
    np.testing.assert_allclose(q, expected, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(x, expected @ h.T @ v, rtol=1e-8, atol=1e-12)


def test_phases_that_fit() -> None:
    """Oracle: a held row off its group's median by more than the gate, or than the slip limit, is refused."""
    group, held = np.ones(6, np.int64), np.ones(6, np.bool_)
    phase = np.array([0.0, 0.001, -0.001, 0.05, 0.0, np.nan])
    variance, h = np.full(6, 1e-4), np.zeros((6, 15))
    wide = np.full(6, 0.4)
    np.testing.assert_array_equal(fitting(np.eye(15), h, phase, held, group, variance, wide, 6.0), [1, 1, 1, 1, 1, 0])
    np.testing.assert_array_equal(fitting(np.eye(15), h, phase, held, group, variance, wide, 4.0), [1, 1, 1, 0, 1, 0])
    tight = np.full(6, 0.04)
    np.testing.assert_array_equal(fitting(np.eye(15), h, phase, held, group, variance, tight, 6.0), [1, 1, 1, 0, 1, 0])
    held[3] = False  # what is not held is a state of the filter
    np.testing.assert_array_equal(fitting(np.eye(15), h, phase, held, group, variance, wide, 4.0), [1, 1, 1, 1, 1, 0])


def test_group_medians() -> None:
    """Oracle: numpy.median by group; groups of fewer than three have none."""
    group, values = np.array([1, 2, 1, 2, 1, 3, 2]), np.array([5.0, 1.0, 7.0, 2.0, 6.0, 9.0, 30.0])
    use = np.array([1, 1, 1, 1, 1, 1, 1], np.bool_)
    np.testing.assert_allclose(group_medians(group, values, use), [6, 2, 6, 2, 6, np.nan, 2])
