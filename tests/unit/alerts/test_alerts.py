"""The life of an alert: oracle is the rule book of ISA-18.2 (delays, dead band), worked by hand on short series."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from plumbline.alerts import QUANTITIES, AlertsState, evaluate
from plumbline.records import AlertEvent, AlertState, Motion, Solution, StationStatus, Status, Threshold

S = 10**9
T0 = 1_300_000_000 * S
LEVEL = Threshold("limit", "A", "displacement_horizontal", 0.05)


def motion(second: int, east: float | list[float], status: Status = Status.PPP_FLOAT, sigma: float = 0.005) -> Motion:
    values = np.zeros((10, 3))
    values[:, 0] = east
    sigmas = np.full((10, 3), sigma)
    t = T0 + second * S
    return Motion("A", t, t + S, S // 10, values, values * 0, values * 0, sigmas, status)


def run(
    records: list[Motion | Solution | StationStatus], *thresholds: Threshold, state: AlertsState | None = None
) -> tuple[AlertsState, list[AlertEvent]]:
    state, events = state or AlertsState(), []
    for record in records:
        state, happened = evaluate(state, thresholds, record)
        events += happened
    return state, events


def kinds(events: list[AlertEvent]) -> list[tuple[AlertState, float]]:
    return [(e.state, (e.t_gps_ns - T0) / S) for e in events]


def test_raises_at_the_sample_that_crosses_and_clears() -> None:
    rising = [0.0] * 4 + [0.06] * 6
    _, events = run([motion(0, 0.0), motion(1, rising), motion(2, 0.07), motion(3, 0.01)], LEVEL)
    assert kinds(events) == [(AlertState.ACTIVE, 1.4), (AlertState.CLEARED, 3.0)]
    assert events[0].alert_id == events[1].alert_id == f"A:limit:{T0 + 1_400_000_000}"
    assert events[0].value == pytest.approx(0.06)


def test_on_delay_forgives_a_short_excursion() -> None:
    slow = replace(LEVEL, on_delay_s=2.0)
    _, events = run([motion(0, 0.06), motion(1, 0.0), motion(2, 0.06), motion(3, 0.06), motion(4, 0.06)], slow)
    assert kinds(events) == [(AlertState.ACTIVE, 4.0)]
    assert events[0].t_onset_gps_ns == T0 + 2 * S


def test_off_delay_and_dead_band_keep_an_alert_from_flapping() -> None:
    calm = replace(LEVEL, off_delay_s=2.0, dead_band=0.02)
    east = [0.06, 0.04, 0.06, 0.02, 0.06, 0.02, 0.02, 0.02]
    _, events = run([motion(k, e) for k, e in enumerate(east)], calm)
    assert kinds(events) == [(AlertState.ACTIVE, 0.0), (AlertState.CLEARED, 7.0)]


def test_a_sway_is_judged_by_its_peaks() -> None:
    t = np.arange(10) / 10
    sway = [motion(k, list(0.08 * np.sin(2 * np.pi * (t + k) * 1.0))) for k in range(5)]
    _, events = run(sway, replace(LEVEL, on_delay_s=3.0))
    assert [e.state for e in events] == [AlertState.ACTIVE]


@pytest.mark.parametrize("status", [Status.CONVERGING, Status.COASTING, Status.REJECTED, Status.NO_OBSERVATIONS])
def test_a_displacement_that_cannot_be_trusted_raises_and_clears_nothing(status: Status) -> None:
    state, events = run([motion(k, 5.0, status) for k in range(5)], LEVEL)
    assert events == []
    state, events = run([motion(5, 0.06), motion(6, 0.0, status)], LEVEL, state=state)
    assert [e.state for e in events] == [AlertState.ACTIVE]


def test_an_acceleration_is_the_sensors_own() -> None:
    shaking = replace(motion(0, 0.0, Status.NO_OBSERVATIONS), acceleration_enu_m_s2=np.full((10, 3), 0.5))
    _, events = run([shaking], Threshold("shake", "A", "acceleration_up", 0.3))
    assert [e.state for e in events] == [AlertState.ACTIVE]


def test_noise_beyond_the_level_is_no_alert() -> None:
    """A level of 5 cm where one sigma is 3 cm: 6 cm mean nothing, 13 cm do (three sigma of both components: 12.7
    cm).
    """
    _, events = run([motion(0, 0.06, sigma=0.03), motion(1, 0.13, sigma=0.03)], LEVEL)
    assert kinds(events) == [(AlertState.ACTIVE, 1.0)]


def test_a_revision_raises_nothing_twice_but_decides_what_was_open() -> None:
    state, events = run([motion(0, 0.06), replace(motion(0, 0.06), revision=1)], LEVEL)
    assert len(events) == 1
    state, events = run([motion(1, 0.0), replace(motion(1, 0.09), revision=1)], LEVEL, state=state)
    assert [e.state for e in events] == [AlertState.CLEARED]
    late = [motion(2, 0.0, Status.COASTING), motion(3, 0.0, Status.COASTING), replace(motion(2, 0.08), revision=1)]
    _, events = run(late, LEVEL, state=state)
    assert kinds(events) == [(AlertState.ACTIVE, 2.0)]


def test_the_same_records_give_the_same_events_also_from_a_checkpoint() -> None:
    rng = np.random.default_rng(0)
    records: list[Motion | Solution | StationStatus] = [motion(k, abs(rng.normal(0, 0.04))) for k in range(60)]
    thresholds = (LEVEL, replace(LEVEL, threshold_id="slow", on_delay_s=1.5, off_delay_s=3.0))
    _, whole = run(records, *thresholds)
    half, first = run(records[:25], *thresholds)
    _, second = run(records[25:], *thresholds, state=pickle.loads(pickle.dumps(half)))
    assert first + second == whole
    assert len({(e.alert_id, e.state) for e in whole}) == len(whole) > 4


def test_rate_of_displacement_is_a_slope() -> None:
    creeping = [motion(k, 1e-4 * k) for k in range(70)]
    _, events = run(creeping, Threshold("creep", "A", "displacement_rate_east", 0.9e-4))
    assert kinds(events) == [(AlertState.ACTIVE, 30.0)]
    _, events = run(creeping, Threshold("creep", "A", "displacement_rate_east", 1.1e-4))
    assert events == []


def status(second: float, last_epoch: float | None) -> StationStatus:
    last = None if last_epoch is None else T0 + round(last_epoch * S)
    return StationStatus("A", T0 + round(second * S), "receiving", "", last, None, 0, {})


def test_silence_and_age_of_solution() -> None:
    gap = Threshold("gap", "A", "data_gap", 10.0)
    _, events = run([status(k, min(k, 5)) for k in range(20)] + [status(20, 20)], gap)
    assert kinds(events) == [(AlertState.ACTIVE, 15.0), (AlertState.CLEARED, 20.0)]
    assert events[0].t_onset_gps_ns == T0 + 15 * S
    never = [status(k, None) for k in range(15)]
    assert kinds(run(never, gap)[1]) == [(AlertState.ACTIVE, 10.0)]

    age = Threshold("age", "A", "solution_age", 5.0)
    good = Solution("A", T0 + 2 * S, T0 + 2 * S, Status.PPP_FLOAT, "")
    bad = Solution("A", T0 + 6 * S, T0 + 6 * S, Status.NO_CORRECTIONS, "no corrections")
    _, events = run([good, bad, status(6, 6), status(8, 8)], age)
    assert kinds(events) == [(AlertState.ACTIVE, 7.0)]


def test_others_disabled_and_unknown_thresholds_are_passed_over() -> None:
    thresholds = (
        replace(LEVEL, station="B"),
        replace(LEVEL, threshold_id="off", enabled=False),
        replace(LEVEL, threshold_id="odd", quantity="colour"),
    )
    state, events = run([motion(0, 1.0)], *thresholds)
    assert events == []
    assert not state.thresholds


def test_every_listed_quantity_can_be_judged() -> None:
    thresholds = tuple(Threshold(f"q{k}", "A", q, 1e-6) for k, q in enumerate(QUANTITIES))
    ones = np.ones((10, 3))
    moved = [
        replace(motion(k, 0.0), displacement_enu_m=ones * (k + 1), velocity_enu_m_s=ones, acceleration_enu_m_s2=ones)
        for k in range(40)
    ]
    records: list[Motion | Solution | StationStatus] = [*moved, status(41, 40), status(43, 40)]
    _, events = run(records, *thresholds)
    assert {e.quantity for e in events} == set(QUANTITIES)


def test_the_replay_of_an_old_recording_is_not_silent() -> None:
    """Epochs of eight years ago, one a second of receive time: no gap; then they stop."""
    old = 8 * 365 * 86_400
    records = [status(k, min(k, 20) - old) for k in range(40)]
    _, events = run(records, Threshold("gap", "A", "data_gap", 10.0))
    assert kinds(events) == [(AlertState.ACTIVE, 30.0)]


def accelerating(second: int, east: float) -> Motion:
    block = motion(second, 0.0, Status.NO_OBSERVATIONS)
    values = np.zeros((10, 3))
    values[:, 0] = east
    return replace(block, acceleration_enu_m_s2=values)


def test_an_acceleration_that_is_not_known_yet_is_not_judged() -> None:
    """An alert stays as it is over blocks without acceleration; GNSS is not needed to raise one or to clear it."""
    limit = Threshold("shaken", "A", "acceleration_horizontal", 0.06)
    unknown = float("nan")
    _, events = run([accelerating(k, a) for k, a in enumerate([unknown, unknown, 0.1, unknown, 0.1, 0.0])], limit)
    assert kinds(events) == [(AlertState.ACTIVE, 2.0), (AlertState.CLEARED, 5.0)]
