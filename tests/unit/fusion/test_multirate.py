"""The live rules: lateness, revisions, gaps, refusals; oracle: the same data in order, and closed forms."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from tests.unit.fusion.scenes import SETTINGS, T0, S, block, feed, in_order, shaken, solution, stored

from plumbline.alerts import AlertsState, evaluate
from plumbline.fusion import initial_state, receive_inertial, receive_solution
from plumbline.records import InertialBlock, Solution, Status, Threshold


def delayed(solutions: list[Solution], blocks: list[InertialBlock], by: int) -> list[Solution | InertialBlock]:
    """Each solution ``by`` blocks after the block of its second."""
    records: list[Solution | InertialBlock] = []
    for k, samples in enumerate(blocks):
        records += [samples, solutions[k - by]] if k >= by else [samples]
    return [*records, *solutions[len(blocks) - by :]]


def test_a_late_solution_is_applied_at_its_own_time() -> None:
    solutions, blocks = shaken()
    reference, _ = feed(in_order(solutions, blocks))
    state, _ = feed(delayed(solutions, blocks, 4))
    np.testing.assert_allclose(state.head.x, reference.head.x, atol=1e-12)
    np.testing.assert_allclose(state.head.p, reference.head.p, atol=1e-14)


def test_what_is_stored_does_not_depend_on_lateness() -> None:
    solutions, blocks = shaken()
    _, prompt = feed(in_order(solutions, blocks))
    _, published = feed(delayed(solutions, blocks, 3))
    expected, kept = stored(prompt), stored(published)
    assert sorted(kept) == sorted(expected)
    for t_ns, motion in kept.items():
        np.testing.assert_allclose(motion.displacement_enu_m, expected[t_ns].displacement_enu_m, atol=1e-12)
        np.testing.assert_allclose(motion.sigma_displacement_enu_m, expected[t_ns].sigma_displacement_enu_m, atol=1e-12)
    counts = [sum(m.t_first_gps_ns == t_ns for m in published) for t_ns in sorted(kept)]
    assert max(counts) == 2  # prompt, and with its own solution


def test_solutions_out_of_order_give_the_ordered_result() -> None:
    solutions, blocks = shaken()
    reference, _ = feed(in_order(solutions, blocks))
    mixed = [*in_order(solutions[:10], blocks[:10]), *blocks[10:15], *reversed(solutions[10:15])]
    state, _ = feed([*mixed, *in_order(solutions[15:], blocks[15:])])
    np.testing.assert_allclose(state.head.x, reference.head.x, atol=1e-12)


def test_blocks_leave_with_the_accelerometer_and_once_more_with_their_solution() -> None:
    solutions, blocks = shaken(10)
    state, _ = feed(in_order(solutions[:6], blocks[:6]))
    state, first = feed([blocks[6]], state=state)
    assert [(m.t_first_gps_ns, m.revision) for m in first] == [(T0 + 6 * S, 0)]
    _, second = feed([solutions[6]], state=state)
    assert [(m.t_first_gps_ns, m.revision) for m in second] == [(T0 + 6 * S, 1)]


def test_a_solution_that_never_comes_leaves_no_block_behind() -> None:
    """The block of a lost solution is revised with the next one."""
    solutions, blocks = shaken(12)
    state, _ = feed(in_order(solutions[:6], blocks[:6]))
    state, _ = feed(blocks[6:9], state=state)
    state, revised = feed([solutions[6]], state=state)
    assert [m.t_first_gps_ns for m in revised] == [T0 + 6 * S]
    _, revised = feed([solutions[8]], state=state)  # 7 is lost
    assert [m.t_first_gps_ns for m in revised] == [T0 + 7 * S, T0 + 8 * S]


def test_samples_in_small_or_straddling_parcels_change_nothing() -> None:
    solutions, blocks = shaken(12)
    reference, _ = feed(in_order(solutions, blocks))
    force = np.concatenate([b.specific_force_m_s2 for b in blocks])
    records: list[object] = []
    sent = 0
    for start in range(0, len(force), 37):
        t_ns = T0 + start * 10_000_000
        while sent < 12 and solutions[sent].t_gps_ns <= t_ns + 36 * 10_000_000:
            records.append(solutions[sent])
            sent += 1
        records.append(replace(blocks[0], t_first_gps_ns=t_ns, specific_force_m_s2=force[start : start + 37]))
    state, published = feed(records)  # type: ignore[arg-type]
    np.testing.assert_allclose(state.head.x, reference.head.x, atol=1e-9)  # baseline means of partial seconds
    assert len(stored(published)) == 12


def test_mounting_bias_does_not_move_the_displacement() -> None:
    rng = np.random.default_rng(1)
    bias = np.array([0.2, -0.15, 0.1])
    records = []
    for k in range(30):
        records.append(solution(T0 + k * S, rng.normal(0, 0.004, 3)))
        records.append(block(T0 + k * S, np.tile(bias, (100, 1)) + rng.normal(0, 5e-3, (100, 3))))
    state, published = feed(records)
    kept = stored(published)
    displacement = np.concatenate([kept[t].displacement_enu_m for t in sorted(kept)])
    assert np.abs(displacement).max() < 0.02
    np.testing.assert_allclose(state.head.x[6:9], bias, atol=2e-3)


@pytest.mark.parametrize("first", ["solution", "samples"])
def test_baseline_is_found_whichever_comes_first(first: str) -> None:
    solutions, blocks = shaken(40)
    start = solutions[:5] if first == "solution" else blocks[:5]
    state, published = feed([*start, *in_order(solutions[5:], blocks[5:])])
    np.testing.assert_allclose(state.head.x[6:9], [0.12, -0.2, 0.05], atol=5e-3)
    last = stored(published)[T0 + 39 * S]
    assert last.status is Status.PPP_FLOAT


def test_before_the_first_solution_there_is_acceleration_and_no_displacement() -> None:
    _, blocks = shaken(14)
    _, published = feed(blocks)
    assert [m.status for m in published] == [Status.NO_OBSERVATIONS] * 14
    assert np.isnan(published[-1].displacement_enu_m).all()
    assert np.isfinite(published[-1].acceleration_enu_m_s2).all()


@pytest.mark.parametrize("with_solutions", [False, True])
def test_no_acceleration_is_told_before_the_bias_can_be_known(with_solutions: bool) -> None:
    """Oracle: the motion fed in: a sway of 0.1 Hz whose first seconds look like a bias, on a sensor with a bias."""
    amplitude, omega = 0.1, 2 * np.pi * 0.1
    t = np.arange(40 * 100) / 100
    truth = np.outer(amplitude * np.cos(omega * t), [1.0, 0.0, 0.0])
    bias = np.array([0.12, -0.2, 0.05])
    blocks = [block(T0 + k * S, truth[k * 100 : k * 100 + 100] + bias) for k in range(40)]
    displacement = -truth[::100] / omega**2
    solutions = [solution(T0 + k * S, displacement[k]) for k in range(40)]
    _, published = feed(in_order(solutions, blocks) if with_solutions else blocks)
    kept = stored(published)
    told = np.array([np.isfinite(kept[T0 + k * S].acceleration_enu_m_s2).all() for k in range(40)])
    assert list(told) == [False] * 10 + [True] * 30
    assert all(kept[T0 + k * S].reason for k in range(10))
    assert "bias" in kept[T0].reason or not with_solutions
    assert kept[T0 + 39 * S].reason == "" or not with_solutions
    error = [kept[T0 + k * S].acceleration_enu_m_s2 - truth[k * 100 : k * 100 + 100] for k in range(10, 40)]
    assert np.abs(np.vstack(error)).max() < 0.3 * amplitude


def test_a_station_that_starts_in_the_middle_of_a_sway_raises_no_false_alarm() -> None:
    """Oracle: the sway fed in: 0.09 m/s² at most, under a level of 0.12; with the first second's mean it is 0.135."""
    t = np.arange(30 * 100) / 100
    omega = 2 * np.pi * 0.3
    sway = np.outer(0.09 * np.cos(omega * t), [0.0, 1.0, 0.0])
    blocks = [block(T0 + k * S, np.add(sway[k * 100 : k * 100 + 100], [0.12, -0.2, 0.05])) for k in range(30)]
    solutions = [solution(T0 + k * S, -sway[k * 100] / omega**2, 0.05) for k in range(30)]
    _, published = feed(in_order(solutions, blocks))
    high = Threshold("high", "A", "acceleration_horizontal", 0.12)
    alerts, raised = AlertsState(), []
    for motion in published:
        alerts, events = evaluate(alerts, [high, replace(high, threshold_id="low", level=0.06)], motion)
        raised += events
    assert [event.threshold_id for event in raised] == ["low"]
    assert raised[0].t_gps_ns < T0 + 15 * S


