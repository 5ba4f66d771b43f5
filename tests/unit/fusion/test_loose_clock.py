"""The samples' clock as two states: its design rows, its walk, and a drive whose logger was late.

Oracles: central differences; the mechanisation; the truth of a simulated drive whose stamps are spoilt.
"""

import numpy as np
import pytest
from tests.unit.fusion.inertial_scenes import T0, drive, measured, solution_at, truth_of
from tests.unit.fusion.test_strapdown import nav_local

from plumbline.config import InertialSettings
from plumbline.fusion.inertial_run import ROW_ACCELERATION, ROW_SIZE
from plumbline.fusion.loose_clock import (
    CLOCK_DRIFT,
    CLOCK_OFFSET,
    acceleration_enu_m_s2,
    at_true_times,
    carried,
    with_clock,
)
from plumbline.fusion.loose_eskf import initial_loose_state, receive_samples, receive_solution
from plumbline.fusion.loose_state import Fix, LooseExtra, SampleClock
from plumbline.fusion.loose_update import rows_of_fix
from plumbline.fusion.strapdown import step_local
from plumbline.fusion.timeline import Node
from plumbline.gps_time import NS_PER_S
from plumbline.records import Status

SETTINGS = InertialSettings(
    lever_arms_body_m=((0.3, -0.5, 0.8),), initial_gyroscope_bias_sigma_rad_s=1e-3, inertial_time_offset_sigma_s=0.1
)
SAMPLE = np.array([0.4, -0.8, 9.9, 0.2, -0.3, 0.5])


def fix_at(t_true_ns: int) -> Fix:
    """A position and a velocity near the scene's."""
    geodetic = nav_local()[:3] + np.array([1e-8, -2e-8, 0.5])
    return Fix(T0, geodetic, np.array([12.0, -7.0, 1.0]), np.eye(6), Status.RTK_FIXED, t_true_ns)


def test_the_column_of_the_offset_is_a_derivative() -> None:
    """Oracle: central differences; innovations shrink as the offset moves towards the truth."""
    nav, fix = nav_local(), fix_at(T0 + 30_000_000)
    h, _ = rows_of_fix(nav, SAMPLE, fix, SampleClock(T0, 0.01, 1e-4), T0, SETTINGS)
    both = [rows_of_fix(nav, SAMPLE, fix, SampleClock(T0, 0.01 + d, 1e-4), T0, SETTINGS)[1] for d in (1e-3, -1e-3)]
    np.testing.assert_allclose(-(both[0] - both[1]) / 2e-3, h[:, CLOCK_OFFSET], rtol=1e-9)
    assert not h[:, CLOCK_DRIFT].any()


def test_a_fix_between_stamps_is_where_the_platform_was() -> None:
    """Oracle: the mechanisation. The state of 20 ms before, a clock that is right: the same innovation to 2nd order."""
    nav, later, step_s = nav_local(), nav_local(), 0.02
    step_local(later, SAMPLE[:3].copy(), SAMPLE[3:].copy(), step_s, np.zeros(3))
    at_ns = T0 + round(step_s * NS_PER_S)
    fix, clock = fix_at(at_ns), SampleClock(T0)
    _, before = rows_of_fix(nav, SAMPLE, fix, clock, T0, SETTINGS)
    _, there = rows_of_fix(later, SAMPLE, fix, clock, at_ns, SETTINGS)
    _, unmoved = rows_of_fix(nav, SAMPLE, fix, None, T0, SETTINGS)
    np.testing.assert_allclose(before, there, atol=4e-3)
    assert np.abs(unmoved - there).max() > 0.1


def test_acceleration_is_that_of_the_mechanisation() -> None:
    """Oracle: velocity differences over a short step."""
    nav, after = nav_local(), nav_local()
    step_local(after, SAMPLE[:3].copy(), SAMPLE[3:].copy(), 1e-4, np.zeros(3))
    np.testing.assert_allclose((after[3:6] - nav[3:6]) / 1e-4, acceleration_enu_m_s2(nav, SAMPLE), atol=5e-4)


def test_the_clock_walks_and_drifts() -> None:
    """Oracle: the closed form of an offset with a constant drift and a random walk."""
    p, clock = with_clock(np.eye(15) * 1e-4, fix_at(T0 + 50_000_000), SETTINGS)
    assert clock == SampleClock(T0, 0.05)
    node = Node(T0 + 10 * NS_PER_S, np.zeros(21), p, LooseExtra(clock=SampleClock(T0, 0.05, 2e-4)))
    moved, there = carried(node, SETTINGS)
    assert moved is not None
    assert moved.offset_s == pytest.approx(0.052)
    drift, walk = SETTINGS.inertial_time_drift_sigma, SETTINGS.inertial_time_walk_s_sqrt_s
    assert there[CLOCK_OFFSET, CLOCK_OFFSET] == pytest.approx(0.1**2 + (10 * drift) ** 2 + 10 * walk**2)
    assert there[CLOCK_OFFSET, CLOCK_DRIFT] == pytest.approx(10 * drift**2)


def test_a_late_logger_is_found_out() -> None:
    """Oracle: truth. Stamps 0.17 s late, later by 0.3 ms every second; no offset given."""
    truth = truth_of(drive, 60.0)
    rng = np.random.default_rng(4)
    samples, _ = measured(truth, SETTINGS, rng)
    since_s = (truth.t_gps_ns - T0) / NS_PER_S
    late_s = 0.17 + 3e-4 * since_s
    stamps = truth.t_gps_ns + np.rint(late_s * NS_PER_S).astype(np.int64)
    state = initial_loose_state("T")
    for k in range(0, len(samples) - 25, 25):
        state = receive_samples(state, stamps[k : k + 25], samples[k : k + 25], SETTINGS).state
        state = receive_solution(state, solution_at(truth, k + 5, SETTINGS, rng, 0.01, 0.03), SETTINGS).state
    node = state.timeline.nodes[-1]
    assert node.extra.clock is not None
    found, sigma = node.extra.clock.offset_at(node.t_gps_ns), np.sqrt(np.diag(node.p))
    assert found == pytest.approx(-late_s[-1], abs=min(4 * sigma[CLOCK_OFFSET], 0.01))
    at = int(np.searchsorted(stamps, node.t_gps_ns))
    np.testing.assert_allclose((node.nav[:2] - truth.nav[at, :2]) * 6.37e6, 0.0, atol=0.1)


def test_rows_of_stamps_taken_for_true_times() -> None:
    """Oracle: the mechanisation. A clock 20 ms off: the row of a stamp is the state 20 ms before it."""
    nav, row = nav_local(), np.zeros((1, ROW_SIZE))
    later, acceleration, step_s = nav.copy(), np.zeros(3), 0.02
    step_local(later, SAMPLE[:3].copy(), SAMPLE[3:].copy(), step_s, acceleration)
    row[0, :21], row[0, ROW_ACCELERATION:] = later, acceleration
    moved = at_true_times(row, SampleClock(T0, step_s), np.array([T0]))
    np.testing.assert_allclose((moved[0, :2] - nav[:2]) * 6.37e6, 0.0, atol=2e-4)
    np.testing.assert_allclose(moved[0, 2:6], nav[2:6], atol=2e-4)
    assert at_true_times(row, None, np.array([T0])) is row
