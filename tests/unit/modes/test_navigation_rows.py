"""Filter rows as motion. Oracle: the filters' own scalar functions, and the geometry of a turned lever arm."""

import math

import numpy as np

from plumbline.fusion.inertial_run import ROW_ATTITUDE_COVARIANCE, ROW_SIZE
from plumbline.fusion.rotations import angle_partials, angles_from_rotation, rotation_enu_from_angles
from plumbline.gnss.earth_frames import ecef_from_geodetic, rotation_enu_from_ecef
from plumbline.modes.navigation_rows import angle_sigmas_of, angles_of, motion_of_ecef_rows, motion_of_local_rows

PLACE = np.array([0.83, 0.21, 512.0])
ENU = rotation_enu_from_ecef(PLACE[0], PLACE[1])
REFERENCE = tuple(ecef_from_geodetic(*PLACE).tolist())


def test_angles_and_their_sigmas_are_the_scalar_ones() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        heading, pitch, roll = rng.uniform(0, 2 * math.pi), rng.uniform(-1.4, 1.4), rng.uniform(-3, 3)
        rotation = rotation_enu_from_angles(heading, pitch, roll)
        angles = angles_of(rotation[None])
        assert np.allclose(angles[0], angles_from_rotation(rotation)[::-1], atol=1e-12)
        half = rng.normal(size=(3, 3))
        covariance = half @ half.T
        partials = angle_partials(heading, pitch)
        wanted = np.sqrt(np.diag(partials @ covariance @ partials.T))[::-1]
        assert np.allclose(angle_sigmas_of(angles, covariance[None])[0], wanted)


def test_both_mechanisations_say_the_same() -> None:
    """The same place, velocity, attitude and covariances, once Earth-fixed and once local, without a lever arm."""
    rng = np.random.default_rng(4)
    rotation = rotation_enu_from_angles(0.7, 0.02, -0.03)
    local = np.zeros((1, ROW_SIZE))
    local[0, :3] = PLACE + np.array([1e-9, -2e-9, 0.004])
    local[0, 3:6], local[0, 6:15], local[0, 48:] = rng.normal(size=3), rotation.ravel(), rng.normal(size=3)
    fixed = local.copy()
    fixed[0, :3] = ecef_from_geodetic(*local[0, :3])
    fixed[0, 3:6], fixed[0, 48:] = ENU.T @ local[0, 3:6], ENU.T @ local[0, 48:]
    fixed[0, 6:15] = (ENU.T @ rotation).ravel()
    for at in (21, 30, ROW_ATTITUDE_COVARIANCE):
        half = rng.normal(size=(3, 3)) * 1e-3
        local[0, at : at + 9] = (half @ half.T).ravel()
        fixed[0, at : at + 9] = (ENU.T @ half @ half.T @ ENU).ravel()
    assert np.allclose(
        motion_of_ecef_rows(fixed, REFERENCE), motion_of_local_rows(local, REFERENCE, (0.0, 0.0, 0.0)), atol=2e-8
    )


def test_a_lever_arm_moves_with_the_platform() -> None:
    row = np.zeros((1, ROW_SIZE))
    row[0, :3], row[0, 6:15] = PLACE, rotation_enu_from_angles(math.pi / 2, 0.0, 0.0).ravel()
    motion = motion_of_local_rows(row, REFERENCE, (0.0, 2.0, 0.5))  # forward is east
    assert np.allclose(motion[0, :3], [2.0, 0.0, 0.5], atol=1e-6)
