"""Which week is it? The receive time says so, unless the stream is a recording: then its own ephemerides do.

No observation carries its week. Live, the receive time settles it. A recording replayed years later settles it by its
ephemerides, whose reference times are never far from their use: when one lies more than half a week from what the
receive time suggests, the stream's time base is shifted there. Around the end of a week some encoders send the week of
transmission and others that of the reference time; an ephemeris whose two times lie in different weeks says nothing.
"""

from dataclasses import dataclass
from typing import Final

from plumbline.gps_time import WEEK_NS, nearest_ns

_AMBIGUOUS_BEFORE_USE: Final = 30  # so many in a row, and nothing better: the week is taken as that of reference times


@dataclass(slots=True)
class TimeBase:
    """The shift of a stream's own time against its receive time: zero when live. Picklable."""

    offset_ns: int = 0
    known: bool = False  # an ephemeris has confirmed or set it
    tow_ns: int | None = None  # time of week that the stream's last timed message told
    _ambiguous: int = 0

    def near(self, t_receive_ns: int) -> int:
        """A time within half a week of what the stream means at a receive time."""
        return t_receive_ns + self.offset_ns

    def observe(self, t_gps_ns: int) -> None:
        """Take the time of a message, right but for its week."""
        self.tow_ns = t_gps_ns % WEEK_NS

    def learn(self, toe_gps_ns: int, t_receive_ns: int) -> bool:
        """Take an ephemeris's reference time, its week as sent; True when it has moved the base."""
        if abs(toe_gps_ns - self.near(t_receive_ns)) < WEEK_NS // 2:
            self.known = True
            return False
        t_ns = toe_gps_ns if self.tow_ns is None else nearest_ns(self.tow_ns, WEEK_NS, toe_gps_ns)
        if t_ns // WEEK_NS != toe_gps_ns // WEEK_NS and self._ambiguous < _AMBIGUOUS_BEFORE_USE:
            self._ambiguous += 1
            return False
        self.offset_ns, self.known, self._ambiguous = t_ns - t_receive_ns, True, 0
        return True
