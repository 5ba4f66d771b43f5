"""Solutions and motion by station and time."""

import json
import math
from typing import Any, Final

import numpy as np
from sqlalchemy import ColumnElement, Connection, Row, Select, Table, select, text

from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, Motion, QualityReport, Solution, Status
from plumbline.store import quality_codec, summaries
from plumbline.store.cursors import from_cursor, to_cursor
from plumbline.store.motion_codec import decode, samples
from plumbline.store.rows import BlockHead, MotionSeries, MotionSummary, Page
from plumbline.store.tables import CHANNELS
from plumbline.store.tables import motion as motion_table
from plumbline.store.tables import quality as quality_table
from plumbline.store.tables import solutions as solution_table

_DAY_S: Final = 86_400
_NICE_S: Final = (1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 10_800, 21_600, 43_200, _DAY_S)
_SYMMETRIC: Final = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
_EARLIEST: Final = 0
_LATEST: Final = 2**63 - 1


def solutions(
    connection: Connection, station: str, start: int | None, end: int | None, limit: int, cursor: str | None
) -> Page[Solution]:
    """A page of solutions in order of time."""
    columns = solution_table.c
    query = _of_station(select(solution_table), solution_table, station, columns.t_gps_ns, start, end)
    if cursor is not None:
        query = query.where(columns.t_gps_ns > from_cursor(cursor, int)[0])
    rows = connection.execute(query.order_by(columns.t_gps_ns).limit(limit + 1)).all()
    items = tuple(_solution(row) for row in rows[:limit])
    return Page(items, to_cursor([items[-1].t_gps_ns]) if len(rows) > limit else None)


def quality(
    connection: Connection, station: str, start: int | None, end: int | None, limit: int, cursor: str | None
) -> Page[QualityReport]:
    """A page of quality reports in order of time."""
    columns = quality_table.c
    query = _of_station(select(quality_table), quality_table, station, columns.t_gps_ns, start, end)
    if cursor is not None:
        query = query.where(columns.t_gps_ns > from_cursor(cursor, int)[0])
    rows = connection.execute(query.order_by(columns.t_gps_ns).limit(limit + 1)).all()
    items = tuple(_quality(row) for row in rows[:limit])
    return Page(items, to_cursor([items[-1].t_gps_ns]) if len(rows) > limit else None)


def latest_quality(connection: Connection, station: str, limit: int) -> tuple[QualityReport, ...]:
    """The newest reports of a station, in order of time."""
    columns = quality_table.c
    query = select(quality_table).where(columns.station == station).order_by(columns.t_gps_ns.desc()).limit(limit)
    return tuple(_quality(row) for row in reversed(connection.execute(query).all()))


def _quality(row: Row[Any]) -> QualityReport:
    return quality_codec.decode(row.station, row.t_gps_ns, row.t_receive_ns, row.report)


def latest_solutions(connection: Connection, station: str, limit: int) -> tuple[Solution, ...]:
    """The newest solutions of a station, in order of time."""
    columns = solution_table.c
    query = select(solution_table).where(columns.station == station).order_by(columns.t_gps_ns.desc()).limit(limit)
    return tuple(_solution(row) for row in reversed(connection.execute(query).all()))


def latest_solution(connection: Connection, station: str) -> Solution | None:
    """The newest solution row of a station."""
    columns = solution_table.c
    query = select(solution_table).where(columns.station == station).order_by(columns.t_gps_ns.desc()).limit(1)
    row = connection.execute(query).first()
    return None if row is None else _solution(row)


def _of_station(
    query: Select[Any], table: Table, station: str, time: ColumnElement[int], start: int | None, end: int | None
) -> Select[Any]:
    query = query.where(table.c.station == station)
    if start is not None:
        query = query.where(time >= start)
    return query if end is None else query.where(time < end)


def _vector(numbers: tuple[float | None, ...]) -> Floats | None:
    return None if all(number is None for number in numbers) else np.array(numbers, dtype=float)


def _angles(numbers: tuple[float | None, ...]) -> Floats | None:
    """Angles, NaN where not known; None where none is."""
    return (
        _vector(tuple(math.nan if n is None else n for n in numbers)) if any(n is not None for n in numbers) else None
    )


