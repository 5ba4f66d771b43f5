"""De Alteriis 2022, tables 1 to 4, with a simulated ADIS16495 and ZED-F9P: no worse than each figure.

Oracle: truth. The sensors' errors are those of section 2 of the paper (0.8 °/h, 0.09 °/√h; 3.2 µg, 0.008 m/s/√h), the
receiver's 1 cm and 3 cm/s at 5 Hz. The platform is set up with a known heading, as the prototype was. Positions are
held for a quarter of a minute instead of a whole one.
"""

from collections.abc import Callable

import numpy as np
import pytest
from tests.unit.fusion.inertial_scenes import T0, Truth, measured, rest, solution_at, truth_of

from plumbline.config import InertialSettings
from plumbline.fusion.inertial_run import ROW_NAV
from plumbline.fusion.loose_eskf import initial_loose_state, receive_samples, receive_solution
from plumbline.fusion.rotations import angles_from_rotation
from plumbline.gps_time import NS_PER_S
from plumbline.offline_imu_options import SHEETS

RATE, EVERY = 125, 25
HOLD_S, TURN_S, SET_UP_S = 12.0, 3.0, 60.0
SETTINGS = InertialSettings.model_validate(
    dict(SHEETS["adis16495"]) | {"lever_arms_body_m": ((0.0, 0.1, 0.15),), "heading_sigma_deg": 0.05}
)


def turning(step_deg: float, steps: int) -> Callable[[float], tuple[np.ndarray, np.ndarray]]:
    """Stands, then turns clockwise by steps about the vertical, each followed by a rest."""

    def motion(t: float) -> tuple[np.ndarray, np.ndarray]:
        since = t - SET_UP_S
        number, within = divmod(since, HOLD_S + TURN_S)
        rate = np.zeros(3)
        if 0 <= number < steps and within < TURN_S:
            rate[2] = -np.radians(step_deg) / TURN_S * (1 - np.cos(2 * np.pi * within / TURN_S))
        return np.zeros(3), rate

    return motion


def angles_deg(truth: Truth, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Times, s, and heading, pitch, roll (n, 3) of the filter less the truth's, degrees."""
    rng = np.random.default_rng(seed)
    samples, _ = measured(truth, SETTINGS, rng)
    heading = np.degrees(angles_from_rotation(truth.nav[0, 6:15].reshape(3, 3)))[0] + 0.05 * rng.normal()
    settings = SETTINGS.model_copy(update={"heading_deg": heading % 360.0})
    state, times, found = initial_loose_state("A"), [], []
    for k in range(0, len(samples) - EVERY, EVERY):
        result = receive_samples(state, truth.t_gps_ns[k : k + EVERY], samples[k : k + EVERY], settings)
        state = receive_solution(
            result.state, solution_at(truth, k + EVERY - 1, settings, rng, 0.01, 0.03), settings
        ).state
        if len(result.rows.t_gps_ns):
            rotation = result.rows.values[-1, ROW_NAV + 6 : ROW_NAV + 15].reshape(3, 3)
            at = int(np.searchsorted(truth.t_gps_ns, result.rows.t_gps_ns[-1]))
            error = angles_from_rotation(rotation) - angles_from_rotation(truth.nav[at, 6:15].reshape(3, 3))
            times.append((int(result.rows.t_gps_ns[-1]) - T0) / NS_PER_S)
            found.append(np.degrees((error + np.pi) % (2 * np.pi) - np.pi))
    return np.array(times), np.array(found)


def steps_of(times: np.ndarray, errors: np.ndarray, step_deg: float, steps: int) -> np.ndarray:
    """Rotation between successive positions, as the paper takes it: differences of the rests' mean headings."""
    means = []
    for number in range(steps + 1):
        end = SET_UP_S + number * (HOLD_S + TURN_S)
        means.append(errors[(times > end - HOLD_S + 1.0) & (times < end - 0.5), 0].mean())
    return step_deg + np.diff(means)


@pytest.fixture(scope="module")
def static() -> tuple[np.ndarray, np.ndarray]:
    """Ten minutes in three: what drifts is the gyroscope's, whose bias the standstill holds."""
    return angles_deg(truth_of(rest, 200.0, RATE, (0.001, 0.002, 0.008), fine=1), 1)


def test_table_1_static_scatter(static: tuple[np.ndarray, np.ndarray]) -> None:
    """Standard deviations: heading 0.04°, pitch 0.11°, roll 0.23°."""
    times, errors = static
    scatter = errors[times > 20.0].std(axis=0)
    print("table 1, std heading pitch roll:", np.round(scatter, 4))
    assert (scatter <= [0.04, 0.11, 0.23]).all()


def test_table_4_against_a_reference(static: tuple[np.ndarray, np.ndarray]) -> None:
    """Means 0.03/0.07/0.22°, standard deviations 0.07/0.34/0.31°, RMSE 0.08/0.35/0.38° of heading, pitch, roll."""
    times, errors = static
    late = errors[times > 120.0]
    scatter, rmse = late.std(axis=0), np.sqrt((late**2).mean(axis=0))
    print("table 4, mean, std, RMSE:", np.round(late.mean(axis=0), 3), np.round(scatter, 4), np.round(rmse, 3))
    assert (scatter <= [0.07, 0.34, 0.31]).all()
    assert (rmse <= [0.08, 0.35, 0.38]).all()


def test_table_2_steps_of_ten_degrees() -> None:
    """36 steps: 10.04 ± 0.18° there."""
    truth = truth_of(turning(10.0, 36), SET_UP_S + 36 * (HOLD_S + TURN_S), RATE, fine=1)
    steps = steps_of(*angles_deg(truth, 2), 10.0, 36)
    print(f"table 2: {steps.mean():.3f} ± {steps.std():.3f}°")
    assert abs(steps.mean() - 10.0) <= 0.04
    assert steps.std() <= 0.18


def test_table_3_complete_overturns() -> None:
    """Four steps of 90°, three times: 0.01 ± 0.15° there."""
    truth = truth_of(turning(90.0, 12), SET_UP_S + 12 * (HOLD_S + TURN_S), RATE, fine=1)
    steps = steps_of(*angles_deg(truth, 3), 90.0, 12)
    print(f"table 3: {steps.mean() - 90.0:.3f} ± {steps.std():.3f}°")
    assert abs(steps.mean() - 90.0) <= 0.01
    assert steps.std() <= 0.15
