"""What the position filter does with gaps, slips, jumps and missing corrections, in a world whose truth is known."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from plumbline.constants import LIGHT_MILLISECOND_M
from plumbline.gnss.troposphere import ZENITH_WET
from plumbline.positioning.gather import site_of
from plumbline.positioning.ppp import step
from plumbline.positioning.satellites import Cause
from plumbline.positioning.solutions import rotation_at
from plumbline.positioning.state import N_CORE, initial_state
from plumbline.records import Status
from plumbline.signals import FREQUENCY_HZ, System

from .ppp_world import MARKER_M, T0_NS, Receiver, Sky, orbit, settings_of


def _drive(receiver, sky, settings, epochs, state=None, change=lambda epoch: epoch):
    state, solutions = state or initial_state(), []
    for _ in range(epochs):
        state, solution = step(state, change(receiver.observe()), sky, settings, receiver.facts)
        solutions.append(solution)
    return state, solutions


@pytest.fixture
def settled():
    """Sky, settings, receiver and state after 40 epochs at 1 Hz with a twentieth of the usual noise."""
    sky, settings = Sky(), settings_of()
    receiver = Receiver(sky, settings, seed=7, interval_s=1.0, noise=0.05)
    state, solutions = _drive(receiver, sky, settings, 40)
    assert all(s.status.has_position for s in solutions)
    return sky, settings, receiver, state


def _change_satellite(epoch, satellite, cycles=(0.0, 0.0), code_m=0.0):
    phase, code = epoch.carrier_phase_cycles.copy(), epoch.pseudorange_m.copy()
    rows = np.flatnonzero(epoch.satellite == satellite)
    phase[rows] += cycles
    code[rows] += code_m
    return replace(epoch, carrier_phase_cycles=phase, pseudorange_m=code)


def test_without_noise_the_position_is_exact():
    """Oracle: the truth; the model predicts what the made-up receiver observes."""
    sky, settings = Sky(), settings_of()
    receiver = Receiver(sky, settings, noise=0.0)
    receiver.wet_m = site_of(MARKER_M, receiver.facts, T0_NS).troposphere[ZENITH_WET]  # as a priori
    _, solutions = _drive(receiver, sky, settings, 30)
    np.testing.assert_allclose(solutions[-1].displacement_enu_m, 0.0, atol=2e-3)
    np.testing.assert_allclose(solutions[-1].position_ecef_m, MARKER_M, atol=2e-3)


def test_a_moving_antenna_is_followed():
    """Oracle: the motion put in, 5 cm at 0.1 Hz."""
    sky, settings = Sky(), settings_of()

    def motion_m(t_s):
        return np.array([0.0, 0.0, 0.05 * np.sin(2 * np.pi * 0.1 * t_s)])

    receiver = Receiver(sky, settings, seed=3, interval_s=1.0, noise=0.05, motion_m=motion_m)
    state, _ = _drive(receiver, sky, settings, 40)
    moved, found = [], []
    for _ in range(30):
        state, solution = step(state, receiver.observe(), sky, settings, receiver.facts)
        moved.append(receiver.marker_m() - MARKER_M)
        found.append(solution.position_ecef_m - MARKER_M)
    difference = np.array(found) - np.array(moved)
    assert (difference - difference.mean(axis=0)).std() < 3e-3


@pytest.mark.parametrize("gap_s", [20, 300])
def test_ambiguities_survive_a_gap(settled, gap_s):
    """Oracle: the position before the gap, and the count of new ambiguities (satellites that rose meanwhile)."""
    sky, settings, receiver, state = settled
    risen_before = set(state.arcs["satellite"].tolist())
    epoch = receiver.observe(skip=gap_s)
    state, solution = step(state, epoch, sky, settings, receiver.facts)
    risen = set(epoch.satellite.tolist()) - risen_before
    assert solution.extras["new_ambiguities"] == len(risen)
    np.testing.assert_allclose(solution.displacement_enu_m, 0.0, atol=0.15)


def test_a_gap_beyond_the_limit_begins_new_ambiguities(settled):
    """Oracle: the setting max_gap_s."""
    sky, settings, receiver, state = settled
    epoch = receiver.observe(skip=int(settings.max_gap_s) + 5)
    state, solution = step(state, epoch, sky, settings, receiver.facts)
    assert solution.extras["new_ambiguities"] == np.unique(epoch.satellite).size


def test_an_old_or_repeated_epoch_changes_nothing(settled):
    """Oracle: the state itself."""
    sky, settings, receiver, state = settled
    epoch = receiver.observe()
    state, _ = step(state, epoch, sky, settings, receiver.facts)
    again, solution = step(state, epoch, sky, settings, receiver.facts)
    assert again is state
    assert solution.status is Status.REJECTED
    assert "not newer" in solution.reason


@pytest.mark.parametrize("cycles", [(1.0, 0.0), (0.0, -1.0), (1.0, 1.0), (9.0, 7.0)])
def test_a_slip_costs_one_ambiguity_and_no_position(settled, cycles):
    """Oracle: the cycles put in on one satellite, and the truth; (9, 7) leaves geometry-free nearly untouched."""
    sky, settings, receiver, state = settled
    satellite = int(state.arcs["satellite"][np.argmin(np.abs(state.arcs["geometry_free_rate_m_s"]))])
    before = state.x[:3].copy()
    state, solutions = _drive(
        receiver, sky, settings, 6, state, lambda epoch: _change_satellite(epoch, satellite, cycles)
    )
    new = sum(s.extras["new_ambiguities"] for s in solutions)
    assert new == 1 or solutions[0].extras["rejected_observations"] == 1
    np.testing.assert_allclose(state.x[:3], before, atol=0.03)


def test_one_wrong_code_and_one_wrong_phase_are_left_out(settled):
    """Oracle: the errors put in: 30 m on a code, 3 cm on both phases (one epoch)."""
    sky, settings, receiver, state = settled
    before = state.x[:3].copy()
    first, second = state.arcs["satellite"][2], state.arcs["satellite"][5]
    cycles = 0.03 * FREQUENCY_HZ[[3, 9]] / 299_792_458.0

    def spoil(epoch):
        return _change_satellite(_change_satellite(epoch, first, code_m=30.0), second, cycles)

    state, solution = step(state, spoil(receiver.observe()), sky, settings, receiver.facts)
    assert solution.extras["rejected_observations"] >= 1
    np.testing.assert_allclose(state.x[:3], before, atol=0.01)


@pytest.mark.parametrize("phases_too", [False, True])
def test_a_clock_jump_of_a_millisecond_is_bridged(settled, phases_too):
    """Oracle: the position before; no ambiguity begins anew, whether the phases jump too or not."""
    sky, settings, receiver, state = settled
    before = state.x[:3].copy()
    if phases_too:
        for system in receiver.clock_m:
            receiver.clock_m[system] += LIGHT_MILLISECOND_M
    else:
        receiver.code_jump_m = LIGHT_MILLISECOND_M
    state, solutions = _drive(receiver, sky, settings, 3, state)
    assert all(s.extras["new_ambiguities"] == 0 for s in solutions)
    np.testing.assert_allclose(state.x[:3], before, atol=0.02)


def test_without_corrections_for_gps_galileo_carries_on(settled):
    """Oracle: the systems used and the words of the reason."""
    sky, settings, receiver, state = settled
    sky.cause, sky.age_s = {System.GPS: Cause.CORRECTIONS_TOO_OLD}, 74.0
    state, solution = step(state, receiver.observe(), sky, settings, receiver.facts)
    assert solution.status in (Status.PPP_FLOAT, Status.CONVERGING)
    assert solution.systems == "E"
    assert solution.reason == "no corrections for GPS: last 74 s ago, limit 30 s"


def test_without_any_corrections_a_single_point_and_then_no_reconvergence(settled):
    """Oracle: status and reason; after the outage the ambiguities are the ones from before it."""
    sky, settings, receiver, state = settled
    before = state.x[:3].copy()
    sky.cause = {System.GPS: Cause.NO_CORRECTIONS, System.GALILEO: Cause.ISSUE_MISMATCH}
    state, solutions = _drive(receiver, sky, settings, 50, state)
    for solution in solutions:
        assert solution.status is Status.SINGLE_POINT
        assert "no corrections for GPS; corrections for Galileo refer to" in solution.reason
        assert np.linalg.norm(solution.displacement_enu_m) < 10.0
    sky.cause = {}
    state, solution = step(state, receiver.observe(), sky, settings, receiver.facts)
    assert solution.extras["new_ambiguities"] == 0
    np.testing.assert_allclose(state.x[:3], before, atol=0.05)


def test_a_hopeless_geometry_gives_a_single_point(settled):
    """Oracle: four satellites on one side of the sky give no plan position; the codes of all others do."""
    sky, settings, receiver, state = settled
    epoch = receiver.observe()
    east = [int(s) for s in np.unique(epoch.satellite) if sky.satellites[0] <= s and _azimuth(sky, s, epoch) < np.pi]
    sky.only = set(east[:4])
    state = replace(state, arcs=state.arcs[:0], x=state.x[:N_CORE].copy(), p=state.p[:N_CORE, :N_CORE].copy())
    state, solution = step(state, epoch, sky, settings, receiver.facts)
    assert solution.status is Status.SINGLE_POINT
    assert "too few" in solution.reason
    assert np.linalg.norm(solution.displacement_enu_m) < 10.0


def _azimuth(sky, satellite, epoch):
    line = rotation_at(MARKER_M) @ (orbit(int(satellite), epoch.t_gps_ns)[0] - MARKER_M)
    return np.arctan2(line[0], line[1]) % (2 * np.pi)


def test_a_start_without_corrections_says_so():
    """Oracle: status and reason of the first epoch."""
    sky, settings = Sky(cause={System.GPS: Cause.NO_CORRECTIONS, System.GALILEO: Cause.NO_CORRECTIONS}), settings_of()
    receiver = Receiver(sky, settings)
    state, solution = step(initial_state(), receiver.observe(), sky, settings, receiver.facts)
    assert solution.status is Status.SINGLE_POINT
    assert solution.reason == "no corrections for GPS; no corrections for Galileo"
    assert state.t_gps_ns is None


def test_a_restored_state_carries_on_bit_for_bit(settled):
    """Oracle: the undisturbed run; determinism of state and solution through pickle."""
    sky, settings, receiver, state = settled
    restored = pickle.loads(pickle.dumps(state))
    for _ in range(5):
        epoch = receiver.observe()
        state, ours = step(state, epoch, sky, settings, receiver.facts)
        restored, theirs = step(restored, epoch, sky, settings, receiver.facts)
        assert np.array_equal(state.x, restored.x)
        assert np.array_equal(state.p, restored.p)
        assert np.array_equal(ours.position_ecef_m, theirs.position_ecef_m)
    assert len(pickle.dumps(state)) < 100_000


def test_a_static_antenna_that_is_carried_away_is_found_again():
    """Oracle: the new place, 40 m off: a static filter must not hold on to the old one."""
    sky, settings = Sky(), settings_of(motion="static")
    place = np.zeros(3)
    receiver = Receiver(sky, settings, seed=2, interval_s=30.0, noise=0.05, motion_m=lambda t_s: place)
    state, _ = _drive(receiver, sky, settings, 20)
    place += [40.0, 0.0, 0.0]
    state, solutions = _drive(receiver, sky, settings, 30, state)
    np.testing.assert_allclose(solutions[-1].position_ecef_m, MARKER_M + place, atol=0.5)
