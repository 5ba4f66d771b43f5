"""Samples on the grid: pass-through, closed-form cubics, streams that straddle blocks."""

import numpy as np
import pytest
from tests.unit.fusion.scenes import T0, S

from plumbline.epochs.time_matching import (
    NO_TAIL,
    grid_rate,
    grid_time_ns,
    interpolate_cubic,
    match_samples,
    nearest_grid_index,
)
from plumbline.records import Floats, InertialBlock, Ints


def cubic(t_ns: Ints) -> Floats:
    t = (t_ns - T0) * 1e-9
    return np.column_stack([t**3 - t, 2 * t**2 + 1, 0.5 - t])


def test_samples_on_the_grid_pass_untouched() -> None:
    values = np.random.default_rng(0).normal(size=(100, 3))
    first, placed, _ = match_samples(InertialBlock(T0 + 20_000, T0, 10_000_000, values), 0.0, NO_TAIL)
    assert first == T0 // S * 100
    np.testing.assert_array_equal(placed, values)


@pytest.mark.parametrize(("offset_s", "interval_ns"), [(0.0033, 10_000_000), (-0.125, 8_000_000), (0.0, 9_990_000)])
def test_a_cubic_comes_out_exact_without_holes_between_blocks(offset_s: float, interval_ns: int) -> None:
    tail, indices, placed = NO_TAIL, [], []
    start = T0
    for _ in range(5):
        times = start + interval_ns * np.arange(60)
        values = cubic(times + round(offset_s * 1e9))
        first, part, tail = match_samples(InertialBlock(start, start, interval_ns, values), offset_s, tail)
        indices += list(range(first, first + len(part)))
        placed.append(part)
        start += 60 * interval_ns
    assert indices == list(range(indices[0], indices[0] + len(indices)))
    rate = grid_rate(interval_ns)
    assert rate is not None
    at = np.array([grid_time_ns(i, rate) for i in indices])
    np.testing.assert_allclose(np.concatenate(placed), cubic(at), atol=1e-9)


def test_a_hole_is_not_bridged() -> None:
    values = np.zeros((50, 3))
    _, _, tail = match_samples(InertialBlock(T0 + 3_000_000, T0, 10_000_000, values), 0.0, NO_TAIL)
    first, _, _ = match_samples(InertialBlock(T0 + 2 * S + 3_000_000, T0, 10_000_000, values), 0.0, tail)
    assert grid_time_ns(first, 100) == T0 + 2 * S + 10_000_000


def test_a_sine_keeps_its_amplitude_at_half_a_sample_offset() -> None:
    """10 Hz at 100 Hz, the worst offset: within 0.5 % (linear interpolation would lose 5 %)."""
    times = T0 + 10_000_000 * np.arange(200)
    values = np.repeat(np.sin(2 * np.pi * 10 * (times - T0) * 1e-9)[:, None], 3, axis=1)
    at = times[2:-2] + 5_000_000
    expected = np.sin(2 * np.pi * 10 * (at - T0) * 1e-9)
    assert np.abs(interpolate_cubic(times, values, at)[:, 0] - expected).max() < 5e-3


def test_rates_and_nearest_points() -> None:
    assert [grid_rate(ns) for ns in (20_000_000, 8_333_333, 5_000_000, 0, -1, 10**10)] == [
        50,
        120,
        200,
        None,
        None,
        None,
    ]
    index = nearest_grid_index(T0 + 996_000_000, 100)
    assert index == T0 // S * 100 + 100
    assert grid_time_ns(nearest_grid_index(T0 + 8_333_000, 120), 120) == T0 + 8_333_333
