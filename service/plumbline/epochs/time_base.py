"""Which week is it? The receive time says so, unless the stream is a recording: then its own ephemerides do.

No observation carries its week. Live, the receive time settles it. A recording replayed years later settles it by the
reference times of its ephemerides, which are never far from their time of transmission: when one lies more than half a
week from what the receive time suggests, the stream's time base is shifted there.
"""

from dataclasses import dataclass
from typing import Final

from plumbline.gps_time import WEEK_NS

_AGREEING_EPHEMERIDES: Final = 2


@dataclass(slots=True)
class TimeBase:
    """The shift of a stream's own time against its receive time: zero when live. Picklable."""

    offset_ns: int = 0
    known: bool = False  # an ephemeris has confirmed or set it
    _candidate_ns: int = 0
    _agreeing: int = 0

    def near(self, t_receive_ns: int) -> int:
        """A time within half a week of what the stream means at a receive time."""
        return t_receive_ns + self.offset_ns

    def learn(self, toe_gps_ns: int, t_receive_ns: int) -> bool:
        """Take an ephemeris's reference time (its week resolved); True when the base has moved."""
        shift_ns = toe_gps_ns - self.near(t_receive_ns)
        if abs(shift_ns) < WEEK_NS // 2:
            self.known, self._agreeing = True, 0
            return False
        candidate_ns = toe_gps_ns - t_receive_ns
        self._agreeing = self._agreeing + 1 if abs(candidate_ns - self._candidate_ns) < WEEK_NS // 2 else 1
        self._candidate_ns = candidate_ns
        if self._agreeing < _AGREEING_EPHEMERIDES:
            return False
        self.offset_ns, self.known, self._agreeing = candidate_ns, True, 0
        return True
