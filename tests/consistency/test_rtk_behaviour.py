"""Relative positioning in a made-up world: slips, wrong integers, outages, moving antennas, words for what is missing.

Oracle: the simulation's truth.
"""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from plumbline.config import StationSettings
from plumbline.positioning import rtk
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.rtk_state import BaseView, RtkState, no_base
from plumbline.records import Epoch, Solution, Status

from .rtk_world import BASE_ECEF_M, ENU, T_NS, antenna, noisy, settings_of, sine_of, source_of

SECOND = 1_000_000_000
OFFSET_ENU_M = np.array([40.0, -25.0, 6.0])
FACTS = StationFacts("rover")
N = 30


def _session(n: int = N, seed: int = 1, step_ns: int = SECOND) -> list[tuple[Epoch, Epoch]]:
    """(rover, base) epochs with noise."""
    base, rover, rng = antenna(np.zeros(3), 1), antenna(OFFSET_ENU_M, 2), np.random.default_rng(seed)
    pairs = []
    for k in range(n):
        r, b = rover.epoch(T_NS + k * step_ns), base.epoch(T_NS + k * step_ns)
        pairs.append((noisy(r, sine_of(r), rng), noisy(b, sine_of(b), rng)))
    return pairs


@pytest.fixture(scope="module")
def session() -> list[tuple[Epoch, Epoch]]:
    return _session()


SETTINGS = settings_of()
SOURCE = source_of(SETTINGS)


def _run(
    pairs: list[tuple[Epoch, Epoch]], settings: StationSettings = SETTINGS, state: RtkState | None = None
) -> tuple[RtkState, list[Solution], list[rtk.RtkDiagnostics | None]]:
    state, solutions, seen = state or rtk.initial_state(), [], []
    for rover, base in pairs:
        state, solution, one = rtk.step(state, rover, BaseView("b", base, BASE_ECEF_M), SOURCE, settings, FACTS)
        solutions.append(solution)
        seen.append(one)
    return state, solutions, seen


def _error_m(solution: Solution) -> float:
    return float(np.linalg.norm(ENU @ (solution.position_ecef_m - BASE_ECEF_M) - OFFSET_ENU_M))


def _slipped(epoch: Epoch, rows: np.ndarray, cycles: int) -> Epoch:
    return replace(epoch, carrier_phase_cycles=epoch.carrier_phase_cycles + cycles * rows)


def test_fixed_from_the_first_epoch_and_within_millimetres(session: list[tuple[Epoch, Epoch]]) -> None:
    _, solutions, _ = _run(session)
    assert all(s.status is Status.RTK_FIXED for s in solutions)
    assert max(map(_error_m, solutions)) < 0.025
    assert solutions[0].displacement_enu_m is not None


