"""The smoothed series of the loose filter.

Oracles: one least-squares solution over all instants of a linear stretch; the truth of simulated drives, in which the
smoothed states are as good as they say and better than the filtered ones.
"""

import numpy as np
import pytest
from scipy.stats import chi2
from tests.unit.fusion.inertial_scenes import Truth, drive, error_local, measured, solution_at, truth_of

from plumbline.config import InertialSettings
from plumbline.fusion.error_model import feed_back
from plumbline.fusion.loose_eskf import initial_loose_state, receive_samples, receive_solution
from plumbline.fusion.loose_smoother import rows_between, smoothed
from plumbline.fusion.loose_start import start
from plumbline.fusion.loose_state import LooseExtra, LooseNode, SampleClock
from plumbline.fusion.timeline import Node

SETTINGS = InertialSettings(
    lever_arms_body_m=((0.3, -0.5, 0.8),), standstill="off", late_limit_s=60.0,
    initial_accelerometer_bias_sigma_m_s2=0.02, initial_gyroscope_bias_sigma_rad_s=2e-4,
    accelerometer_noise_m_s2_sqrt_hz=2e-3, gyroscope_noise_rad_s_sqrt_hz=2e-4,
    accelerometer_bias_sigma_m_s2=2e-3, gyroscope_bias_sigma_rad_s=2e-5,
    accelerometer_bias_time_s=300.0, gyroscope_bias_time_s=300.0,
)  # fmt: skip
CLOCKED = SETTINGS.model_copy(update={"inertial_time_offset_sigma_s": 0.02})
FIRST_SIGMA = np.repeat([0.02, 0.05, 0.01, 0.02, 2e-4], 3)
BEGIN, EVERY, GAP = 1100, 25, range(1500, 2000)


@pytest.fixture(scope="module")
def truth() -> Truth:
    """A drive of 26 s."""
    return truth_of(drive, 26.0)


def filtered(
    truth: Truth, seed: int, settings: InertialSettings = SETTINGS
) -> tuple[list[LooseNode], np.ndarray, np.ndarray]:
    """Nodes of a run with an outage of five seconds, the samples, the biases; the first error is drawn."""
    rng = np.random.default_rng(seed)
    samples, biases = measured(truth, settings, rng)
    nav = truth.nav[BEGIN].copy()
    nav[15:] = biases[BEGIN]
    feed_back(nav, np.eye(15), -FIRST_SIGMA * rng.normal(size=15), True)
    p, clock = np.diag(FIRST_SIGMA**2), None
    if settings.inertial_time_offset_sigma_s:
        clock = SampleClock(int(truth.t_gps_ns[BEGIN]), 0.02 * rng.normal(), 3e-4 * rng.normal())
        p = np.diag(np.concatenate([FIRST_SIGMA, [0.02, 3e-4]]) ** 2)
    node = Node(int(truth.t_gps_ns[BEGIN]), nav, p, LooseExtra(clock=clock))
    state = start(initial_loose_state("T"), node, "given", settings)
    for k in range(BEGIN - 1, len(samples) - EVERY, EVERY):
        state = receive_samples(state, truth.t_gps_ns[k : k + EVERY], samples[k : k + EVERY], settings).state
        at = k + EVERY - 6
        if at not in GAP:
            state = receive_solution(state, solution_at(truth, at, settings, rng, 0.01, 0.03), settings).state
    return list(state.timeline.nodes), samples, biases


def error_of(truth: Truth, biases: np.ndarray, node: LooseNode) -> np.ndarray | None:
    """Error state of a node at a sample's time, the clock's appended (the truth: none)."""
    at = int(np.searchsorted(truth.t_gps_ns, node.t_gps_ns))
    if truth.t_gps_ns[at] != node.t_gps_ns:
        return None
    error = error_local(truth.nav[at], biases[at], node.nav)
    clock = node.extra.clock
    return error if clock is None else np.concatenate([error, [-clock.offset_s, -clock.drift]])


@pytest.mark.parametrize("settings", [SETTINGS, CLOCKED], ids=["stamps right", "stamps estimated"])
def test_smoothed_states_are_as_good_as_they_say(truth: Truth, settings: InertialSettings) -> None:
    """Oracle: the chi-square distribution of NEES; in the outage, a third of the filter's error or less."""
    nees, before, after, size = [], [], [], 15 if settings is SETTINGS else 17
    runs = 12
    for seed in range(runs):
        nodes, samples, biases = filtered(truth, seed, settings)
        better = smoothed(nodes, truth.t_gps_ns, samples, settings)
        assert better[-1] is nodes[-1]
        found = []
        for raw, node in zip(nodes, better, strict=True):
            error, first = error_of(truth, biases, node), error_of(truth, biases, raw)
            if error is None or first is None:
                continue
            found.append(float(error @ np.linalg.solve(node.p, error)))
            if node.t_gps_ns in truth.t_gps_ns[GAP.start + 300 : GAP.stop - 100]:
                before.append(np.hypot(*first[:2]))
                after.append(np.hypot(*error[:2]))
        nees.append(np.mean(found))
    low, high = chi2.ppf([0.001, 0.999], size * runs) / runs  # an instant's band: the mean over a run is within it
    print(f"NEES {np.mean(nees):.2f} of {size}, outage rms {np.std(before):.3f} → {np.std(after):.3f} m")
    assert low < np.mean(nees) < high
    assert np.sqrt(np.mean(np.square(after))) < np.sqrt(np.mean(np.square(before))) / 3


def test_against_one_least_squares_solution(truth: Truth) -> None:
    """Oracle: all measurements of the position at once, for a platform without noise of its own: the last filtered
    state carried back is the smoothed one."""
    quiet = SETTINGS.model_copy(
        update={
            "accelerometer_noise_m_s2_sqrt_hz": 1e-9, "gyroscope_noise_rad_s_sqrt_hz": 1e-10,
            "accelerometer_bias_sigma_m_s2": 1e-9, "gyroscope_bias_sigma_rad_s": 1e-11,
            "accelerometer_bias_time_s": 1e7, "gyroscope_bias_time_s": 1e7,
        }
    )  # fmt: skip
    nodes, samples, _ = filtered(truth, 3, quiet)
    better = smoothed(nodes, truth.t_gps_ns, samples, quiet)
    for rows, second in zip(rows_between(better, truth.t_gps_ns, samples, quiet), better[1:], strict=True):
        if rows.t_gps_ns.size and rows.t_gps_ns[-1] == second.t_gps_ns:
            np.testing.assert_allclose(rows.values[-1, 3:6], second.nav[3:6], atol=2e-4)
            np.testing.assert_allclose((rows.values[-1, :2] - second.nav[:2]) * 6.37e6, 0.0, atol=2e-4)
    first = better[0]
    assert np.trace(first.p[:3, :3]) < 0.2 * np.trace(nodes[0].p[:3, :3])


def test_rows_lie_on_the_samples(truth: Truth) -> None:
    """Oracle: the samples' own times, each once."""
    nodes, samples, _ = filtered(truth, 5)
    rows = rows_between(smoothed(nodes, truth.t_gps_ns, samples, SETTINGS), truth.t_gps_ns, samples, SETTINGS)
    times = np.concatenate([r.t_gps_ns for r in rows])
    inside = (truth.t_gps_ns > nodes[0].t_gps_ns) & (truth.t_gps_ns <= nodes[-1].t_gps_ns)
    np.testing.assert_array_equal(times, truth.t_gps_ns[inside])
