"""How much of a time span a station delivered: epochs expected, received, solved, converged, fixed, and why not.

A gap is a row with a reason, never just an absence: epochs that did not come while the server itself was down say so.
The interval between epochs is the span's own (its most frequent
one), so that a station that is set to another rate is not thought to lose epochs.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Protocol

import numpy as np

from plumbline.gps_time import DAY_NS, NS_PER_S, gps_minus_utc_s
from plumbline.records import Ints, Status

_CONVERGED: Final = frozenset({Status.PPP_FLOAT, Status.PPP_FIXED, Status.RTK_FLOAT, Status.RTK_FIXED})
_FIXED: Final = frozenset({Status.PPP_FIXED, Status.RTK_FIXED})
_PERCENTILES: Final = (50, 95, 99)
SILENCE: Final = "no observations received"
SERVER_DOWN: Final = "the server was down"


class Mark(Protocol):
    """What counting needs of a solution."""

    @property
    def t_gps_ns(self) -> int:
        """The epoch."""

    @property
    def t_receive_ns(self) -> int:
        """When its last byte came."""

    @property
    def status(self) -> Status:
        """What became of it."""

    @property
    def reason(self) -> str:
        """Why, where it is not well."""


def day_start_ns(t_gps_ns: int) -> int:
    """Start of the UTC day that a time lies in, GPS ns (days with a leap second end a second early)."""
    leap_ns = round(gps_minus_utc_s(t_gps_ns) * NS_PER_S)
    utc_ns = t_gps_ns - leap_ns
    return utc_ns - utc_ns % DAY_NS + leap_ns


@dataclass(frozen=True, slots=True)
class Gap:
    """Epochs that lack, from the first that does to the last."""

    t_first_gps_ns: int
    t_last_gps_ns: int
    epochs: int
    reason: str


@dataclass(frozen=True, slots=True)
class Availability:
    """A span's counts. ``loss`` counts epochs without a converged solution by reason, those not received among them."""

    t_first_gps_ns: int
    t_end_gps_ns: int
    interval_s: float
    expected: int
    received: int
    solved: int  # with a position of any kind
    converged: int
    fixed: int
    loss: Mapping[str, int]
    gaps: tuple[Gap, ...]  # epochs not received, and stretches without a position
    latency_s: Mapping[int, float]  # percentile → seconds from the epoch to the receipt of its last byte


def availability(
    solutions: Sequence[Mark], t_first_gps_ns: int, t_end_gps_ns: int, downtimes: Sequence[tuple[int, int]] = ()
) -> Availability:
    """Counts of a span [first, end); ``solutions`` are those of it in order of time.

    ``downtimes``: (from, to) when the server was down, GPS ns, in order.
    """
    times = np.array([s.t_gps_ns for s in solutions], np.int64)
    interval_ns = _interval_ns(times)
    silent = [
        part
        for gap in _silences(times, t_first_gps_ns, t_end_gps_ns, interval_ns)
        for part in _by_cause(gap, interval_ns, downtimes)
    ]
    loss: Counter[str] = Counter(s.reason or s.status.value for s in solutions if s.status not in _CONVERGED)
    for gap in silent:
        loss[gap.reason] += gap.epochs
    latency_s = np.array([s.t_receive_ns - s.t_gps_ns for s in solutions]) / NS_PER_S
    return Availability(
        t_first_gps_ns=t_first_gps_ns,
        t_end_gps_ns=t_end_gps_ns,
        interval_s=interval_ns / NS_PER_S,
        expected=len(solutions) + sum(gap.epochs for gap in silent),
        received=len(solutions),
        solved=sum(s.status.has_position for s in solutions),
        converged=sum(s.status in _CONVERGED for s in solutions),
        fixed=sum(s.status in _FIXED for s in solutions),
        loss=dict(loss),
        gaps=tuple(sorted((*silent, *_outages(solutions)), key=lambda gap: gap.t_first_gps_ns)),
        latency_s={p: float(np.percentile(latency_s, p)) for p in _PERCENTILES} if len(solutions) else {},
    )


def _interval_ns(times: Ints) -> int:
    """The most frequent step between epochs; one second where there is none."""
    if times.size < 2:
        return NS_PER_S
    steps, counts = np.unique(np.diff(times), return_counts=True)
    return max(int(steps[np.argmax(counts)]), 1)


def _silences(times: Ints, t_first_ns: int, t_end_ns: int, interval_ns: int) -> list[Gap]:
    """Stretches of more than one and a half intervals between epochs, the span's ends among them."""
    edges = [t_first_ns - interval_ns, *times.tolist(), t_end_ns]
    gaps = []
    for before, after in pairwise(edges):
        lacking = round((after - before) / interval_ns) - 1
        if lacking > 0 and after - before > 1.5 * interval_ns:
            gaps.append(Gap(before + interval_ns, after - interval_ns, lacking, SILENCE))
    return gaps


def _by_cause(gap: Gap, interval_ns: int, downtimes: Sequence[tuple[int, int]]) -> list[Gap]:
    """A silence cut into what came while the server was down, and the rest."""
    parts: list[Gap] = []
    downtimes = [d for d in downtimes if d[0] <= gap.t_last_gps_ns and d[1] > gap.t_first_gps_ns]
    for k in range(gap.epochs):
        t_ns = gap.t_first_gps_ns + k * interval_ns
        reason = SERVER_DOWN if any(begin <= t_ns < end for begin, end in downtimes) else SILENCE
        if parts and parts[-1].reason == reason:
            parts[-1] = Gap(parts[-1].t_first_gps_ns, t_ns, parts[-1].epochs + 1, reason)
        else:
            parts.append(Gap(t_ns, t_ns, 1, reason))
    return parts


def _outages(solutions: Sequence[Mark]) -> list[Gap]:
    """Stretches of epochs without a position, for one reason each."""
    gaps: list[Gap] = []
    open_gap: Gap | None = None
    for solution in solutions:
        reason = solution.reason or solution.status.value
        if solution.status.has_position:
            open_gap = None
        elif open_gap is not None and open_gap.reason == reason:
            open_gap = Gap(open_gap.t_first_gps_ns, solution.t_gps_ns, open_gap.epochs + 1, reason)
            gaps[-1] = open_gap
        else:
            open_gap = Gap(solution.t_gps_ns, solution.t_gps_ns, 1, reason)
            gaps.append(open_gap)
    return gaps
