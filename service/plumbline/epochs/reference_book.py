"""What a reference station's own precise position shows, asked for by time and *as of* a receive time."""

from bisect import bisect_right
from dataclasses import dataclass, field
from typing import Final

from plumbline.gps_time import NS_PER_S

_KEPT_NS: Final = 120 * NS_PER_S
_SAME_INSTANT_NS: Final = 1_500_000_000  # a reference is watched once a second; it stands for that second
_WORDS_KEPT: Final = 8

Vector = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Shown:
    """A reference station's departure from where it was in the last minutes, at one epoch: east, north, up, m."""

    t_gps_ns: int
    t_known_ns: int  # receive time from which on it is known
    departure_m: Vector
    sigma_m: Vector


@dataclass(slots=True)
class ReferenceBook:
    """The last two minutes of one reference station. Picklable."""

    shown: list[Shown] = field(default_factory=list)  # by time
    moved: list[tuple[int, str]] = field(default_factory=list)  # (receive time, what is said from then on)

    def add(self, shown: Shown) -> None:
        """Take the next epoch."""
        first = bisect_right(self.shown, shown.t_gps_ns - _KEPT_NS, key=_time)
        self.shown = [*(s for s in self.shown[first:] if s.t_gps_ns < shown.t_gps_ns), shown]

    def say(self, t_known_ns: int, moved: str) -> None:
        """Take what the long watch says, if it is new: empty, the station stands."""
        if moved != (self.moved[-1][1] if self.moved else ""):
            self.moved = [*self.moved[1 - _WORDS_KEPT :], (t_known_ns, moved)]

    def at(self, t_gps_ns: int, as_of_receive_ns: int) -> Shown | None:
        """The epoch of an instant, or the last one just before it, from what was known by then."""
        end = bisect_right(self.shown, t_gps_ns + _SAME_INSTANT_NS // 10, key=_time)
        found = next((s for s in reversed(self.shown[:end]) if s.t_known_ns <= as_of_receive_ns), None)
        return found if found is not None and t_gps_ns - found.t_gps_ns <= _SAME_INSTANT_NS else None

    def said(self, as_of_receive_ns: int) -> str:
        """What the long watch said by a receive time; empty: nothing."""
        return next((text for known_ns, text in reversed(self.moved) if known_ns <= as_of_receive_ns), "")


def _time(shown: Shown) -> int:
    return shown.t_gps_ns