def _solution(row: Row[Any]) -> Solution:
    covariance = _vector(tuple(row[12:18]))
    return Solution(
        station=row.station,
        t_gps_ns=row.t_gps_ns,
        t_receive_ns=row.t_receive_ns,
        status=Status(row.status),
        reason=row.reason,
        n_satellites=row.n_satellites,
        position_ecef_m=_vector(tuple(row[6:9])),
        displacement_enu_m=_vector(tuple(row[9:12])),
        covariance_enu_m2=None if covariance is None else covariance[_SYMMETRIC],
        velocity_enu_m_s=_vector(tuple(row[18:21])),
        systems=row.systems,
        zenith_delay_m=row.zenith_delay_m,
        receiver_clock_s=row.receiver_clock_s,
        correction_age_s=row.correction_age_s,
        pdop=row.pdop,
        extras=json.loads(row.extras) if row.extras else {},
        attitude_rad=_angles((row.roll_rad, row.pitch_rad, row.heading_rad)),
        sigma_attitude_rad=_angles((row.sigma_roll_rad, row.sigma_pitch_rad, row.sigma_heading_rad)),
    )


# --------------------------------------------------------------------------------------------- motion: samples


def _block_rows(connection: Connection, station: str, start: int, end: int, limit: int) -> list[Row[Any]]:
    """Blocks with samples in a span; a block never reaches beyond its own second, so none begins earlier."""
    columns = motion_table.c
    query = _of_station(
        select(motion_table), motion_table, station, columns.t_first_gps_ns, start - start % NS_PER_S, end
    )
    return list(connection.execute(query.order_by(columns.t_first_gps_ns).limit(limit)))


def motion_blocks(
    connection: Connection, station: str, start: int | None, end: int | None, limit: int
) -> tuple[Motion, ...]:
    """Whole blocks that begin in the span."""
    start = _EARLIEST if start is None else start
    rows = _block_rows(connection, station, start, _LATEST if end is None else end, limit)
    return tuple(_motion(row) for row in rows if row.t_first_gps_ns >= start)


def _motion(row: Row[Any]) -> Motion:
    arrays = samples(decode(row.samples, row.n))
    turned = bool(np.isfinite(arrays.attitude_rad).any())
    return Motion(
        row.station,
        row.t_first_gps_ns,
        row.t_receive_ns,
        row.interval_ns,
        arrays.displacement_enu_m,
        arrays.velocity_enu_m_s,
        arrays.acceleration_enu_m_s2,
        arrays.sigma_displacement_enu_m,
        Status(row.status),
        row.revision,
        row.reason,
        arrays.attitude_rad if turned else None,
        arrays.sigma_attitude_rad if turned else None,
    )


def motion(
    connection: Connection, station: str, start: int | None, end: int | None, max_points: int, bucket_ns: int | None
) -> MotionSeries:
    """Samples or buckets of a span; see :meth:`plumbline.store.Store.motion`."""
    start, end = _EARLIEST if start is None else start, _LATEST if end is None else end
    if bucket_ns == 0:
        return _sample_series(connection, station, start, end, max_points)
    if bucket_ns is not None:
        return _bucket_series(connection, station, start, end, max_points, bucket_ns)
    if _fits(connection, station, start, end, max_points):
        return _sample_series(connection, station, start, end, max_points)
    bucket_ns = _finest_bucket_ns(connection, station, start, end, max_points)
    return _bucket_series(connection, station, start, end, max_points, bucket_ns)


def _fits(connection: Connection, station: str, start: int, end: int, max_points: int) -> bool:
    """Whether the blocks of a span hold no more samples than asked for; reads no more heads than that."""
    columns = motion_table.c
    low = start - start % NS_PER_S
    query = _of_station(select(columns.n), motion_table, station, columns.t_first_gps_ns, low, end)
    counts = connection.execute(query.limit(max_points + 1)).scalars().all()
    return int(sum(counts)) <= max_points


def _sample_series(connection: Connection, station: str, start: int, end: int, max_points: int) -> MotionSeries:
    """The first ``max_points`` samples of a span; of samples stored twice, the higher revision."""
    rows = _block_rows(connection, station, start, end, max_points + 2)
    heads, times, revisions, columns, total = [], [], [], [], 0
    for row in rows:
        heads.append(BlockHead(row.t_first_gps_ns, row.n, row.interval_ns, row.status, row.revision, row.reason))
        t = row.t_first_gps_ns + row.interval_ns * np.arange(row.n, dtype=np.int64)
        inside = (t >= start) & (t < end)
        arrays = samples(decode(row.samples, row.n))
        times.append(t[inside])
        revisions.append(np.full(int(inside.sum()), row.revision))
        columns.append(
            np.hstack(
                (
                    arrays.displacement_enu_m,
                    arrays.velocity_enu_m_s,
                    arrays.acceleration_enu_m_s2,
                    arrays.sigma_displacement_enu_m,
                    arrays.attitude_rad,
                    arrays.sigma_attitude_rad,
                )
            )[inside]
        )
        total += len(times[-1])
        if total > max_points + row.n:
            break
    if not total:
        return _series(station, 0, np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 18)))
    t, values = np.concatenate(times), np.concatenate(columns)
    order = np.lexsort((-np.concatenate(revisions), t))
    order = order[np.concatenate(([True], np.diff(t[order]) > 0))]
    t, values = t[order], values[order]
    following = int(t[max_points]) if len(t) > max_points else None
    t, values = t[:max_points], values[:max_points]
    kept = tuple(head for head in heads if head.t_first_gps_ns <= t[-1])
    return _series(station, 0, t, np.ones(len(t), np.int64), values, blocks=kept, next_start=following)


