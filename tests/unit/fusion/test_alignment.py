"""Initial attitude. Oracles: attitudes that the simulated means, motions and baselines were made with."""

import numpy as np
import pytest

from plumbline.config import InertialSettings
from plumbline.fusion.alignment import gyro_compass, heading_from_motion, level, with_heading
from plumbline.fusion.loose_start import first_covariance
from plumbline.fusion.rotations import angles_from_rotation, rotation_enu_from_angles, rotation_log
from plumbline.fusion.strapdown import earth_rate_local_rad_s
from plumbline.fusion.tight_start import align_at_rest, align_by_antennas

LATITUDE = 0.39
ANGLES = (2.3, 0.05, -0.08)
TRUE = rotation_enu_from_angles(*ANGLES)
FORCE = TRUE.T @ [0.0, 0.0, 9.79]
RATE = TRUE.T @ earth_rate_local_rad_s(LATITUDE)


def test_level_and_gyro_compass() -> None:
    found = level(FORCE)
    heading, sigma = gyro_compass(found, RATE, LATITUDE, 1e-7)
    np.testing.assert_allclose(angles_from_rotation(with_heading(found, heading)), ANGLES, atol=1e-9)
    assert sigma == pytest.approx(1e-7 / (7.2921151467e-5 * np.cos(LATITUDE)))


def test_heading_from_motion() -> None:
    """A constant acceleration in the level frame (tilt, bias) does not matter; noise shows in the sigma."""
    rng = np.random.default_rng(0)
    enu = rng.normal(size=(60, 2))
    c, s = np.cos(2.3), np.sin(2.3)
    inertial = enu @ np.array([[c, -s], [s, c]]).T + 0.25 * np.array([0.3, -0.2])  # heading undoes a turn by −2.3
    heading, sigma = heading_from_motion(inertial, enu, np.full(60, 0.25))
    assert heading % (2 * np.pi) == pytest.approx(2.3, abs=1e-9)
    assert sigma < 1e-6
    errors = []
    for _ in range(200):
        heading, sigma = heading_from_motion(inertial, enu + 0.1 * rng.normal(size=enu.shape), np.full(60, 0.25))
        errors.append((heading % (2 * np.pi) - 2.3) / sigma)
    assert 0.8 < np.std(errors) < 1.2
    assert np.isinf(heading_from_motion(inertial[:3], enu[:3], np.full(3, 0.25))[1])


def test_alignments_of_a_platform() -> None:
    sheet = InertialSettings(initial_gyroscope_bias_sigma_rad_s=4e-7, gyroscope_noise_rad_s_sqrt_hz=1e-6)
    at_rest = align_at_rest(FORCE, RATE, 10.0, LATITUDE, sheet)
    assert np.abs(rotation_log(at_rest.rotation_enu_from_body @ TRUE.T)).max() < 1e-9
    assert 0.005 < at_rest.sigma_enu_rad[2] < 0.01
    given = align_at_rest(FORCE, RATE, 10.0, LATITUDE, sheet.model_copy(update={"heading_deg": 90.0}))
    assert np.degrees(angles_from_rotation(given.rotation_enu_from_body)[0]) == pytest.approx(90.0)
    arms = np.array([[-0.5, -0.9, 0.0], [0.5, -0.9, 0.05]])
    by_antennas = align_by_antennas(arms @ TRUE.T, arms, FORCE, 10.0, sheet)
    assert np.abs(rotation_log(by_antennas.rotation_enu_from_body @ TRUE.T)).max() < 1e-9


def test_levelling_covariance() -> None:
    """Oracle: draws of the accelerometer's bias, levelled: tilt and bias errors have the covariance claimed."""
    settings = InertialSettings(initial_accelerometer_bias_sigma_m_s2=0.05)
    rng = np.random.default_rng(1)
    draws = []
    for _ in range(4000):
        bias = 0.05 * rng.normal(size=3)
        found = with_heading(level(FORCE + bias), ANGLES[0])
        draws.append(np.concatenate([rotation_log(TRUE @ found.T)[:2], bias]))
    measured = np.cov(np.array(draws).T)
    alignment = align_at_rest(FORCE, RATE, 1e6, LATITUDE, settings.model_copy(update={"heading_deg": 0.0}))
    from dataclasses import replace

    p = first_covariance(replace(alignment, levelled_enu_from_body=TRUE, sigma_enu_rad=np.zeros(3)), settings)
    claimed = p[np.ix_([6, 7, 9, 10, 11], [6, 7, 9, 10, 11])]
    np.testing.assert_allclose(
        measured, claimed, atol=0.06 * np.sqrt(np.outer(np.diag(claimed), np.diag(claimed))).max()
    )
    assert np.corrcoef(np.array(draws).T)[0, 2:].max() > 0.2
