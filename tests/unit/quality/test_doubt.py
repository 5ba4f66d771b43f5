"""Suspicions open and close. Oracle: made-up series of two antennas whose every displacement is known."""

import numpy as np
import pytest

from plumbline.epochs.reference_book import Shown
from plumbline.gps_time import NS_PER_S
from plumbline.quality.course import Course, extended
from plumbline.quality.doubt import Watch, accelerometer_says, neighbour_shows, own_shows
from plumbline.quality.structure_or_receiver import ACCELEROMETER, NEIGHBOUR, REFERENCE
from plumbline.records import Floats, Solution, Status

T0 = 1_400_000_000 * NS_PER_S
SIGMA_M = np.array([0.002, 0.002, 0.004])
STEP = np.array([0.03, 0.0, 0.0])
SHARE = 0.5


def epoch(second: int, displacement: Floats, name: str = "a", status: Status = Status.RTK_FIXED) -> Solution:
    t = T0 + second * NS_PER_S
    return Solution(name, t, t, status, "", displacement_enu_m=displacement)


def noise(seed: int, n: int) -> Floats:
    return np.random.default_rng(seed).normal(size=(n, 3)) * SIGMA_M


def follow(own: Floats, other: Floats, lag: int = 0) -> list[Watch]:
    """The watch after each second; the neighbour's epochs come ``lag`` seconds after the station's own."""
    watch, states = Watch(), []
    for k in range(len(own)):
        if k >= lag:
            watch = neighbour_shows(watch, "b", epoch(k - lag, other[k - lag], "b"), SHARE)
        watch = own_shows(watch, epoch(k, own[k]), {}, SHARE)
        states.append(watch)
    return states


def witnesses(watch: Watch) -> list[str]:
    return [suspicion.witness for suspicion in watch.open]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("lag", [0, 2])
def test_a_jump_of_one_antenna_is_doubted_from_its_first_epoch_on_and_for_as_long_as_it_lasts(
    seed: int, lag: int
) -> None:
    own, other = noise(seed, 1200), noise(seed + 100, 1200)
    own[300:1000] += STEP
    states = follow(own, other, lag)
    assert not any(state.open for state in states[:300])
    assert all(witnesses(state) == [NEIGHBOUR] for state in states[300 + lag + 1 : 1000])
    assert not any(state.open for state in states[1001:])
    (found,) = states[-1].ended or states[1000].ended
    assert abs(found.t_from_gps_ns - T0 - 300 * NS_PER_S) <= 2 * NS_PER_S
    assert found.t_until_gps_ns == T0 + 1000 * NS_PER_S
    assert np.linalg.norm(np.array(found.displacement_m) - STEP) < 0.012


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("lag", [0, 3])
def test_what_both_antennas_show_is_never_doubted(seed: int, lag: int) -> None:
    """A step, a creep, a sway of 25 mm, all common to both."""
    t = np.arange(1500)
    common = np.zeros((t.size, 3))
    common[300:, 0] += 0.05
    common[:, 1] += 3e-5 * t
    common[700:900, 1] += 0.025 * np.sin(2 * np.pi * 0.31 * t[700:900])
    states = follow(common + noise(seed, t.size), common + noise(seed + 100, t.size), lag)
    assert not any(state.open for state in states)


def test_a_real_motion_after_a_doubted_jump_is_believed() -> None:
    own, other = noise(1, 900), noise(2, 900)
    own[300:] += STEP
    own[600:, 1] += 0.10
    other[600:, 1] += 0.09
    states = follow(own, other)
    assert witnesses(states[599]) == [NEIGHBOUR]
    assert not any(state.open for state in states[601:])


def test_a_neighbour_that_says_nothing_is_not_a_witness() -> None:
    own = noise(3, 400)
    own[300:] += STEP
    watch = Watch()
    for k in range(400):
        if k < 250:
            watch = neighbour_shows(watch, "b", epoch(k, np.zeros(3), "b"), SHARE)
        converging = epoch(k, np.zeros(3), "c", Status.CONVERGING)
        watch = own_shows(neighbour_shows(watch, "c", converging, SHARE), epoch(k, own[k]), {}, SHARE)
    assert not watch.open


def test_the_accelerometer_s_word_holds_while_the_jump_lasts() -> None:
    own = noise(4, 900)
    own[300:800] += STEP
    watch, opened, ended = Watch(), None, None
    for k in range(900):
        watch = own_shows(watch, epoch(k, own[k]), {}, SHARE)
        if k in (300, 301, 302):
            watch = accelerometer_says(watch, T0 + k * NS_PER_S, own[k], own[k] / 0.002)
        opened = k if watch.open and opened is None else opened
        ended = k if opened is not None and not watch.open and ended is None else ended
    assert (opened, ended) == (300, 800)
    assert watch.ended[0].witness == ACCELEROMETER


def test_a_reference_station_s_own_motion_is_found_in_its_rovers() -> None:
    own = noise(5, 500)
    own[300:] -= STEP
    watch = Watch()
    for k in range(500):
        shown = STEP if k >= 300 else np.zeros(3)
        t = T0 + k * NS_PER_S
        references = {"base": Shown(t, t, tuple(shown.tolist()), (0.004, 0.004, 0.008))}
        watch = own_shows(watch, epoch(k, own[k]), references, SHARE)
        assert (REFERENCE in witnesses(watch)) == (k >= 300)
    assert "base moved by 30 mm" in watch.open[0].reason


def test_a_new_level_that_nobody_doubts_becomes_the_baseline() -> None:
    course, level = Course(), noise(6, 1200)
    level[300:] += STEP
    for k in range(1200):
        course = extended(course, T0 + k * NS_PER_S, level[k], frozen=False)
        if k == 299:
            assert np.allclose(course.sigma_m, SIGMA_M, rtol=0.35)
    assert np.linalg.norm(np.array(course.baseline_m) - STEP) < 0.003
    gone = extended(course, T0 + 2000 * NS_PER_S, STEP, frozen=False)
    assert not gone.is_learnt  # after a gap nothing is known of the last minutes


def test_a_neighbour_that_was_away_while_the_structure_moved_does_not_deny_it() -> None:
    own, other = noise(7, 900), noise(8, 900)
    own[400:] += 5 * STEP
    other[400:] += 5 * STEP
    watch = Watch()
    for k in range(900):
        if not 300 <= k < 430:
            watch = neighbour_shows(watch, "b", epoch(k, other[k], "b"), SHARE)
        watch = own_shows(watch, epoch(k, own[k]), {}, SHARE)
        assert not watch.open
