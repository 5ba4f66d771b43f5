"""The structure or the receiver, and reference stations that move. Oracle: made-up scenes whose cause is known."""

import numpy as np

from plumbline.gps_time import NS_PER_S
from plumbline.quality.reference_watch import Watch, watch
from plumbline.quality.structure_or_receiver import (
    contradicted_by_accelerometer,
    contradicted_by_neighbours,
    explained_by_reference,
)
from plumbline.records import Floats, Solution, Status

COVARIANCE = np.diag([0.003, 0.003, 0.006]) ** 2
STEP = np.array([0.05, 0.0, 0.0])


def test_the_accelerometer_is_asked() -> None:
    assert contradicted_by_accelerometer(np.array([1.0, 2.0, 0.5]), STEP, STEP) is None
    found = contradicted_by_accelerometer(np.array([9.0, 0.0, 0.0]), STEP, STEP)
    assert found is not None
    assert "felt nothing of 50 mm" in found.reason
    assert contradicted_by_accelerometer(np.array([9.0, 0.0, 0.0]), 0.1 * STEP, STEP) is None  # it felt nine tenths


def test_what_only_one_antenna_shows_is_its_own() -> None:
    still, along = np.zeros(3), 0.8 * STEP
    assert contradicted_by_neighbours(STEP, COVARIANCE, {"b": (along, COVARIANCE)}) is None
    found = contradicted_by_neighbours(STEP, COVARIANCE, {"b": (still, COVARIANCE), "c": (-STEP, COVARIANCE)})
    assert found is not None
    assert "b, c do not" in found.reason
    assert contradicted_by_neighbours(STEP, COVARIANCE, {"b": (still, COVARIANCE), "c": (along, COVARIANCE)}) is None
    assert contradicted_by_neighbours(STEP, COVARIANCE, {}) is None
    assert contradicted_by_neighbours(STEP, 400 * COVARIANCE, {"b": (still, COVARIANCE)}) is None  # not significant


def test_a_reference_station_that_moves_is_not_the_rovers_motion() -> None:
    sigma = np.array([0.002, 0.002, 0.004])
    assert explained_by_reference(STEP, -STEP, sigma) is not None
    assert explained_by_reference(STEP, STEP, sigma) is None
    assert explained_by_reference(STEP, np.array([0.001, 0.0, 0.0]), sigma) is None


def follow(displacements: Floats) -> Watch:
    """A watch fed an epoch every 30 s."""
    state = Watch()
    for k, displacement in enumerate(displacements):
        t = 1_400_000_000 * NS_PER_S + 30 * k * NS_PER_S
        state = watch(state, Solution("base", t, t, Status.PPP_FLOAT, "", displacement_enu_m=displacement))
    return state


def test_cusum_finds_a_shift_of_its_scatter_and_leaves_a_still_station_alone() -> None:
    """A day at 30 s; samples are means over ten minutes."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        quiet = np.repeat(rng.normal(size=(144, 3)) * [0.003, 0.003, 0.006], 20, axis=0)
        assert follow(quiet).moved == ""
    rng = np.random.default_rng(31)
    slow = np.repeat(rng.normal(size=(144, 3)) * [0.003, 0.003, 0.006], 20, axis=0)
    still = slow + rng.normal(size=slow.shape) * 0.002
    assert follow(still).moved == ""
    shifted = still.copy()
    shifted[1000:, 0] += 0.010
    moved = follow(shifted).moved
    assert "east" in moved
    assert "up" not in moved
    assert follow(shifted[:1000]).moved == ""


def test_only_converged_positions_are_watched() -> None:
    state = watch(Watch(), Solution("base", 0, 0, Status.CONVERGING, "", displacement_enu_m=np.ones(3)))
    assert state == Watch()
