"""Keeps the book of days: when the server is up, and what every station delivered in each day that is over.

A day is over an hour after its end, when nothing of it is on its way any more: either the station's epochs are beyond
it, or none has come for that hour. (Of a recording that is replayed years later the clock says nothing.)
"""

import asyncio
import logging
import time
from typing import Final

from plumbline.errors import StoreError
from plumbline.gps_time import DAY_NS, NS_PER_S, gps_ns_from_unix_ns
from plumbline.quality.availability import availability, day_start_ns
from plumbline.records import Solution
from plumbline.store import Store

log = logging.getLogger(__name__)

ALIVE_INTERVAL_S: Final = 5.0
DAYS_INTERVAL_S: Final = 600.0
_GRACE_NS: Final = 3600 * NS_PER_S
_DAYS_BACK: Final = 31


class DayKeeper:
    """A task beside the store's writer; a database that does not answer is asked again."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._started_ns = _now_ns()

    async def run(self) -> None:
        """Until cancelled."""
        due_s = 0.0
        while True:
            try:
                await self._store.note_alive(self._started_ns, _now_ns())
                if time.monotonic() >= due_s:
                    await self.close_days(_now_ns())
                    due_s = time.monotonic() + DAYS_INTERVAL_S
            except StoreError as error:
                log.warning("the book of days waits: %s", error)
            await asyncio.sleep(ALIVE_INTERVAL_S)

    async def close_days(self, now_ns: int) -> None:
        """Write the days of all stations that are over and not written yet."""
        downtimes = await self._store.downtimes()
        for row in await self._store.stations():
            station = row.settings.station
            newest = await self._store.latest_solution(station)
            if newest is None:
                continue
            until_ns = _over_until_ns(newest, now_ns)
            begin_ns = await self._first_open_day(station, until_ns)
            while begin_ns + DAY_NS <= until_ns:
                end_ns = day_start_ns(begin_ns + DAY_NS + DAY_NS // 2)
                marks = await self._store.epoch_marks(station, begin_ns, end_ns)
                await self._store.save_day(station, availability(marks, begin_ns, end_ns, downtimes))
                begin_ns = end_ns

    async def _first_open_day(self, station: str, until_ns: int) -> int:
        kept_ns = await self._store.last_day(station)
        earliest_ns = day_start_ns(until_ns) - _DAYS_BACK * DAY_NS
        if kept_ns is not None:
            return max(day_start_ns(kept_ns + DAY_NS + DAY_NS // 2), day_start_ns(earliest_ns))
        first_ns = await self._store.first_epoch(station)
        return day_start_ns(max(first_ns or until_ns, earliest_ns))


def _over_until_ns(newest: Solution, now_ns: int) -> int:
    """The time up to which days are over."""
    if now_ns - newest.t_receive_ns > _GRACE_NS and abs(now_ns - newest.t_gps_ns) < _DAYS_BACK * DAY_NS:
        return now_ns - _GRACE_NS
    return newest.t_gps_ns - _GRACE_NS


def _now_ns() -> int:
    return gps_ns_from_unix_ns(time.time_ns())
