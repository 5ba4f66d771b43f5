"""The loose filter: its Jacobians, its start, standstills, late and bad inputs.

Oracles: central differences; the truth of a simulated drive; the filter itself with inputs in order.
"""

import numpy as np
import pytest
from tests.unit.fusion.inertial_scenes import T0, Truth, drive, measured, rest, solution_at, truth_of
from tests.unit.fusion.test_strapdown import nav_local

from plumbline.config import InertialSettings
from plumbline.fusion.error_model import feed_back
from plumbline.fusion.loose_eskf import initial_loose_state, receive_samples, receive_solution
from plumbline.fusion.loose_state import LooseResult, LooseState
from plumbline.fusion.loose_update import fix_rows
from plumbline.fusion.rotations import angles_from_rotation, rotation_log
from plumbline.fusion.strapdown import earth_rate_local_rad_s
from plumbline.fusion.zupt import Standstill, standstill_rows, standstills
from plumbline.gps_time import NS_PER_S
from plumbline.records import Solution

SETTINGS = InertialSettings(lever_arms_body_m=((0.3, -0.5, 0.8),), initial_gyroscope_bias_sigma_rad_s=1e-3)
ARM = np.array(SETTINGS.lever_arms_body_m[0])
SIZES = np.repeat([10.0, 1.0, 1e-4, 1e-2, 1e-4], 3)


@pytest.fixture(scope="module")
def truth() -> Truth:
    """A drive of 40 s."""
    return truth_of(drive, 40.0)


@pytest.mark.parametrize("column", range(15))
def test_fix_rows_are_derivatives(column: int) -> None:
    """Oracle: central differences of the innovations: they shrink as the state moves towards the truth."""
    nav, rate = nav_local(), np.array([0.2, -0.3, 0.5])
    geodetic, velocity = nav[:3] + np.array([1e-8, -2e-8, 0.5]), np.array([12.0, -7.0, 1.0])
    h, _ = fix_rows(nav, rate, ARM, geodetic, velocity)
    both = []
    for sign in (1.0, -1.0):
        moved, error = nav.copy(), np.zeros(15)
        error[column] = sign * SIZES[column]
        feed_back(moved, np.eye(15), error, True)
        both.append(fix_rows(moved, rate, ARM, geodetic, velocity)[1])
    derivative = -(both[0] - both[1]) / (2 * SIZES[column])
    np.testing.assert_allclose(derivative, h[:, column], atol=5e-7)


@pytest.mark.parametrize("column", [3, 4, 5, 6, 7, 8, 12, 13, 14])
def test_standstill_rows_are_derivatives(column: int) -> None:
    """Oracle: central differences of the innovations."""
    nav = nav_local(np.array([0.01, 0.02, -0.01]))
    window = Standstill(0, 0, np.zeros(3), np.array([1e-3, 2e-3, -1e-3]), 0.5)
    earth = earth_rate_local_rad_s(nav[0])
    h, _, _ = standstill_rows(nav, earth, window, SETTINGS, 15)
    both = []
    for sign in (1.0, -1.0):
        moved, error = nav.copy(), np.zeros(15)
        error[column] = sign * 1e-4
        feed_back(moved, np.eye(15), error, True)
        both.append(standstill_rows(moved, earth, window, SETTINGS, 15)[2])
    np.testing.assert_allclose(-(both[0] - both[1]) / 2e-4, h[:, column], atol=1e-9)


def test_standstills_are_found() -> None:
    """Oracle: the drive stands for ten seconds and moves ever after; blocks do not matter."""
    moving = truth_of(drive, 15.0)
    samples, _ = measured(moving, SETTINGS, np.random.default_rng(0))
    found = standstills(moving.t_gps_ns, samples, 0, SETTINGS)
    ends = np.array([w.t_gps_ns - T0 for w in found]) / NS_PER_S
    assert len(found) == 20
    assert ends.max() < 10.0
    later = standstills(moving.t_gps_ns, samples, found[4].t_gps_ns, SETTINGS)
    assert [w.t_gps_ns for w in later] == [w.t_gps_ns for w in found[5:]]


