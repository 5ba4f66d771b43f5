"""Rotations, gravity, both mechanisations and their error models.

Oracles: SciPy's rotations; Somigliana's closed form; free fall and rest in closed form; the two mechanisations against
each other; finite differences of the mechanisation for every Jacobian.
"""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from plumbline.constants import EARTH_ROTATION_RATE_RAD_S
from plumbline.fusion.error_model import feed_back, rates_ecef, rates_local, transition_of
from plumbline.fusion.rotations import (
    angle_partials,
    angles_from_rotation,
    rotation_enu_from_angles,
    rotation_exp,
    rotation_log,
)
from plumbline.fusion.strapdown import (
    earth_rate_local_rad_s,
    gravity_ecef_m_s2,
    gravity_up_m_s2,
    step_ecef,
    step_local,
)
from plumbline.gnss.earth_frames import ecef_from_geodetic, geodetic_from_ecef, rotation_enu_from_ecef
from plumbline.records import Floats

NOISE = np.array([1e-4, 1e-5, 1e-3, 500.0, 1e-5, 900.0, 0.0, 0.0, 1.0])
PLACE = (0.7, -1.8, 1600.0)


def nav_local(velocity: Floats | None = None, rotation: Floats | None = None) -> Floats:
    """A state at PLACE."""
    nav = np.zeros(21)
    nav[0:3] = PLACE
    nav[3:6] = np.array([12.0, -7.0, 1.5]) if velocity is None else velocity
    nav[6:15] = (rotation_enu_from_angles(0.6, 0.1, -0.2) if rotation is None else rotation).ravel()
    nav[15:18], nav[18:21] = [0.02, -0.01, 0.03], [1e-3, -2e-3, 5e-4]
    return nav


def nav_ecef(nav: Floats) -> Floats:
    """The same state, Earth-fixed."""
    out = nav.copy()
    turn = rotation_enu_from_ecef(nav[0], nav[1])
    out[0:3] = ecef_from_geodetic(nav[0], nav[1], nav[2])
    out[3:6] = turn.T @ nav[3:6]
    out[6:15] = (turn.T @ nav[6:15].reshape(3, 3)).ravel()
    return out


def test_exp_and_log_are_scipys() -> None:
    """Oracle: scipy.spatial.transform.Rotation, from tiny angles to nearly half a turn."""
    rng = np.random.default_rng(1)
    for size in (1e-7, 1e-4, 1e-2, 1.0, 3.0):
        vector = rng.normal(size=3)
        vector *= size / np.linalg.norm(vector)
        expected = Rotation.from_rotvec(vector).as_matrix()
        np.testing.assert_allclose(rotation_exp(vector), expected, atol=1e-15)
        np.testing.assert_allclose(rotation_log(expected), vector, atol=1e-9)


def test_angles() -> None:
    """Oracle: SciPy's Euler product R_z(−heading) R_x(pitch) R_y(roll); the round trip; what the words say."""
    heading, pitch, roll = 2.1, 0.3, -0.7
    expected = Rotation.from_euler("ZXY", [-heading, pitch, roll]).as_matrix()
    np.testing.assert_allclose(rotation_enu_from_angles(heading, pitch, roll), expected, atol=1e-15)
    np.testing.assert_allclose(angles_from_rotation(expected), [heading, pitch, roll], atol=1e-14)
    east = rotation_enu_from_angles(np.pi / 2, 0.0, 0.0) @ [0.0, 1.0, 0.0]
    np.testing.assert_allclose(east, [1.0, 0.0, 0.0], atol=1e-15)
    assert (rotation_enu_from_angles(0.0, 0.2, 0.0) @ [0.0, 1.0, 0.0])[2] > 0
    assert (rotation_enu_from_angles(0.0, 0.0, 0.2) @ [1.0, 0.0, 0.0])[2] < 0


def test_angle_partials() -> None:
    """Oracle: finite differences."""
    heading, pitch, roll, step = 0.8, 0.25, -0.4, 1e-6
    c = rotation_enu_from_angles(heading, pitch, roll)
    for k in range(3):
        psi = np.zeros(3)
        psi[k] = step
        change = angles_from_rotation(rotation_exp(psi) @ c) - angles_from_rotation(rotation_exp(-psi) @ c)
        np.testing.assert_allclose(change / (2 * step), angle_partials(heading, pitch)[:, k], atol=1e-8)


