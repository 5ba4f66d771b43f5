"""Whatever the order of arrival, the end is the one of the data in order (oracle: the same filter, fed in order)."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.unit.fusion.scenes import T0, S, feed, in_order, shaken, solution, stored

from plumbline.fusion import FusionState
from plumbline.records import InertialBlock, Motion, Solution

N = 25
SOLUTIONS, BLOCKS = shaken(N)
LAST = [solution(T0 + N * S, [0.0, 0.0, 0.0])]
DELAYS = st.lists(st.integers(0, 60), min_size=N, max_size=N)  # tenths of seconds


def outcome(records: list[Solution | InertialBlock]) -> tuple[FusionState, dict[int, Motion]]:
    state, published = feed(records)
    return state, stored(published)


REFERENCE = outcome([*in_order(SOLUTIONS, BLOCKS), *LAST])


def compare(state: FusionState, kept: dict[int, Motion]) -> None:
    np.testing.assert_allclose(state.head.x, REFERENCE[0].head.x, atol=1e-11)
    np.testing.assert_allclose(state.head.p, REFERENCE[0].head.p, atol=1e-13)
    assert [m.t_gps_ns for m in state.measurements] == [m.t_gps_ns for m in REFERENCE[0].measurements]
    assert set(kept) == set(REFERENCE[1])
    for t_ns, motion in kept.items():
        np.testing.assert_allclose(motion.displacement_enu_m, REFERENCE[1][t_ns].displacement_enu_m, atol=1e-10)
        assert motion.status is REFERENCE[1][t_ns].status


@settings(max_examples=60, deadline=None)
@given(DELAYS)
def test_solutions_with_any_delays(delays: list[int]) -> None:
    """The first second is in time: a window begins with what is first."""
    due = [(10 * k + d, 1, k, SOLUTIONS[k]) for k, d in enumerate(delays) if k]
    due += [(10 * k + 11, 0, k, BLOCKS[k]) for k in range(1, N)]
    records = [record for *_, record in sorted(due, key=lambda item: item[:3])]
    compare(*outcome([SOLUTIONS[0], BLOCKS[0], *records, *LAST]))


@settings(max_examples=60, deadline=None)
@given(DELAYS, DELAYS)
def test_samples_and_solutions_with_any_delays(delays: list[int], sample_delays: list[int]) -> None:
    """Samples also overtake each other."""
    due = [(10 * k + d, 1, k, SOLUTIONS[k]) for k, d in enumerate(delays) if k]
    due += [(10 * k + 11 + d, 0, k, BLOCKS[k]) for k, d in enumerate(sample_delays) if k]
    records = [record for *_, record in sorted(due, key=lambda item: item[:3])]
    state, kept = outcome([SOLUTIONS[0], BLOCKS[0], *records, *LAST])
    np.testing.assert_allclose(state.head.x, REFERENCE[0].head.x, atol=1e-11)
    assert {t for t, m in kept.items() if len(m.displacement_enu_m) == 100} == {b.t_first_gps_ns for b in BLOCKS}


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.integers(0, N - 1), st.integers(-(10**9), 10**9)), max_size=60))
def test_any_heap_of_inputs_is_survived(picks: list[tuple[bool, int, int]]) -> None:
    """Repeated, shuffled, shifted inputs: no exception, and every finite block has an increasing revision."""
    records: list[Solution | InertialBlock] = []
    for is_solution, k, shift_ns in picks:
        if is_solution:
            records.append(replace(SOLUTIONS[k], t_gps_ns=SOLUTIONS[k].t_gps_ns + shift_ns))
        else:
            records.append(replace(BLOCKS[k], t_first_gps_ns=BLOCKS[k].t_first_gps_ns + shift_ns))
    state, published = feed(records)
    assert all(s.second < t.second for s, t in zip(state.seconds, state.seconds[1:], strict=False))
    seen: dict[int, int] = {}
    for motion in published:
        assert motion.revision > seen.get(motion.t_first_gps_ns, -1)
        seen[motion.t_first_gps_ns] = motion.revision
