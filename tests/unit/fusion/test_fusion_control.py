"""GNSS against the accelerometer: who is wrong. Oracle: the error that was put in, and the run without it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import ncx2
from tests.unit.fusion.scenes import T0, S, feed, in_order, shaken, stored

from plumbline.fusion.control import root_noncentrality, spikes
from plumbline.fusion.state import FusionState
from plumbline.records import Floats, InertialBlock, Motion, Solution, Status

N_S, FAULT_S = 60, 40


def _run(
    edit_solution: Callable[[int, Solution], Solution] = lambda _, s: s,
    edit_block: Callable[[int, InertialBlock], InertialBlock] = lambda _, b: b,
    seed: int = 7,
) -> tuple[FusionState, dict[int, Motion]]:
    solutions, blocks = shaken(N_S, seed=seed)
    state, published = feed(
        in_order(
            [edit_solution(k, s) for k, s in enumerate(solutions)], [edit_block(k, b) for k, b in enumerate(blocks)]
        )
    )
    return state, stored(published)


def _motion_counters(state: FusionState) -> dict[str, int]:
    return {name: n for name, n in state.counters.items() if name.startswith("motion_")}


def _displacement(kept: dict[int, Motion], second: int) -> Floats:
    return kept[T0 + second * S].displacement_enu_m


@pytest.fixture(scope="module")
def clean() -> dict[int, Motion]:
    state, kept = _run()
    assert _motion_counters(state) == {}
    return kept


@pytest.mark.parametrize("size_m", [0.05, -0.3])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_outlier_of_gnss_is_refused_and_named(size_m: float, axis: int) -> None:
    off = size_m * np.eye(3)[axis]
    state, kept = _run(lambda k, s: replace(s, displacement_enu_m=s.displacement_enu_m + off) if k == FAULT_S else s)
    assert _motion_counters(state) == {"motion_gnss_outlier": 1}
    assert kept[T0 + FAULT_S * S].status is Status.REJECTED
    _, without = _run(lambda k, s: replace(s, displacement_enu_m=None) if k == FAULT_S else s)
    np.testing.assert_allclose(_displacement(kept, N_S - 3), _displacement(without, N_S - 3), atol=1e-12)


@pytest.mark.parametrize("size_m_s2", [30.0, -80.0])
def test_a_spike_is_named_and_leaves_no_mark(clean: dict[int, Motion], size_m_s2: float) -> None:
    """One sample off by so much is a velocity of decimetres a second: GNSS tells, and it is taken as missing."""

    def spiked(k: int, b: InertialBlock) -> InertialBlock:
        values = b.specific_force_m_s2.copy()
        values[30, 0] += size_m_s2 * (k == FAULT_S)
        return replace(b, specific_force_m_s2=values)

    state, kept = _run(edit_block=spiked)
    assert _motion_counters(state) == {"motion_accelerometer_spike": 1, "motion_accelerometer_spike_samples": 1}
    assert all(kept[T0 + k * S].status is Status.PPP_FLOAT for k in range(FAULT_S, N_S - 1))
    np.testing.assert_allclose(_displacement(kept, FAULT_S + 3), _displacement(clean, FAULT_S + 3), atol=5e-3)


def test_a_sensor_that_clips_is_named_and_gnss_is_believed(clean: dict[int, Motion]) -> None:
    """Stuck at 0.9 m/s² for half a second on one axis."""

    def stuck(k: int, b: InertialBlock) -> InertialBlock:
        values = b.specific_force_m_s2.copy()
        if k == FAULT_S:
            values[20:70, 0] = 0.9
        return replace(b, specific_force_m_s2=values)

    state, kept = _run(edit_block=stuck)
    assert _motion_counters(state)["motion_accelerometer_stuck_or_clipped"] == 1
    assert _motion_counters(state)["motion_accelerometer_stuck_or_clipped_samples"] >= 50
    assert all(kept[T0 + k * S].status is Status.PPP_FLOAT for k in range(FAULT_S, N_S - 1))
    np.testing.assert_allclose(_displacement(kept, N_S - 3), _displacement(clean, N_S - 3), atol=5e-3)


def test_a_jump_unfelt_and_a_drifting_sensor_are_told_apart() -> None:
    def jumped(k: int, s: Solution) -> Solution:
        return replace(s, displacement_enu_m=np.add(s.displacement_enu_m, [0.0, 0.08, 0.0])) if k >= FAULT_S else s

    def drifting(k: int, b: InertialBlock) -> InertialBlock:
        return replace(b, specific_force_m_s2=np.add(b.specific_force_m_s2, [0.15 * (k >= FAULT_S), 0.0, 0.0]))

    state, kept = _run(jumped)
    assert _motion_counters(state) == {"motion_gnss_outlier": 2, "motion_gnss_jump_unfelt": 1}
    assert "jumped by 0.07" in kept[T0 + (FAULT_S + 4) * S].reason
    state, kept = _run(edit_block=drifting)
    assert _motion_counters(state) == {"motion_gnss_outlier": 2, "motion_accelerometer_drift": 1}
    assert kept[T0 + (FAULT_S + 5) * S].reason == ""
    assert kept[T0 + (FAULT_S + 5) * S].status is Status.PPP_FLOAT


def test_a_real_motion_goes_through_untouched() -> None:
    """A 5 cm step within half a second, felt: the run with the gate as wide as can be is the same."""
    t = np.arange(50) / 100
    pulse = 0.05 * 2 * np.pi / 0.25 * np.sin(2 * np.pi * t / 0.5)  # a cosine ramp's acceleration

    def moved(k: int, s: Solution) -> Solution:
        return replace(s, displacement_enu_m=np.add(s.displacement_enu_m, [0.05, 0, 0])) if k > FAULT_S else s

    def felt(k: int, b: InertialBlock) -> InertialBlock:
        values = b.specific_force_m_s2.copy()
        values[20:70, 0] += pulse * (k == FAULT_S)
        return replace(b, specific_force_m_s2=values)

    state, kept = _run(moved, felt)
    assert _motion_counters(state) == {}
    _, still = _run()
    seen = _displacement(kept, N_S - 3)[:, 0] - _displacement(still, N_S - 3)[:, 0]
    np.testing.assert_allclose(seen, 0.05, atol=1e-3)


def test_the_mdb_is_found_with_the_power_stated() -> None:
    """Errors of its size in one component, 10,000 draws of the innovation: oracle: counting."""
    rng, power = np.random.default_rng(1), 0.8
    root = root_noncentrality(6.0, power)
    assert ncx2.sf(36.0, 3, root**2) == pytest.approx(power, abs=1e-9)
    s = np.array([[2.0, 0.6, -0.3], [0.6, 1.0, 0.2], [-0.3, 0.2, 4.0]]) * 1e-5
    information = np.linalg.inv(s)
    for axis in range(3):
        v = rng.multivariate_normal(np.zeros(3), s, 10_000)
        v[:, axis] += root / np.sqrt(information[axis, axis])
        found = np.einsum("ij,jk,ik->i", v, information, v) > 36.0
        assert found.mean() == pytest.approx(power, abs=0.03)


def test_shaking_has_no_spikes() -> None:
    rng, t = np.random.default_rng(3), np.arange(100) / 100
    shaking = np.outer(np.sin(2 * np.pi * 8.0 * t), [3.0, 1.0, 0.5]) + rng.normal(0, 0.01, (100, 3))
    assert not spikes(shaking).any()
    shaking[40, 1] += 20.0
    assert np.flatnonzero(spikes(shaking)).tolist() == [40]