@pytest.mark.parametrize("latitude", [-1.2, 0.0, 0.4, 0.9, 1.5])
@pytest.mark.parametrize("height", [0.0, 3000.0])
def test_gravity_is_normal_gravity(latitude: float, height: float) -> None:
    """Oracle: Somigliana's closed form on the ellipsoid, its continuation above; downwards along the normal."""
    gravity = gravity_ecef_m_s2(ecef_from_geodetic(latitude, 0.3, height))
    enu = rotation_enu_from_ecef(latitude, 0.3) @ gravity
    assert -enu[2] == pytest.approx(gravity_up_m_s2(latitude, height), abs=5e-7)  # J6 is left out
    assert abs(enu[0]) < 1e-9
    assert abs(enu[1]) < 5e-7 + 8.2e-9 * height  # the plumb line above the ellipsoid curves


@pytest.mark.parametrize("ecef", [False, True])
def test_rest_stays_at_rest(ecef: bool) -> None:
    """Oracle: a platform fixed to the Earth feels −g and the Earth's rate, and stays where it is."""
    rotation = rotation_enu_from_angles(1.0, 0.2, 0.3)
    nav = nav_local(np.zeros(3), rotation)
    up = np.array([0.0, 8.08e-9 * PLACE[2] * np.sin(2 * PLACE[0]), gravity_up_m_s2(PLACE[0], PLACE[2])])
    if ecef:
        start = nav_ecef(nav)
        up = -rotation_enu_from_ecef(PLACE[0], PLACE[1]) @ gravity_ecef_m_s2(start[0:3])
    force = rotation.T @ up + nav[15:18]
    rate = rotation.T @ earth_rate_local_rad_s(PLACE[0]) + nav[18:21]
    state = nav_ecef(nav) if ecef else nav.copy()
    start, step, acceleration = state.copy(), step_ecef if ecef else step_local, np.zeros(3)
    for _ in range(2000):
        step(state, force, rate, 0.01, acceleration)
    np.testing.assert_allclose(state[3:6], 0.0, atol=1e-8)
    np.testing.assert_allclose(state[6:15], start[6:15], atol=1e-11)


def test_free_fall_keeps_energy() -> None:
    """Oracle: Jacobi's integral of free fall in the rotating frame (force zero), with the gradient's own potential."""
    nav = nav_ecef(nav_local())
    nav[15:21] = 0.0
    nav[3:6] *= 100.0

    def jacobi(state: Floats) -> float:
        r = np.linalg.norm(state[0:3])
        s = state[2] / r
        ratio = 6_378_137.0 / r
        p2, p4 = 0.5 * (3 * s**2 - 1), (35 * s**4 - 30 * s**2 + 3) / 8
        u = 3.986004418e14 / r * (1 - 1.08262982131e-3 * ratio**2 * p2 + 2.37091222e-6 * ratio**4 * p4)
        spin = 0.5 * EARTH_ROTATION_RATE_RAD_S**2 * (state[0] ** 2 + state[1] ** 2)
        return float(0.5 * state[3:6] @ state[3:6] - u - spin)

    before = jacobi(nav)
    acceleration = np.zeros(3)
    for _ in range(1000):
        step_ecef(nav, np.zeros(3), np.zeros(3), 0.01, acceleration)
    assert jacobi(nav) == pytest.approx(before, abs=2e-3)  # of 6e7; the fall alone changed the parts by 1e5


def test_mechanisations_agree() -> None:
    """Oracle: the other mechanisation, on a drive of a minute with turns and accelerations."""
    local = nav_local()
    ecef = nav_ecef(local)
    acceleration = np.zeros(3)
    for k in range(6000):
        t = 0.01 * k
        force = np.array([2 * np.sin(0.3 * t), 1.5 * np.cos(0.2 * t), 9.8 + 0.3 * np.sin(t)])
        rate = np.array([0.02 * np.sin(t), 0.05 * np.cos(2 * t), 0.1 * np.sin(0.1 * t)])
        step_local(local, force, rate, 0.01, acceleration)
        step_ecef(ecef, force, rate, 0.01, acceleration)
    position = ecef_from_geodetic(local[0], local[1], local[2])
    np.testing.assert_allclose(position, ecef[0:3], atol=2e-3)
    turn = rotation_enu_from_ecef(*geodetic_from_ecef(ecef[0:3])[:2])
    np.testing.assert_allclose(turn @ ecef[3:6], local[3:6], atol=2e-4)
    np.testing.assert_allclose(
        turn @ ecef[6:15].reshape(3, 3), local[6:15].reshape(3, 3), atol=2e-7
    )  # rate of a step's start