def run(
    truth: Truth, seed: int, settings: InertialSettings = SETTINGS, late_s: float = 0.0, outlier: int | None = None
) -> tuple[LooseState, list[LooseResult], np.ndarray]:
    """Samples in blocks of a quarter second, a solution a block, delivered ``late_s`` after its time."""
    rng = np.random.default_rng(seed)
    samples, biases = measured(truth, settings, rng)
    state, results, waiting = initial_loose_state("T"), [], []
    for k in range(0, len(samples) - 25, 25):
        solution = solution_at(truth, k + 24, settings, rng, 0.01, 0.03)
        if outlier == k // 25 and solution.position_ecef_m is not None:
            solution.position_ecef_m[:] += 3.0
        waiting.append(solution)
        results.append(receive_samples(state, truth.t_gps_ns[k : k + 25], samples[k : k + 25], settings))
        state = results[-1].state
        due = [s for s in waiting if s.t_gps_ns + late_s * 1e9 <= truth.t_gps_ns[k + 24]]
        waiting = [s for s in waiting if s not in due] if len(due) != len(waiting) else []
        for one in due:
            results.append(receive_solution(state, one, settings))
            state = results[-1].state
    for one in waiting:
        results.append(receive_solution(state, one, settings))
        state = results[-1].state
    return state, results, biases


def test_a_drive(truth: Truth) -> None:
    """Oracle: truth. Heading found from the motion alone, position to centimetres, biases found."""
    state, results, biases = run(truth, 3)
    assert state.aligned.startswith("heading")
    node = state.timeline.nodes[-1]
    k = int(np.searchsorted(truth.t_gps_ns, node.t_gps_ns))
    np.testing.assert_allclose(node.nav[2], truth.nav[k, 2], atol=0.05)
    np.testing.assert_allclose((node.nav[:2] - truth.nav[k, :2]) * 6.37e6, 0.0, atol=0.06)
    error = rotation_log(truth.nav[k, 6:15].reshape(3, 3) @ node.nav[6:15].reshape(3, 3).T)
    assert np.degrees(np.abs(error)).max() < 1.0
    np.testing.assert_allclose(node.nav[18:21], biases[k, 3:], atol=3e-4)
    innovations = [i for r in results for i in r.innovations]
    assert sum(i.used for i in innovations) == len(innovations) > 50


def test_late_solutions_change_nothing(truth: Truth) -> None:
    """Oracle: the same run with every solution on time; the last nodes agree to rounding."""
    on_time, _, _ = run(truth, 5)
    late, _, _ = run(truth, 5, late_s=1.0)
    assert on_time.timeline.nodes[-1].t_gps_ns == late.timeline.nodes[-1].t_gps_ns
    a, b = on_time.timeline.nodes[-1].nav, late.timeline.nodes[-1].nav
    if on_time.aligned == late.aligned:
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)
    else:  # the late run may have begun at another solution
        np.testing.assert_allclose(a[3:6], b[3:6], atol=0.03)


def test_too_late_and_repeated_are_counted(truth: Truth) -> None:
    """Oracle: counters; the state's head does not move."""
    state, _, _ = run(truth, 5)
    old = solution_at(truth, 1500, SETTINGS, np.random.default_rng(0), 0.01, 0.03)
    result = receive_solution(state, old, SETTINGS)
    assert result.state.timeline.counters["measurement_too_late"] == 1
    np.testing.assert_array_equal(result.state.timeline.nodes[-1].nav, state.timeline.nodes[-1].nav)
    again = receive_samples(state, truth.t_gps_ns[:5], truth.samples[:5], SETTINGS)
    assert again.state.timeline.counters["inertial_late_or_repeated"] == 5


def test_an_outlier_is_refused(truth: Truth) -> None:
    """Oracle: one position off by five metres, and a filter that does not follow it."""
    state, results, _ = run(truth, 3, outlier=140)
    refused = [i for r in results for i in r.innovations if not i.used]
    assert len(refused) == 1
    assert np.abs(refused[0].value[:3]).max() > 1.0
    node = state.timeline.nodes[-1]
    k = int(np.searchsorted(truth.t_gps_ns, node.t_gps_ns))
    np.testing.assert_allclose((node.nav[:2] - truth.nav[k, :2]) * 6.37e6, 0.0, atol=0.06)


def test_a_known_heading_starts_at_rest() -> None:
    """Oracle: the truth's angles; a platform that never moves."""
    still = truth_of(rest, 8.0)
    settings = SETTINGS.model_copy(update={"heading_deg": 28.6, "heading_sigma_deg": 0.5})
    state, _, _ = run(still, 1, settings)
    angles = np.degrees(angles_from_rotation(state.timeline.nodes[-1].nav[6:15].reshape(3, 3)))
    assert angles[0] == pytest.approx(np.degrees(0.5), abs=0.6)
    assert angles[1] == pytest.approx(np.degrees(0.02), abs=0.4)  # the accelerometer's bias is not observable


def test_a_solution_without_a_position_is_counted() -> None:
    """Oracle: the reason counted is its status."""
    from plumbline.records import Status

    nothing = Solution("T", T0, T0, Status.NO_BASE, "no base")
    state = receive_solution(initial_loose_state("T"), nothing, SETTINGS).state
    assert state.timeline.counters == {"solution_no_base": 1}
