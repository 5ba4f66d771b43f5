"""Epochs of a platform's antennas brought together: what all of them saw at one instant.

An instant is complete when every antenna is in that, at its own rate, is due then; one that is late is waited for up to
a limit, one that has fallen silent is not. Instants leave in the order of time. What an instant holds, and as of which
receive time it is complete, depends on receive times alone, however often somebody asks.
"""

from collections import Counter
from dataclasses import dataclass, field
from typing import Final

from plumbline.records import Epoch

SAME_INSTANT_NS: Final = 2_000_000
_SILENT_INTERVALS: Final = 3
_WENT_BACK_NS: Final = 60_000_000_000


@dataclass(frozen=True, slots=True)
class _Seen:
    """An epoch that an antenna has given, without its rows."""

    t_gps_ns: int
    t_receive_ns: int


@dataclass(slots=True)
class Instant:
    """The epochs of one instant, by antenna; None: nothing (yet)."""

    t_gps_ns: int
    t_first_receive_ns: int
    complete_ns: int  # receive time as of which nothing more is waited for, as far as it is known
    epochs: list[Epoch | None]

    @property
    def first(self) -> Epoch:
        """The epoch of the first antenna that has one."""
        return next(epoch for epoch in self.epochs if epoch is not None)


@dataclass(slots=True)
class Instants:
    """Sans-IO: :meth:`add` epochs in the order of receive times, then ask for :meth:`due`. Picklable."""

    n_antennas: int
    counters: Counter[str] = field(default_factory=Counter)
    _waiting: list[Instant] = field(default_factory=list)  # by time
    _seen: list[tuple[_Seen, ...]] = field(default_factory=list)  # by antenna, the last two epochs
    _t_left_ns: int | None = None  # of the last instant that has left

    def __post_init__(self) -> None:
        """No antenna has been seen."""
        self._seen = self._seen or [()] * self.n_antennas

    def add(self, epoch: Epoch, antenna: int) -> None:
        """Take an epoch of an antenna, numbered from 0; one whose instant has left, or that repeats, is counted."""
        if self._t_left_ns is not None and epoch.t_gps_ns < self._t_left_ns - _WENT_BACK_NS:
            self.clear()  # the series itself has gone back
        self._seen[antenna] = (*self._seen[antenna][-1:], _Seen(epoch.t_gps_ns, epoch.t_receive_ns))
        if self._t_left_ns is not None and epoch.t_gps_ns <= self._t_left_ns + SAME_INSTANT_NS:
            self.counters[f"antenna_{antenna + 1}_late_for_its_instant"] += 1
            return
        instant = next((i for i in self._waiting if abs(i.t_gps_ns - epoch.t_gps_ns) <= SAME_INSTANT_NS), None)
        if instant is None:
            nothing: list[Epoch | None] = [None] * self.n_antennas
            instant = Instant(epoch.t_gps_ns, epoch.t_receive_ns, epoch.t_receive_ns, nothing)
            self._waiting = sorted([*self._waiting, instant], key=lambda i: i.t_gps_ns)
        elif instant.epochs[antenna] is not None:
            self.counters[f"antenna_{antenna + 1}_repeated"] += 1
            return
        instant.epochs[antenna] = epoch
        instant.complete_ns = max(instant.complete_ns, epoch.t_receive_ns)

    def due(self, t_receive_ns: int, wait_ns: int) -> Instant | None:
        """The earliest instant, if nothing more is to come for it or its time is up; None while it waits."""
        if not self._waiting:
            return None
        instant = self._waiting[0]
        deadline_ns = instant.t_first_receive_ns + wait_ns
        missing = [k for k, epoch in enumerate(instant.epochs) if epoch is None]
        known_ns = [self._known_absent_ns(k, instant) for k in missing]
        settled = [t_ns for t_ns in known_ns if t_ns is not None]
        if len(settled) == len(known_ns):
            instant.complete_ns = min(max([instant.complete_ns, *settled]), max(deadline_ns, instant.complete_ns))
        elif t_receive_ns >= deadline_ns:
            instant.complete_ns = max(deadline_ns, instant.complete_ns)
        else:
            return None
        return instant

    def leave(self, instant: Instant) -> None:
        """The instant has been used."""
        self._waiting = [other for other in self._waiting if other is not instant]
        self._t_left_ns = instant.t_gps_ns

    def clear(self) -> None:
        """Forget everything but the counters."""
        self._waiting, self._seen, self._t_left_ns = [], [()] * self.n_antennas, None

    def _known_absent_ns(self, antenna: int, instant: Instant) -> int | None:
        """Receive time since when it is known that an antenna has nothing for an instant; None: it may still come."""
        seen = self._seen[antenna]
        if len(seen) < 2:
            return (
                seen[-1].t_receive_ns if seen and seen[-1].t_gps_ns > instant.t_gps_ns else instant.t_first_receive_ns
            )
        last = seen[-1]
        interval_ns = last.t_gps_ns - seen[0].t_gps_ns
        if last.t_gps_ns > instant.t_gps_ns:  # epochs of an antenna leave in order
            return last.t_receive_ns
        silent = instant.t_first_receive_ns - last.t_receive_ns > _SILENT_INTERVALS * interval_ns
        due = last.t_gps_ns + interval_ns <= instant.t_gps_ns + SAME_INSTANT_NS
        return None if due and not silent else instant.t_first_receive_ns
