"""Samples and measurements in the order of their own times, whatever the order of their arrival.

A filter's state is kept as nodes: the state at a time with everything up to that time applied. A measurement that
belongs before the last node goes back to the node before it, and everything after is run again. A measurement ahead of
the samples waits for them. So the outcome is that of inputs in order, as long as nothing is later than the limit.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Generic, Protocol, TypeVar

import numpy as np

from plumbline.fusion.inertial_run import ROW_SIZE, advance
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, Ints


class Timed(Protocol):
    """A measurement that belongs to a time; ``rank`` orders those of one time."""

    @property
    def t_gps_ns(self) -> int:
        """When it was taken."""
        ...

    @property
    def rank(self) -> int:
        """Order among measurements of the same time."""
        ...


Extra = TypeVar("Extra")
Measured = TypeVar("Measured", bound=Timed)


@dataclass(frozen=True, slots=True)
class Node(Generic[Extra]):
    """The state at a time, everything up to that time applied. Arrays are not to be written to."""

    t_gps_ns: int
    nav: Floats  # (21,), see plumbline.fusion.strapdown
    p: Floats  # (n, n), the error state's covariance; the first 15 are the navigation's
    extra: Extra


@dataclass(frozen=True, slots=True)
class Rows:
    """States at the samples' times; columns in :mod:`plumbline.fusion.inertial_run`."""

    t_gps_ns: Ints  # (n,)
    values: Floats  # (n, 51)


@dataclass(frozen=True, slots=True)
class Timeline(Generic[Measured, Extra]):
    """What a filter keeps of the last seconds."""

    t_gps_ns: Ints  # (n,) of the samples
    samples: Floats  # (n, 6) specific force m/s² and rate rad/s, body axes
    nodes: tuple[Node[Extra], ...] = ()
    measurements: tuple[Measured, ...] = ()  # by time and rank
    counters: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Ran(Generic[Measured, Extra]):
    """What a run gave."""

    timeline: Timeline[Measured, Extra]
    rows: Rows  # of the samples passed: new ones, and again those after a late measurement
    updated: tuple[Node[Extra], ...]  # the state after each measurement applied


def no_rows() -> Rows:
    """No rows."""
    return Rows(np.zeros(0, np.int64), np.zeros((0, ROW_SIZE)))


def empty_timeline() -> Timeline[Measured, Extra]:
    """Before the first sample."""
    return Timeline(np.zeros(0, np.int64), np.zeros((0, 6)))


def counted(timeline: Timeline[Measured, Extra], reason: str, n: int = 1) -> Timeline[Measured, Extra]:
    """One more (or ``n`` more) inputs not used, for a reason."""
    if n == 0:
        return timeline
    return replace(timeline, counters={**timeline.counters, reason: timeline.counters.get(reason, 0) + n})


def add_samples(timeline: Timeline[Measured, Extra], t_gps_ns: Ints, samples: Floats) -> Timeline[Measured, Extra]:
    """Put samples (n, 6) at the end; those not later than the last, or not finite, are counted and left out."""
    last = timeline.t_gps_ns[-1] if timeline.t_gps_ns.size else np.iinfo(np.int64).min
    finite = np.isfinite(samples).all(axis=1)
    rising = np.maximum.accumulate(np.concatenate([[last], t_gps_ns[:-1]])) < t_gps_ns
    keep = finite & rising
    timeline = counted(timeline, "inertial_sample_impossible", int((~finite).sum()))
    timeline = counted(timeline, "inertial_late_or_repeated", int((finite & ~rising).sum()))
    return replace(
        timeline,
        t_gps_ns=np.concatenate([timeline.t_gps_ns, t_gps_ns[keep]]),
        samples=np.concatenate([timeline.samples, samples[keep]]),
    )


def add_measurement(timeline: Timeline[Measured, Extra], measurement: Measured) -> Timeline[Measured, Extra]:
    """Put a measurement in its place, and forget the nodes that it makes wrong; too late, it is counted and left."""
    t_ns = measurement.t_gps_ns
    if timeline.nodes and t_ns <= timeline.nodes[0].t_gps_ns:
        return counted(timeline, "measurement_too_late")
    known, key = timeline.measurements, (t_ns, measurement.rank)
    at = bisect_left(known, key, key=lambda m: (m.t_gps_ns, m.rank))
    if at < len(known) and (known[at].t_gps_ns, known[at].rank) == key:
        return counted(timeline, "measurement_repeated")
    nodes = timeline.nodes[: bisect_left(timeline.nodes, t_ns, key=_time_of)]
    return replace(timeline, measurements=(*known[:at], measurement, *known[at:]), nodes=nodes)