def test_samples_that_come_back_need_no_new_bias() -> None:
    solutions, blocks = shaken(40)
    pairs = list(zip(solutions, blocks, strict=True))
    records = [r for k, pair in enumerate(pairs) for r in pair[: 1 if 15 <= k < 25 else 2]]
    _, published = feed(records)
    assert np.isfinite(stored(published)[T0 + 26 * S].acceleration_enu_m_s2).all()


def test_without_gnss_sigma_grows_and_the_status_says_so() -> None:
    solutions, blocks = shaken(40)
    _, published = feed([*in_order(solutions[:20], blocks[:20]), *blocks[20:40]])
    sigma = [m.sigma_displacement_enu_m[-1, 0] for m in published[20:]]
    assert all(np.diff(sigma) > 0)
    assert published[25].status is Status.PPP_FLOAT
    assert published[-1].status is Status.COASTING
    assert "for 21 s" in published[-1].reason or "for 20 s" in published[-1].reason


def test_a_displacement_coasted_to_nothing_is_given_up_and_found_again() -> None:
    solutions, blocks = shaken(200)
    records = [*in_order(solutions[:20], blocks[:20]), *blocks[20:190], *in_order(solutions[190:], blocks[190:])]
    _, published = feed(records)
    kept = stored(published)
    assert kept[T0 + 180 * S].status is Status.NO_OBSERVATIONS
    assert np.isnan(kept[T0 + 180 * S].displacement_enu_m).all()
    assert np.abs(kept[T0 + 199 * S].displacement_enu_m).max() < 0.08


