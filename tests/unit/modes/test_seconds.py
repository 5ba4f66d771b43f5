"""Samples to blocks of motion. Oracle: by hand: when a block leaves, with which revision, and what it holds."""

import numpy as np

from plumbline.gps_time import NS_PER_S
from plumbline.modes.seconds import N_COLUMNS, MotionSeconds, Told
from plumbline.records import Floats, Ints, Motion, Status

T0 = 1_384_000_000 * NS_PER_S
STEP = NS_PER_S // 10


def rows(first: int, last: int, value: float) -> tuple[Ints, Floats]:
    """Samples number ``first`` to ``last`` − 1 at 10 Hz."""
    return T0 + STEP * np.arange(first, last), np.full((last - first, N_COLUMNS), value)


def told(sample: int | None) -> Told:
    return Told(None if sample is None else T0 + STEP * sample, Status.RTK_FIXED, "no base")


def due(seconds: MotionSeconds, gnss: int | None) -> list[Motion]:
    return seconds.due("a", STEP, told(gnss), T0)


def test_a_block_leaves_with_its_last_sample_and_again_when_gnss_has_passed_it() -> None:
    seconds = MotionSeconds(5 * NS_PER_S)
    seconds.put(*rows(0, 9, 1.0))
    assert due(seconds, 5) == []
    seconds.put(*rows(9, 10, 1.0))
    (first,) = due(seconds, 5)
    assert (first.t_first_gps_ns, first.revision, len(first.displacement_enu_m)) == (T0, 0, 10)
    seconds.put(*rows(7, 12, 2.0))  # a measurement at sample 7 has changed what follows
    assert due(seconds, 7) == []
    (second,) = due(seconds, 10)
    assert second.revision == 1
    assert second.displacement_enu_m[:, 0].tolist() == [1.0] * 7 + [2.0] * 3
    assert second.attitude_rad is not None
    assert second.attitude_rad[-1].tolist() == [2.0] * 3
    assert due(seconds, 11) == []


def test_what_changed_last_leaves_even_when_gnss_never_comes_back() -> None:
    seconds = MotionSeconds(2 * NS_PER_S)
    seconds.put(*rows(0, 10, 1.0))
    assert len(due(seconds, 5)) == 1
    seconds.put(*rows(6, 20, 3.0))
    assert [m.t_first_gps_ns for m in due(seconds, 6)] == [T0 + NS_PER_S]
    seconds.put(*rows(20, 31, 3.0))
    late = due(seconds, 6)
    assert [(m.t_first_gps_ns, m.revision) for m in late] == [(T0, 1), (T0 + 2 * NS_PER_S, 0)]
    assert late[0].status is Status.RTK_FIXED
    assert late[1].status is Status.COASTING
    assert "no base" in late[1].reason


def test_a_hole_in_the_samples_parts_a_block() -> None:
    seconds = MotionSeconds(5 * NS_PER_S)
    seconds.put(*rows(0, 4, 1.0))
    seconds.put(*rows(6, 10, 1.0))
    parts = due(seconds, 12)
    assert [(m.t_first_gps_ns - T0) // STEP for m in parts] == [0, 6]
    assert [len(m.displacement_enu_m) for m in parts] == [4, 4]