def _time_of(timed: Node[Extra] | Timed) -> int:
    return timed.t_gps_ns


def run(
    timeline: Timeline[Measured, Extra],
    noise: Floats,
    local: bool,
    update: Callable[[Node[Extra], Measured, Floats], Node[Extra]],
    late_limit_s: float,
) -> Ran[Measured, Extra]:
    """Run from the last node to the last sample; ``update`` gets the node, the measurement and the sample (6,) there.

    Returns also the rows of all samples passed, and the nodes after each measurement. Without a node, nothing happens.
    """
    if not timeline.nodes or not timeline.t_gps_ns.size:
        return Ran(timeline, no_rows(), ())
    end_ns, start_ns = int(timeline.t_gps_ns[-1]), timeline.nodes[-1].t_gps_ns
    first, last = (bisect_right(timeline.measurements, t_ns, key=_time_of) for t_ns in (start_ns, end_ns))
    due = timeline.measurements[first:last]
    nodes = list(timeline.nodes)
    parts: list[Rows] = []
    updated: list[Node[Extra]] = []
    for measurement in due:
        if measurement.t_gps_ns > nodes[-1].t_gps_ns:
            nodes.append(_advanced(timeline, nodes[-1], measurement.t_gps_ns, noise, local, parts))
        nodes[-1] = update(nodes[-1], measurement, _sample_at(timeline, measurement.t_gps_ns))
        updated.append(nodes[-1])
    if nodes[-1].t_gps_ns < end_ns:
        nodes.append(_advanced(timeline, nodes[-1], end_ns, noise, local, parts))
    done = _trimmed(replace(timeline, nodes=tuple(nodes)), end_ns - round(late_limit_s * NS_PER_S))
    if not parts:
        return Ran(done, no_rows(), tuple(updated))
    rows = Rows(np.concatenate([r.t_gps_ns for r in parts]), np.concatenate([r.values for r in parts]))
    return Ran(done, rows, tuple(updated))


def _advanced(
    timeline: Timeline[Measured, Extra], node: Node[Extra], to_ns: int, noise: Floats, local: bool, parts: list[Rows]
) -> Node[Extra]:
    """The node's state at a later time; the rows of the samples passed are appended to ``parts``."""
    first = max(int(np.searchsorted(timeline.t_gps_ns, node.t_gps_ns + 1)) - 2, 0)
    last = int(np.searchsorted(timeline.t_gps_ns, to_ns)) + 1
    t_ns, samples = timeline.t_gps_ns[first:last], timeline.samples[first:last]
    nav, p = node.nav.copy(), node.p.copy()
    row_t, rows = np.empty(t_ns.size, np.int64), np.empty((t_ns.size, ROW_SIZE))
    n = advance(nav, p, node.t_gps_ns, to_ns, t_ns, samples, noise, local, row_t, rows)
    parts.append(Rows(row_t[:n], rows[:n]))
    return Node(to_ns, nav, p, node.extra)


def _sample_at(timeline: Timeline[Measured, Extra], t_ns: int) -> Floats:
    """Sample (6,) at a time, linear between samples."""
    index = min(int(np.searchsorted(timeline.t_gps_ns, t_ns)), timeline.t_gps_ns.size - 1)
    if index == 0:
        first: Floats = timeline.samples[0].copy()
        return first
    t0, t1 = int(timeline.t_gps_ns[index - 1]), int(timeline.t_gps_ns[index])
    share = (t_ns - t0) / (t1 - t0)
    sample: Floats = (1.0 - share) * timeline.samples[index - 1] + share * timeline.samples[index]
    return sample


def _trimmed(timeline: Timeline[Measured, Extra], oldest_ns: int) -> Timeline[Measured, Extra]:
    """Forget what no measurement within the limit can change."""
    keep = max(bisect_right(timeline.nodes, oldest_ns, key=_time_of) - 1, 0)
    nodes = timeline.nodes[keep:]
    start_ns = nodes[0].t_gps_ns
    first = max(int(np.searchsorted(timeline.t_gps_ns, start_ns)) - 2, 0)
    return replace(
        timeline,
        t_gps_ns=timeline.t_gps_ns[first:],
        samples=timeline.samples[first:],
        nodes=nodes,
        measurements=timeline.measurements[bisect_right(timeline.measurements, start_ns, key=_time_of) :],
    )