def _series(
    station: str,
    bucket_ns: int,
    t_gps_ns: np.ndarray[Any, np.dtype[np.int64]],
    count: np.ndarray[Any, np.dtype[np.int64]],
    values: Floats,
    summary: MotionSummary | None = None,
    blocks: tuple[BlockHead, ...] = (),
    next_start: int | None = None,
) -> MotionSeries:
    d, v, a, s, *turned = (np.ascontiguousarray(values[:, i : i + 3]) for i in range(0, values.shape[1], 3))
    attitude, sigmas = turned if turned and np.isfinite(turned[0]).any() else (None, None)
    return MotionSeries(
        station, bucket_ns, t_gps_ns, count, d, v, a, s, summary, blocks, next_start_gps_ns=next_start,
        attitude_rad=attitude, sigma_attitude_rad=sigmas,
    )  # fmt: skip


# --------------------------------------------------------------------------------------------- motion: buckets


def _finest_bucket_ns(connection: Connection, station: str, start: int, end: int, max_points: int) -> int:
    """The shortest bucket of a round length with which what is stored of a span makes no more than ``max_points``."""
    columns = motion_table.c
    low = start - start % NS_PER_S
    query = _of_station(select(columns.t_first_gps_ns), motion_table, station, columns.t_first_gps_ns, low, end)
    first = connection.execute(query.order_by(columns.t_first_gps_ns).limit(1)).scalar_one()
    last = connection.execute(query.order_by(columns.t_first_gps_ns.desc()).limit(1)).scalar_one()
    candidates = [nice * NS_PER_S for nice in _NICE_S]
    while _n_buckets(first, last, candidates[-1]) > max_points and candidates[-1] <= last:
        candidates.append(2 * candidates[-1])
    return next(b for b in candidates if _n_buckets(first, last, b) <= max_points or b > last)


def _n_buckets(first: int, last: int, bucket_ns: int) -> int:
    start = summaries.bucket_start
    return (start(last, bucket_ns) - start(first, bucket_ns)) // bucket_ns + 1


def _bucket_series(
    connection: Connection, station: str, start: int, end: int, max_points: int, bucket_ns: int
) -> MotionSeries:
    """The first ``max_points`` buckets of a span, from the one that holds its start on."""
    level_s = max(level for level in summaries.LEVELS_S if bucket_ns % (level * NS_PER_S) == 0)
    expressions = ", ".join(summaries.aggregates())
    statement = text(
        f"SELECT t_gps_ns - (t_gps_ns - :origin) % :bucket AS t, {expressions} FROM motion_summaries "
        "WHERE station = :station AND bucket_s = :level AND t_gps_ns >= :start AND t_gps_ns < :end "
        "GROUP BY 1 ORDER BY 1 LIMIT :limit"
    )
    parameters = {
        "bucket": bucket_ns,
        "origin": summaries.ORIGIN_NS,
        "station": station,
        "level": level_s,
        "start": max(summaries.bucket_start(start, bucket_ns), 0),
        "end": end,
        "limit": max_points + 1,
    }
    rows = connection.execute(statement, parameters).all()
    following = int(rows[max_points][0]) if len(rows) > max_points else None
    rows = rows[:max_points]
    t_gps_ns, count = (np.array([row[i] for row in rows], dtype=np.int64) for i in (0, 1))
    numbers = np.array([tuple(row[2:]) for row in rows], dtype=float).reshape(len(rows), 4 * len(CHANNELS) + 3)
    statistics = numbers[:, : 4 * len(CHANNELS)].reshape(len(rows), len(CHANNELS), 4)
    summary = MotionSummary(*(np.ascontiguousarray(statistics[:, :, i]) for i in range(4)))
    values = np.hstack((summary.mean, numbers[:, -3:]))
    return _series(station, bucket_ns, t_gps_ns, count, values, summary=summary, next_start=following)
