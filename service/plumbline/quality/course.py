"""One antenna's displacement against what it was in the last minutes.

The *baseline* is the exponentially forgetting mean of the last two minutes, the *departure* what an epoch shows beyond
it. An epoch becomes part of the baseline only ``_LAG_NS`` later, so that a sudden displacement has been judged before
it shifts what it is judged by; while somebody doubts the displacement, the baseline is frozen. The filter is linear on
purpose: two antennas that move alike have departures alike at every instant, however their baselines follow. The
scatter takes a departure in only up to a multiple of itself; for some minutes after a real motion it is large, and
small contradictions go unnoticed.
"""

import math
from bisect import bisect_left
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats

_LAG_NS: Final = 10 * NS_PER_S
_MEMORY_S: Final = 120.0
_LEARNT_NS: Final = 60 * NS_PER_S  # the baseline spans at least so much before anybody is judged by it …
_LEARNT_EPOCHS: Final = 10  # … and so many epochs
_LARGEST_WEIGHT: Final = 0.25  # of one epoch, however long the baseline was frozen
_TAKEN_SIGMA: Final = 4.0  # of a departure, into the scatter
_LEAST_SIGMA_M: Final = 0.001
_SAME_INSTANT_NS: Final = 20_000_000

Vector = tuple[float, ...]
_ZERO: Final[Vector] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Course:
    """See the module; east, north, up, metres. Picklable, small."""

    recent: tuple[tuple[int, Vector], ...] = ()  # (time, displacement) of the last _LAG_NS
    t_first_gps_ns: int = 0  # of the baseline
    t_last_gps_ns: int = 0
    epochs: int = 0  # in the baseline
    baseline_m: Vector = _ZERO
    variance_m2: Vector = _ZERO

    @property
    def is_learnt(self) -> bool:
        """Whether the baseline is good enough to judge a departure by."""
        return self.epochs >= _LEARNT_EPOCHS and self.t_last_gps_ns - self.t_first_gps_ns >= _LEARNT_NS

    @property
    def sigma_m(self) -> Floats:
        """Scatter of the epochs about the baseline, (3,)."""
        sigma: Floats = np.maximum(np.sqrt(self.variance_m2), _LEAST_SIGMA_M)
        return sigma

    @property
    def times(self) -> tuple[int, ...]:
        """Instants of the recent epochs, GPS ns, in order."""
        return tuple(t for t, _ in self.recent)

    def departure_at(self, t_gps_ns: int) -> Floats | None:
        """What an epoch (3,) shows beyond the baseline; None where there is no such epoch, or no baseline yet."""
        if not self.is_learnt:
            return None
        index = bisect_left(self.recent, t_gps_ns - _SAME_INSTANT_NS, key=_time)
        if index == len(self.recent) or self.recent[index][0] > t_gps_ns + _SAME_INSTANT_NS:
            return None
        return np.array(self.recent[index][1]) - self.baseline_m


def extended(course: Course, t_gps_ns: int, displacement_m: Floats, *, frozen: bool) -> Course:
    """The course with one more epoch; one not newer than the last is left out."""
    if course.recent and t_gps_ns <= course.recent[-1][0]:
        return course
    gap_ns = t_gps_ns - (course.recent[-1][0] if course.recent else course.t_last_gps_ns)
    if gap_ns > _MEMORY_S * NS_PER_S and not frozen:
        course = Course()
    recent = (*course.recent, (t_gps_ns, tuple(displacement_m.tolist())))
    leaving = [item for item in recent if item[0] <= t_gps_ns - _LAG_NS]
    course = replace(course, recent=recent[len(leaving) :])
    if not frozen:
        for t, displacement in leaving:
            course = _learnt(course, t, np.array(displacement))
    return course


def without_before(course: Course, t_gps_ns: int) -> Course:
    """The course without the recent epochs from before a time: they are not to become part of the baseline."""
    return replace(course, recent=tuple(item for item in course.recent if item[0] >= t_gps_ns))


def _learnt(course: Course, t_gps_ns: int, displacement_m: Floats) -> Course:
    """The baseline with one more epoch."""
    if course.epochs == 0:
        return replace(
            course, t_first_gps_ns=t_gps_ns, t_last_gps_ns=t_gps_ns, epochs=1, baseline_m=_vector(displacement_m)
        )
    departure = displacement_m - course.baseline_m
    step_s = (t_gps_ns - course.t_last_gps_ns) / NS_PER_S
    weight = max(1.0 / (course.epochs + 1), 1.0 - math.exp(-step_s / _MEMORY_S))
    taken = departure**2
    if course.is_learnt:
        weight = min(weight, _LARGEST_WEIGHT)
        taken = np.minimum(taken, (_TAKEN_SIGMA * course.sigma_m) ** 2)
    return replace(
        course,
        t_last_gps_ns=t_gps_ns,
        epochs=course.epochs + 1,
        baseline_m=_vector(np.array(course.baseline_m) + weight * departure),
        variance_m2=_vector((1.0 - weight) * (np.array(course.variance_m2) + weight * taken)),
    )


def _time(epoch: tuple[int, Vector]) -> int:
    return epoch[0]


def _vector(values: Floats) -> Vector:
    return tuple(values.tolist())
