"""The one clock that stamps received bytes."""

import time
from collections.abc import Callable

from plumbline.gps_time import gps_ns_from_unix_ns


class ReceiveClock:
    """GPS time from the machine's clock, strictly increasing over this process's life and past ``not_before_ns``.

    When the machine's clock steps back, the stamps creep on by a nanosecond each until it has caught up: the order of
    what was received is kept, which is what a replay needs.
    """

    def __init__(self, not_before_ns: int = 0, unix_ns: Callable[[], int] = time.time_ns) -> None:
        self._last_ns = not_before_ns
        self._unix_ns = unix_ns
        self.steps_back = 0

    def now(self) -> int:
        """A new stamp, GPS ns, later than all before it."""
        now_ns = gps_ns_from_unix_ns(self._unix_ns())
        if now_ns <= self._last_ns:
            self.steps_back += 1
            now_ns = self._last_ns + 1
        self._last_ns = now_ns
        return now_ns
