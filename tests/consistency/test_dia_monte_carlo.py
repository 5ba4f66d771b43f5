"""What the tests promise, counted: false alarms, the power at the MDB, what the protection levels bound.

Thousands of epochs with normal errors of exactly the covariance that the tests are told. The oracle is the truth that
was drawn. ``python -m tests.consistency.dia_monte_carlo`` prints the figures of the long run.
"""

from functools import lru_cache

import numpy as np
import pytest

from plumbline.quality.reliability import Integrity, factors

from .dia_recursive import count_recursive
from .dia_worlds import LEVELS, WORLDS, World, count_alarms, count_beyond, worst_external_difference


@lru_cache
def world_of(kind: type[World]) -> World:
    """One of each."""
    return kind()


worlds = pytest.mark.parametrize("kind", WORLDS, ids=lambda kind: kind.name)


@worlds
def test_false_alarms_are_the_significance_and_errors_of_the_mdb_are_found_with_the_power(kind: type[World]) -> None:
    """10 % of 5 % is 4.6 sigma of the count of 40,000; 3 % of power 7.5 sigma of that of 10,000."""
    counted = count_alarms(world_of(kind), 40_000, 10_000, 22)
    assert counted.false_alarms == pytest.approx(LEVELS.significance, rel=0.10)
    assert counted.false_w == pytest.approx(LEVELS.w_significance, rel=0.20)
    assert counted.power == pytest.approx(LEVELS.power, abs=0.03)


@worlds
def test_a_larger_error_is_attributed_to_its_own_observation(kind: type[World]) -> None:
    world, rng, factor = world_of(kind), np.random.default_rng(24), factors(LEVELS, Integrity())
    mdb, n, named, others = world.promised().mdb, 3000, 0, 0
    for trial in range(n):
        error, v = world.draw(rng)
        v[trial % world.m] += 2.5 * mdb[trial % world.m]
        adopted = world.tested(error, v, factor).adopted
        named += bool(adopted[trial % world.m])
        others += int(adopted.sum()) - int(adopted[trial % world.m])
    assert named / n > 0.99
    assert others / (n * world.m) < 2.0 * LEVELS.w_significance


@worlds
@pytest.mark.parametrize("size_in_mdb", [0.0, 0.6, 1.0, 1.3, 2.0])
def test_protection_levels_bound_the_error_at_the_risk_stated(kind: type[World], size_in_mdb: float) -> None:
    """Position errors that quality control lets through; any size of one observation's error, also the worst ones.

    The risk is stated large enough to be counted: 1e-3 an epoch, faults in one of ten.
    """
    integrity, n = Integrity(risk=1e-3, prior=0.1), 4_000
    bound = integrity.risk if size_in_mdb == 0.0 else integrity.risk / integrity.prior
    allowance = bound * n + 3.0 * np.sqrt(bound * n)
    assert max(count_beyond(world_of(kind), size_in_mdb, integrity, n, 25)) <= allowance


@worlds
def test_an_undetected_error_of_the_mdb_moves_the_position_by_the_external_reliability(kind: type[World]) -> None:
    """Lee 2016, eq. 56, to rounding: the filters are linear."""
    assert worst_external_difference(world_of(kind), 26) < 1e-6


def test_slow_biases_are_found_over_a_window_with_the_power_stated() -> None:
    """Errors too small for one epoch (Teunissen 1990): the window's own MDB, a fraction of an epoch's."""
    counted = count_recursive(2_000, 3_000, 27)
    assert counted.false_alarms == pytest.approx(LEVELS.significance, abs=0.015)
    assert counted.false_w == pytest.approx(LEVELS.w_significance, abs=0.0007)
    assert counted.power == pytest.approx(LEVELS.power, abs=0.03)
    assert counted.mdb_of_window < 0.3 * counted.mdb_of_epoch
    assert counted.moved_beside_response < 4.0