def error_of(truth: Floats, estimate: Floats, local: bool) -> Floats:
    """Error state (15,), truth less estimate, independently of the code under test."""
    out = np.zeros(15)
    if local:
        turn = rotation_enu_from_ecef(estimate[0], estimate[1])
        out[0:3] = turn @ (ecef_from_geodetic(*truth[0:3]) - ecef_from_geodetic(*estimate[0:3]))
    else:
        out[0:3] = truth[0:3] - estimate[0:3]
    out[3:6] = truth[3:6] - estimate[3:6]
    out[6:9] = Rotation.from_matrix(truth[6:15].reshape(3, 3) @ estimate[6:15].reshape(3, 3).T).as_rotvec()
    out[9:15] = truth[15:21] - estimate[15:21]
    return out


def stepped(nav: Floats, step_s: float, local: bool) -> Floats:
    """A step with the biases' decay."""
    force, rate = np.array([1.0, -2.0, 9.0]), np.array([0.3, -0.2, 0.5])
    out, acceleration = nav.copy(), np.zeros(3)
    (step_local if local else step_ecef)(out, force, rate, step_s, acceleration)
    out[15:18] *= np.exp(-step_s / NOISE[3])
    out[18:21] *= np.exp(-step_s / NOISE[5])
    return out


@pytest.mark.parametrize("local", [False, True])
def test_transition_is_the_derivative_of_the_step(local: bool) -> None:
    """Oracle: central differences of the mechanisation by each of the 15 errors, applied by ``feed_back``."""
    base = nav_local(np.array([60.0, -35.0, 4.0]))
    nav, step_s = (base if local else nav_ecef(base)), 0.01
    rates: Callable[[Floats, Floats, Floats], Floats] = rates_local if local else rates_ecef
    transition = transition_of(rates(nav, np.array([1.0, -2.0, 9.0]), NOISE), step_s)
    sizes = np.repeat([10.0, 1.0, 1e-4, 1e-2, 1e-4], 3)
    middle = stepped(nav, step_s, local)
    for k in range(15):
        change = np.zeros(15)
        for sign in (1.0, -1.0):
            moved, error = nav.copy(), np.zeros(15)
            error[k] = sign * sizes[k]
            feed_back(moved, np.eye(15), error, local)
            change += sign * error_of(stepped(moved, step_s, local), middle, local)
        derivative = change / (2 * sizes[k])
        tolerance = np.repeat([2e-9, 2e-8, 2e-11, 1e-12, 1e-12], 3) / sizes[k]
        scale = np.repeat([1.0, 1.0, 0.0, 0.0, 0.0], 3) * (5e-5 if 6 <= k < 15 else 0.0)  # ψ and biases: O(τ³)
        scale[6:9] = 3e-5 if k >= 6 else 0.0
        scale[0:3] += 3e-9 if k < 3 else 0.0  # of 1e-7: the radii's change with latitude
        assert (np.abs(derivative - transition[:, k]) <= tolerance + scale).all(), (k, derivative - transition[:, k])


@pytest.mark.parametrize("local", [False, True])
def test_feed_back_removes_the_error(local: bool) -> None:
    """Oracle: the definition of the error state, computed from geodesy and SciPy's rotations."""
    nav = nav_local() if local else nav_ecef(nav_local())
    rng = np.random.default_rng(2)
    error = rng.normal(size=15) * np.repeat([1.0, 0.5, 0.05, 0.01, 1e-3], 3)
    moved, p = nav.copy(), np.eye(15)
    feed_back(moved, p, error, local)
    found = error_of(moved, nav, local)
    np.testing.assert_allclose(found[0:3], error[0:3], atol=2e-6)
    np.testing.assert_allclose(found[3:], error[3:], atol=1e-12)


def test_reset_of_the_covariance() -> None:
    """Oracle: central differences of the attitude error left after the feedback by the true attitude error."""
    nav, psi = nav_local(), np.array([0.05, -0.03, 0.08])
    moved, p = nav.copy(), np.zeros((15, 15))
    p[6:9, 6:9] = np.diag([1.0, 2.0, 3.0])
    error = np.zeros(15)
    error[6:9] = psi
    feed_back(moved, p, error, True)
    jacobian = np.zeros((3, 3))
    for k in range(3):
        for sign in (1.0, -1.0):
            true = psi.copy()
            true[k] += sign * 1e-5
            truth = rotation_exp(true) @ nav[6:15].reshape(3, 3)
            left = rotation_log(truth @ moved[6:15].reshape(3, 3).T)
            jacobian[:, k] += sign * left / 2e-5
    np.testing.assert_allclose(p[6:9, 6:9], jacobian @ np.diag([1.0, 2.0, 3.0]) @ jacobian.T, atol=0.01)
    assert abs(p[6, 7]) > 0.02  # it is not nothing
