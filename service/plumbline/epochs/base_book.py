"""A base station's epochs, asked for by time and *as of* a receive time, and where its antenna says it is."""

from bisect import bisect_right
from dataclasses import dataclass, field
from itertools import islice
from typing import Final

from plumbline.epochs.history import HISTORY_NS
from plumbline.gps_time import NS_PER_S
from plumbline.records import AntennaDescription, Epoch

_KEPT_NS: Final = 60 * NS_PER_S  # of the base's own time; for late questions also by receive time
_SAME_INSTANT_NS: Final = 2_000_000
_SILENT_INTERVALS: Final = 3


@dataclass(slots=True)
class BaseBook:
    """The last minute of a base's epochs. Picklable; answers are functions of what had been received by then."""

    epochs: list[Epoch] = field(default_factory=list)  # by time
    descriptions: list[tuple[int, AntennaDescription]] = field(default_factory=list)  # (receive time, what was said)

    def add(self, epoch: Epoch) -> None:
        """Take the next epoch; one not newer than the last is left out, unless the series has gone back altogether."""
        if self.epochs and epoch.t_gps_ns <= self.epochs[-1].t_gps_ns:
            if self.epochs[-1].t_gps_ns - epoch.t_gps_ns < _KEPT_NS:
                return
            self.epochs = []
        first = min(
            bisect_right(self.epochs, epoch.t_gps_ns - _KEPT_NS, key=_time),
            bisect_right(self.epochs, epoch.t_receive_ns - HISTORY_NS, key=_receive_time),
        )
        self.epochs = [*self.epochs[first:], epoch]

    def describe(self, description: AntennaDescription, t_receive_ns: int) -> None:
        """Take what the stream says of its antenna, if it is new."""
        if not self.descriptions or self.descriptions[-1][1] != description:
            self.descriptions = [*self.descriptions[-3:], (t_receive_ns, description)]

    def at(self, t_gps_ns: int, as_of_receive_ns: int) -> Epoch | None:
        """The epoch of an instant, else the last one before it, from what had been received; None without any."""
        end = bisect_right(self.epochs, t_gps_ns + _SAME_INSTANT_NS, key=_time)
        return next((e for e in reversed(self.epochs[:end]) if e.t_receive_ns <= as_of_receive_ns), None)

    def received_after(self, since_ns: int, until_ns: int) -> list[Epoch]:
        """Epochs received after a time and up to another, in order."""
        first = bisect_right(self.epochs, since_ns, key=_receive_time)
        return [epoch for epoch in self.epochs[first:] if epoch.t_receive_ns <= until_ns]

    def description(self, as_of_receive_ns: int) -> AntennaDescription | None:
        """What the stream had said of its antenna by a receive time."""
        known = [said for received_ns, said in self.descriptions if received_ns <= as_of_receive_ns]
        return known[-1] if known else None

    def is_due(self, t_gps_ns: int, as_of_receive_ns: int) -> bool:
        """Whether, at the base's rate, an epoch closer to an instant than :meth:`at` gives is still to come."""
        known = self._known(as_of_receive_ns)
        if len(known) < 2:
            return False
        interval_ns = known[-1].t_gps_ns - known[-2].t_gps_ns
        return known[-1].t_gps_ns + interval_ns <= t_gps_ns + _SAME_INSTANT_NS

    def is_silent(self, as_of_receive_ns: int) -> bool:
        """Whether several epochs have failed to come."""
        known = self._known(as_of_receive_ns)
        if len(known) < 2:
            return True
        interval_ns = known[-1].t_gps_ns - known[-2].t_gps_ns
        return as_of_receive_ns - known[-1].t_receive_ns > _SILENT_INTERVALS * interval_ns

    def _known(self, as_of_receive_ns: int) -> list[Epoch]:
        """The last two epochs received by a time."""
        known = (e for e in reversed(self.epochs) if e.t_receive_ns <= as_of_receive_ns)
        return list(islice(known, 2))[::-1]


def _time(epoch: Epoch) -> int:
    return epoch.t_gps_ns


def _receive_time(epoch: Epoch) -> int:
    return epoch.t_receive_ns
