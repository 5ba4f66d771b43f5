"""Attitude from antennas on a platform of known shape: truth from the simulation, errors against their sigmas."""

import math

import numpy as np
import pytest

from plumbline.positioning.attitude_baselines import (
    angles_of_rotation,
    attitude,
    fit_attitude,
    rotation_of_angles,
)

from .rtk_world import BASE_ECEF_M, T_NS, antenna, noisy, settings_of, sine_of, source_of

ARMS_BODY_M = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # forward, right
ANGLES_RAD = np.radians([217.0, 6.0, -4.0])


def _epochs(arms: np.ndarray, rotation: np.ndarray) -> list:
    return [antenna(rotation @ arm, 3 + k).epoch(T_NS) for k, arm in enumerate([np.zeros(3), *arms])]


@pytest.mark.parametrize("frequencies", [1, 2])
def test_three_antennas_give_three_angles_as_good_as_claimed(frequencies: int) -> None:
    settings, rng = settings_of(frequencies=frequencies), np.random.default_rng(7)
    source, epochs = source_of(settings), _epochs(ARMS_BODY_M, rotation_of_angles(*ANGLES_RAD))
    sines = [sine_of(epoch) for epoch in epochs]
    errors, sigmas, count = [], [], 40
    for _ in range(count):
        drawn = [noisy(epoch, sine, rng) for epoch, sine in zip(epochs, sines, strict=True)]
        found = attitude(drawn[0], drawn[1:], ARMS_BODY_M, BASE_ECEF_M + 5.0, source, settings)
        assert found.fixed, found.reason
        assert found.covariance_rad2 is not None
        errors.append(np.array([found.heading_rad, found.pitch_rad, found.roll_rad]) - ANGLES_RAD)
        sigmas.append(np.sqrt(np.diag(found.covariance_rad2)))
    ratio = np.sqrt(np.mean(np.square(errors), axis=0)) / np.mean(sigmas, axis=0)
    assert np.all((ratio > 0.5) & (ratio < 1.35)), ratio
    assert np.degrees(np.mean(sigmas, axis=0)).max() < 0.6


def test_two_antennas_give_two_angles() -> None:
    settings, rng = settings_of(), np.random.default_rng(8)
    source = source_of(settings)
    for arm, unknown in (([0.0, 1.2, 0.0], "roll_rad"), ([1.2, 0.0, 0.0], "pitch_rad")):
        arms = np.array([arm])
        epochs = [noisy(e, sine_of(e), rng) for e in _epochs(arms, rotation_of_angles(*ANGLES_RAD))]
        found = attitude(epochs[0], epochs[1:], arms, BASE_ECEF_M, source, settings)
        assert found.fixed, found.reason
        assert math.isnan(getattr(found, unknown))
        other = {"roll_rad": ("pitch_rad", 1), "pitch_rad": ("roll_rad", 2)}[unknown]
        assert getattr(found, other[0]) == pytest.approx(ANGLES_RAD[other[1]], abs=0.02)
        assert found.baselines_enu_m is not None
        truth = rotation_of_angles(*ANGLES_RAD) @ arms[0]
        np.testing.assert_allclose(found.baselines_enu_m[0], truth, atol=0.02)


def test_length_decides_where_phases_alone_cannot() -> None:
    """One frequency, one system, noisy codes: with a wrong length nothing is certain or what is chosen is wrong."""
    settings, rng = settings_of(frequencies=1, systems="G"), np.random.default_rng(9)
    source, arms = source_of(settings), ARMS_BODY_M
    rotation = rotation_of_angles(*ANGLES_RAD)
    epochs = _epochs(arms, rotation)
    sines = [sine_of(epoch) for epoch in epochs]
    right = wrong = 0
    for _ in range(30):
        drawn = [noisy(epoch, sine, rng) for epoch, sine in zip(epochs, sines, strict=True)]
        found = attitude(drawn[0], drawn[1:], arms, BASE_ECEF_M, source, settings)
        if found.fixed:
            assert found.baselines_enu_m is not None
            good = np.abs(found.baselines_enu_m - arms @ rotation.T).max() < 0.03
            right, wrong = right + good, wrong + (not good)
    assert right >= 20
    assert wrong == 0


def test_fit_recovers_any_rotation_exactly() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        angles = np.array([rng.uniform(0, 2 * np.pi), rng.uniform(-1.3, 1.3), rng.uniform(-3.0, 3.0)])
        rotation = rotation_of_angles(*angles)
        np.testing.assert_allclose(angles_of_rotation(rotation), angles, atol=1e-12)
        arms = rng.normal(size=(3, 3))
        found, _, cost = fit_attitude(arms @ rotation.T, [np.eye(3) * 1e-6] * 3, arms, None)
        np.testing.assert_allclose(found, rotation, atol=1e-9)
        assert cost < 1e-9


def test_too_few_satellites_are_a_reason() -> None:
    settings = settings_of(systems="G", mask_deg=55.0)
    epochs = _epochs(ARMS_BODY_M, np.eye(3))
    found = attitude(epochs[0], epochs[1:], ARMS_BODY_M, BASE_ECEF_M, source_of(settings), settings)
    assert not found.fixed
    assert found.reason.startswith("antenna 2: ")
