"""Relative positioning says how good it is, and is: normalised errors over many draws of the assumed noise."""

import numpy as np
import pytest
from scipy.stats import chi2

from plumbline.positioning import rtk
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.rtk_state import BaseView
from plumbline.records import Status

from .rtk_world import (
    BASE_ECEF_M,
    ENU,
    T_NS,
    antenna,
    noisy,
    settings_of,
    sine_of,
    source_of,
)

SECOND = 1_000_000_000
OFFSET_ENU_M = np.array([40.0, -25.0, 6.0])
FACTS = StationFacts("rover")


def _normalised_errors(solution, truth_enu_m):  # type: ignore[no-untyped-def]
    error = ENU @ (solution.position_ecef_m - BASE_ECEF_M) - truth_enu_m
    return float(error @ np.linalg.solve(solution.covariance_enu_m2, error))


@pytest.mark.parametrize("integers", ["off", "instantaneous"])
def test_single_epochs_have_the_errors_they_claim(integers: str) -> None:
    """NEES of float and of fixed single-epoch positions within the 99.9 % band of chi-square."""
    settings = settings_of(integers=integers, frequencies=2)
    source, rng = source_of(settings), np.random.default_rng(4)
    base, rover = antenna(np.zeros(3), 1).epoch(T_NS), antenna(OFFSET_ENU_M, 2).epoch(T_NS)
    sine_base, sine_rover, total, count = sine_of(base), sine_of(rover), 0.0, 120
    for _ in range(count):
        view = BaseView("base", noisy(base, sine_base, rng), BASE_ECEF_M)
        _, solution, seen = rtk.step(
            rtk.initial_state(), noisy(rover, sine_rover, rng), view, source, settings, FACTS
        )  # fmt: skip
        assert seen is not None
        assert solution.status is (Status.RTK_FLOAT if integers == "off" else Status.RTK_FIXED), solution.reason
        total += _normalised_errors(solution, OFFSET_ENU_M)
    assert chi2.ppf(0.0005, 3 * count) < total < chi2.ppf(0.9995, 3 * count)


def test_a_filtered_float_position_has_the_error_it_claims() -> None:
    """Code and phase over a minute without integers: NEES at the end of independent runs."""
    settings = settings_of(integers="off", ambiguity_memory_s=1e9)
    source, rng, runs = source_of(settings), np.random.default_rng(5), 40
    base, rover = antenna(np.zeros(3), 1), antenna(OFFSET_ENU_M, 2)
    times = [T_NS + 6 * k * SECOND for k in range(8)]
    pairs = [(base.epoch(t), rover.epoch(t)) for t in times]
    sines = [(sine_of(b), sine_of(r)) for b, r in pairs]
    total, sigma = 0.0, 0.0
    for _ in range(runs):
        state = rtk.initial_state()
        for (b, r), (sb, sr) in zip(pairs, sines, strict=True):
            view = BaseView("base", noisy(b, sb, rng), BASE_ECEF_M)
            state, solution, _ = rtk.step(state, noisy(r, sr, rng), view, source, settings, FACTS)
        total += _normalised_errors(solution, OFFSET_ENU_M)
        sigma += float(np.sqrt(np.trace(solution.covariance_enu_m2))) / runs
    assert chi2.ppf(0.0005, 3 * runs) < total < chi2.ppf(0.9995, 3 * runs)
    assert sigma < 0.35  # filtering helped: a single epoch has twice that


def test_a_static_antenna_gains_from_knowing_it() -> None:
    settings = settings_of(position_noise_m_sqrt_s=1e-5)
    free = settings_of()
    source, rng = source_of(settings), np.random.default_rng(6)
    base, rover = antenna(np.zeros(3), 1), antenna(OFFSET_ENU_M, 2)
    states, errors = {"static": rtk.initial_state(), "free": rtk.initial_state()}, {"static": [], "free": []}
    for k in range(40):
        b, r = base.epoch(T_NS + k * SECOND), rover.epoch(T_NS + k * SECOND)
        b, r = noisy(b, sine_of(b), rng), noisy(r, sine_of(r), rng)
        for name, chosen in (("static", settings), ("free", free)):
            states[name], solution, _ = rtk.step(
                states[name], r, BaseView("base", b, BASE_ECEF_M), source, chosen, FACTS
            )  # fmt: skip
            assert solution.status is Status.RTK_FIXED
            errors[name].append(np.linalg.norm(ENU @ (solution.position_ecef_m - BASE_ECEF_M) - OFFSET_ENU_M))
    assert np.mean(errors["static"][20:]) < 0.4 * np.mean(errors["free"][20:])