def test_missing_samples_fall_back_to_gnss() -> None:
    solutions, blocks = shaken(30)
    records = [
        r for k, pair in enumerate(zip(solutions, blocks, strict=True)) for r in pair[: 1 if 10 <= k < 20 else 2]
    ]
    state, published = feed(records)
    kept = stored(published)
    for k in range(10, 20):
        motion = kept[T0 + k * S]
        assert len(motion.displacement_enu_m) == 1
        assert np.isnan(motion.acceleration_enu_m_s2).all()
        np.testing.assert_allclose(motion.displacement_enu_m[0], solutions[k].displacement_enu_m, atol=0.01)
    assert len(kept[T0 + 25 * S].displacement_enu_m) == 100
    np.testing.assert_allclose(state.head.x[6:9], [0.12, -0.2, 0.05], atol=0.02)


def test_a_hole_within_a_second_is_coasted_through() -> None:
    solutions, blocks = shaken(20)
    holed = blocks[15].specific_force_m_s2.copy()
    holed[20:60] = np.nan
    blocks[15] = replace(blocks[15], specific_force_m_s2=holed)
    _, published = feed(in_order(solutions, blocks))
    motion = stored(published)[T0 + 15 * S]
    assert np.isfinite(motion.displacement_enu_m).all()
    assert np.isnan(motion.acceleration_enu_m_s2).any(axis=1).sum() == 40


def test_gnss_alone_is_followed_at_its_own_rate() -> None:
    solutions, _ = shaken(10)
    _, published = feed(solutions)
    assert [m.t_first_gps_ns for m in published] == [s.t_gps_ns for s in solutions]
    assert all(m.displacement_enu_m.shape == (1, 3) for m in published)


def test_late_samples_replace_the_block_of_gnss_alone() -> None:
    solutions, blocks = shaken(12)
    reference, _ = feed(in_order(solutions, blocks))
    swapped = [*in_order(solutions[:5], blocks[:5]), solutions[5], solutions[6], blocks[6], blocks[5]]
    state, published = feed([*swapped, *in_order(solutions[7:], blocks[7:])])
    assert len(stored(published)[T0 + 5 * S].displacement_enu_m) == 100
    np.testing.assert_allclose(state.head.x, reference.head.x, atol=1e-12)


def test_an_outlier_is_refused_and_a_lasting_jump_believed() -> None:
    solutions, blocks = shaken(30)
    for k in (12, *range(20, 30)):
        solutions[k] = replace(solutions[k], displacement_enu_m=np.add(solutions[k].displacement_enu_m, [0.5, 0, 0]))
    _, published = feed(in_order(solutions, blocks))
    kept = stored(published)
    assert kept[T0 + 12 * S].status is Status.REJECTED
    assert "prediction" in kept[T0 + 12 * S].reason
    assert np.abs(kept[T0 + 12 * S].displacement_enu_m).max() < 0.1
    assert kept[T0 + 13 * S].status is Status.PPP_FLOAT
    assert kept[T0 + 21 * S].status is Status.REJECTED
    np.testing.assert_allclose(kept[T0 + 29 * S].displacement_enu_m[0, 0], 0.5, atol=0.1)