@pytest.mark.parametrize("cycles", [1, -2, 250])
@pytest.mark.parametrize("both", [False, True])
def test_a_slip_is_seen_and_leaves_no_mark(session: list[tuple[Epoch, Epoch]], cycles: int, both: bool) -> None:
    """Without any flag, on one frequency or the same on both: left out at once, resolved anew an epoch later."""
    satellite = int(session[0][0].satellite[len(session[0][0].satellite) // 2])
    rows = session[0][0].satellite == satellite
    if not both:
        rows &= session[0][0].signal == session[0][0].signal[rows][0]
    pairs = [(_slipped(r, rows, cycles) if k >= 12 else r, b) for k, (r, b) in enumerate(session)]
    _, solutions, seen = _run(pairs)
    assert all(s.status is Status.RTK_FIXED for s in solutions)
    assert max(map(_error_m, solutions)) < 0.025
    left_out = seen[12].use_phase[seen[12].rows["satellite"] == satellite]
    assert np.count_nonzero(~left_out) == (2 if both else 1)
    assert seen[13].slips == (2 if both else 1)
    assert sum(one.slips for one in seen if one is not None) == (2 if both else 1)


def test_a_flagged_slip_and_a_lock_time_that_starts_again_begin_anew(session: list[tuple[Epoch, Epoch]]) -> None:
    rows = session[0][0].satellite == session[0][0].satellite[0]
    flagged = [(replace(r, loss_of_lock=rows) if k == 12 else r, b) for k, (r, b) in enumerate(session)]
    locks = [(replace(r, lock_time_s=np.where(rows & (k >= 12), k - 12.0, 100.0 + k)), b) for k, (r, b) in
             enumerate(session)]  # fmt: skip
    for pairs in (flagged, locks):
        _, solutions, seen = _run(pairs)
        one = seen[12]
        assert one is not None
        young = one.arcs["satellite"][one.arcs["count"] == 1]
        assert set(young.tolist()) == {int(session[0][0].satellite[0])}
        assert all(s.status is Status.RTK_FIXED for s in solutions)


@pytest.mark.parametrize("count", [1, 3, 12])
def test_wrong_integers_held_are_let_go(session: list[tuple[Epoch, Epoch]], count: int) -> None:
    """Held integers are changed behind the filter's back: within seconds it holds the true ones again."""
    state, _, _ = _run(session[:12])
    arcs = state.arcs.copy()
    held = np.flatnonzero(arcs["held"])[1 : 1 + count]
    arcs["value"][held] += np.where(np.arange(held.size) % 2 == 0, 1, -1)
    _, solutions, _ = _run(session[12:], state=replace(state, arcs=arcs))
    assert solutions[-1].status is Status.RTK_FIXED
    assert _error_m(solutions[-1]) < 0.025
    wrong = [s for s in solutions if s.status is Status.RTK_FIXED and _error_m(s) > 0.05]
    assert len(wrong) <= 3


def test_a_base_that_stops_is_bridged_and_then_named(session: list[tuple[Epoch, Epoch]]) -> None:
    pairs = [(r, b if k < 10 else session[9][1]) for k, (r, b) in enumerate(session)]
    _, solutions, _ = _run(pairs)
    assert all(s.status is Status.RTK_FIXED for s in solutions[:20])
    assert max(_error_m(s) for s in solutions[:20]) < 0.06
    assert solutions[20].status is Status.NO_BASE
    assert solutions[20].reason == "last data of base b 11 s ago, limit 10 s"
    assert solutions[20].position_ecef_m is None
    assert solutions[15].correction_age_s == 6.0


def test_integers_survive_an_outage_of_the_base(session: list[tuple[Epoch, Epoch]]) -> None:
    state, _, _ = _run(session[:10])
    old = state.arcs["value"][state.arcs["held"]]
    state, solution, _ = rtk.step(state, session[15][0], no_base("b", "gone"), SOURCE, SETTINGS, FACTS)
    assert (solution.status, solution.reason) == (Status.NO_BASE, "gone")
    state, solutions, _ = _run(session[25:], state=state)
    assert solutions[0].status is Status.RTK_FIXED
    np.testing.assert_array_equal(state.arcs["value"][state.arcs["held"]], old)


def test_same_input_same_output_and_the_state_survives_pickling(session: list[tuple[Epoch, Epoch]]) -> None:
    _, whole, _ = _run(session)
    state, first, _ = _run(session[:13])
    _, second, _ = _run(session[13:], state=pickle.loads(pickle.dumps(state)))
    for a, b in zip(whole, first + second, strict=True):
        assert a.position_ecef_m is not None
        np.testing.assert_array_equal(a.position_ecef_m, b.position_ecef_m)
        np.testing.assert_array_equal(a.covariance_enu_m2, b.covariance_enu_m2)


def test_a_moving_rover_at_ten_hertz_has_its_velocity() -> None:
    velocity_enu = np.array([12.0, 5.0, 0.5])
    settings = settings_of(integers="instantaneous", doppler_sigma_m_s=0.03)
    base = antenna(np.zeros(3), 1)
    state, errors = rtk.initial_state(), []
    for k in range(8):
        t = T_NS + k * SECOND // 10
        here = OFFSET_ENU_M + velocity_enu * 0.1 * k
        there = antenna(here, 2).epoch(t)
        speed = ENU.T @ velocity_enu
        line = SOURCE.broadcast(t, t, there.satellite, there.pseudorange_m).position_ecef_m - BASE_ECEF_M
        line /= np.linalg.norm(line, axis=1)[:, None]
        wavelength = 299_792_458.0 / np.array([1575.42e6])
        change = (line @ speed) / wavelength
        rover = replace(there, doppler_hz=there.doppler_hz + change * _ratio(there))
        view = BaseView("b", base.epoch(t), BASE_ECEF_M)
        state, solution, _ = rtk.step(state, rover, view, SOURCE, settings, FACTS)
        assert solution.status is Status.RTK_FIXED
        errors.append(np.linalg.norm(ENU @ (solution.position_ecef_m - BASE_ECEF_M) - here))
        assert solution.velocity_enu_m_s is not None
        np.testing.assert_allclose(solution.velocity_enu_m_s, velocity_enu, atol=0.02)
    assert max(errors) < 0.002


def _ratio(epoch: Epoch) -> np.ndarray:
    from plumbline.signals import FREQUENCY_HZ

    return FREQUENCY_HZ[epoch.signal] / 1575.42e6


def test_a_moving_base_gives_the_baseline() -> None:
    """Base's own position unknown, found anew at every epoch: the baseline is right to millimetres all the same."""
    settings = settings_of(moving_base=True)
    state, rng = rtk.initial_state(), np.random.default_rng(3)
    for k in range(6):
        t, away = T_NS + k * SECOND, np.array([3.0 * k, -2.0 * k, 0.1 * k])
        b, r = antenna(away, 1).epoch(t), antenna(away + np.array([1.0, 0.5, 0.2]), 2).epoch(t)
        view = BaseView("b", noisy(b, sine_of(b), rng), None)
        state, solution, _ = rtk.step(state, noisy(r, sine_of(r), rng), view, SOURCE, settings, FACTS)
        assert solution.status is Status.RTK_FIXED, solution.reason
        baseline = [solution.extras[f"baseline_{c}_m"] for c in "enu"]
        np.testing.assert_allclose(baseline, [1.0, 0.5, 0.2], atol=0.025)


def test_a_base_that_never_says_where_it_is_gets_a_position(session: list[tuple[Epoch, Epoch]]) -> None:
    state, solutions = rtk.initial_state(), []
    for rover, base in session[:10]:
        state, solution, _ = rtk.step(state, rover, BaseView("b", base, None), SOURCE, SETTINGS, FACTS)
        solutions.append(solution)
    assert [s.status for s in solutions[:5]] == [Status.NO_BASE] * 5
    assert "1005/1006" in solutions[0].reason
    assert [s.status for s in solutions[5:]] == [Status.RTK_FIXED] * 5


def test_too_few_common_satellites_and_repeated_epochs_are_said(session: list[tuple[Epoch, Epoch]]) -> None:
    rover, base = session[0]
    few = np.isin(rover.satellite, np.unique(rover.satellite)[:3])
    part = replace(
        rover, **{name: getattr(rover, name)[few] for name in (
            "satellite", "signal", "pseudorange_m", "carrier_phase_cycles", "doppler_hz", "cn0_db_hz", "lock_time_s",
            "half_cycle_ambiguous", "glonass_channel")},
    )  # fmt: skip
    state, solution, _ = rtk.step(
        rtk.initial_state(), part, BaseView("b", base, BASE_ECEF_M), SOURCE, SETTINGS, FACTS
    )  # fmt: skip
    assert solution.status is Status.TOO_FEW_SATELLITES
    assert solution.reason == "rover and base b have 3 satellites in common, 4 needed"
    _, again, _ = rtk.step(state, rover, BaseView("b", base, BASE_ECEF_M), SOURCE, SETTINGS, FACTS)
    assert again.status is Status.REJECTED
