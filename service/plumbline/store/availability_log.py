"""When the server was up, and the days of every station that are over. Wall clock as GPS ns, days by UTC."""

import json
from dataclasses import asdict
from itertools import pairwise
from typing import NamedTuple

from sqlalchemy import Connection, func, select

from plumbline.quality.availability import Availability, Gap
from plumbline.records import Status
from plumbline.store.tables import availability as days_table
from plumbline.store.tables import solutions as solution_table
from plumbline.store.tables import uptimes as uptimes_table
from plumbline.store.upsert import upsert

_ALIVE_NS = 30_000_000_000  # the store tells that it lives much more often than that


class EpochMark(NamedTuple):
    """A solution as far as counting goes."""

    t_gps_ns: int
    t_receive_ns: int
    status: Status
    reason: str


def note_alive(connection: Connection, t_start_gps_ns: int, t_now_gps_ns: int) -> None:
    """The store that began at a time lives at another."""
    upsert(connection, uptimes_table, [(t_start_gps_ns, t_now_gps_ns)], newer_by="t_last_gps_ns")


def downtimes(connection: Connection) -> tuple[tuple[int, int], ...]:
    """(from, to) between the stores' lives, in order; where lives overlap there was none."""
    lives = connection.execute(select(uptimes_table).order_by(uptimes_table.c.t_start_gps_ns)).all()
    down: list[tuple[int, int]] = []
    last_ns = 0
    for before, after in pairwise(lives):
        last_ns = max(last_ns, before.t_last_gps_ns)
        if after.t_start_gps_ns > last_ns:
            down.append((last_ns, after.t_start_gps_ns))
    return tuple(down)


def marks(connection: Connection, station: str, start: int, end: int) -> tuple[EpochMark, ...]:
    """Epochs with start ≤ t < end in order of time."""
    c = solution_table.c
    query = select(c.t_gps_ns, c.t_receive_ns, c.status, c.reason).where(
        c.station == station, c.t_gps_ns >= start, c.t_gps_ns < end
    )
    rows = connection.execute(query.order_by(c.t_gps_ns))
    return tuple(EpochMark(t, received, Status(status), reason) for t, received, status, reason in rows)


def save_day(connection: Connection, station: str, day: Availability) -> None:
    """Keep a day that is over."""
    row = (station, day.t_first_gps_ns, day.t_end_gps_ns, json.dumps(asdict(day), separators=(",", ":")))
    upsert(connection, days_table, [row])


def days(connection: Connection, station: str, start: int, end: int) -> dict[int, Availability]:
    """Kept days that begin in a span, by their beginning."""
    c = days_table.c
    query = select(c.t_first_gps_ns, c.counts).where(
        c.station == station, c.t_first_gps_ns >= start, c.t_first_gps_ns < end
    )
    return {t: _day(json.loads(counts)) for t, counts in connection.execute(query)}


def last_day(connection: Connection, station: str) -> int | None:
    """The beginning of the last day that is kept of a station."""
    query = select(func.max(days_table.c.t_first_gps_ns)).where(days_table.c.station == station)
    found: int | None = connection.execute(query).scalar_one()
    return found


def first_epoch(connection: Connection, station: str) -> int | None:
    """The time of a station's first solution."""
    query = select(func.min(solution_table.c.t_gps_ns)).where(solution_table.c.station == station)
    found: int | None = connection.execute(query).scalar_one()
    return found


def _day(values: dict[str, object]) -> Availability:
    gaps = tuple(Gap(**gap) for gap in values.pop("gaps"))  # type: ignore[attr-defined]
    latency = {int(percentile): value for percentile, value in values.pop("latency_s").items()}  # type: ignore[attr-defined]
    return Availability(**values, gaps=gaps, latency_s=latency)  # type: ignore[arg-type]