def test_inputs_that_cannot_be_used_are_counted() -> None:
    solutions, blocks = shaken(6)
    state, _ = feed(in_order(solutions, blocks))
    bad = [
        replace(solutions[5], status=Status.NO_CORRECTIONS, reason="no corrections for Galileo"),
        replace(solutions[5], status=Status.SINGLE_POINT),
        replace(solutions[5], covariance_enu_m2=np.diag([1.0, -1.0, 1.0])),
        replace(solutions[5], displacement_enu_m=None),
        solutions[5],
        replace(solutions[5], t_gps_ns=T0 - 3600 * S),
    ]
    after, published = feed([*bad, blocks[5], replace(blocks[5], interval_ns=0)], state=state)
    assert published == []
    np.testing.assert_array_equal(after.head.x, state.head.x)
    assert after.counters == {
        "solution_no_corrections": 1,
        "solution_single_point": 1,
        "solution_covariance_not_positive": 1,
        "solution_without_displacement": 1,
        "solution_repeated": 1,
        "solution_too_late": 1,
        "inertial_late_or_repeated": 100,
        "inertial_interval_not_usable": 1,
    }


def test_state_survives_pickling_and_runs_are_repeatable() -> None:
    solutions, blocks = shaken(20)
    records = in_order(solutions, blocks)
    state, published = feed(records)
    half, first = feed(records[:21])
    resumed, second = feed(records[21:], state=pickle.loads(pickle.dumps(half)))
    np.testing.assert_array_equal(resumed.head.x, state.head.x)
    for ours, theirs in zip([*first, *second], published, strict=True):
        np.testing.assert_array_equal(ours.displacement_enu_m, theirs.displacement_enu_m)
    assert len(pickle.dumps(state)) < 250_000


def test_the_window_bounds_the_state() -> None:
    solutions, blocks = shaken(60)
    state, _ = feed(in_order(solutions, blocks))
    assert len(state.seconds) == 31
    assert len(state.measurements) <= 32


def test_solution_between_samples_uses_its_own_instant() -> None:
    """Uniform motion at 1 m/s measured 4 ms after a sample: no innovation (closed form)."""
    state = initial_state("A")
    found = []
    for k in range(10):
        t_ns = T0 + k * S
        late_ns = 4_000_000
        state, _, _ = receive_solution(state, solution(t_ns + late_ns, [k + 0.004, 0.0, 0.0]), SETTINGS)
        state, _, innovations = receive_inertial(state, block(t_ns, np.zeros((100, 3))), SETTINGS)
        found += innovations
    assert abs(found[-1].innovation_enu_m[0]) < 2e-3
    assert abs(state.head.x[3] - 1.0) < 2e-3


def test_samples_are_turned_to_enu_and_gravity_is_taken_off() -> None:
    turned = SETTINGS.model_copy(
        update={"rotation_enu_from_sensor": ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))}
    )
    state = initial_state("A")
    force = np.tile([state.gravity_m_s2, 0.3, 0.4], (100, 1))
    sensor = replace(block(T0, np.zeros((100, 3))), specific_force_m_s2=force)
    state, _, _ = receive_inertial(state, sensor, turned)
    np.testing.assert_allclose(state.head.x[6:9], [0.3, 0.4, 0.0], atol=1e-12)


def test_a_stamp_from_the_near_future_stops_the_filter_only_for_a_while() -> None:
    solutions, blocks = shaken(60)
    state, _ = feed(in_order(solutions[:20], blocks[:20]))
    state, _ = feed([replace(blocks[20], t_first_gps_ns=T0 + 300 * S)], state=state)
    state, published = feed(in_order(solutions[20:], blocks[20:]), state=state)
    assert state.counters["restarted_after_a_wrong_time_stamp"] == 1
    last = stored([m for m in published if m.t_first_gps_ns >= T0 + 30 * S])[T0 + 59 * S]
    assert last.status is Status.PPP_FLOAT
    assert np.abs(last.displacement_enu_m).max() < 0.08


def test_a_reconverging_position_is_used_with_its_own_uncertainty() -> None:
    """Half a metre off with a sigma of half a metre: the motion stays, its sigma and its status say converging."""
    solutions, blocks = shaken(30)
    for k in range(15, 30):
        off = np.add(solutions[k].displacement_enu_m, [0.5, 0.0, 0.0])
        weak = np.diag([0.25, 0.25, 0.25])
        changed = replace(solutions[k], displacement_enu_m=off, covariance_enu_m2=weak, status=Status.CONVERGING)
        solutions[k] = changed
    _, published = feed(in_order(solutions, blocks))
    last = stored(published)[T0 + 20 * S]
    assert last.status is Status.CONVERGING
    assert last.sigma_displacement_enu_m.min() > 0.5
    assert np.abs(last.displacement_enu_m).max() < 0.1
