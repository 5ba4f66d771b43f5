"""Minimum, maximum, mean and RMS of motion in buckets of 1 s, 1 min, 1 h and 1 day, in step with the blocks.

A bucket is always recomputed from everything below it, never added to: so a revised block replaces its part, and
writing a block twice changes nothing. Buckets begin at whole minutes, hours and days of UTC as it has been since 2017
(GPS time − 18 s, kept for all times so that no bucket is longer than another). RMS is about zero. The mean of a longer
bucket weighs its parts by their samples.
"""

import math
import warnings
from collections.abc import Iterable, Sequence
from functools import cache
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection

from plumbline.gps_time import NS_PER_S
from plumbline.store.motion_codec import values
from plumbline.store.tables import CHANNELS, SIGMAS, STATISTICS, motion_summaries
from plumbline.store.upsert import upsert

LEVELS_S: Final = (1, 60, 3600, 86_400)
ORIGIN_NS: Final = 18 * NS_PER_S
_COLUMNS: Final = tuple(f"{channel}_{statistic}" for channel in CHANNELS for statistic in STATISTICS) + SIGMAS

SecondKey = tuple[str, int]  # station and the second's first nanosecond


def bucket_start(t_gps_ns: int, length_ns: int) -> int:
    """The beginning of the bucket that holds a time."""
    return t_gps_ns - (t_gps_ns - ORIGIN_NS) % length_ns


def second_row(key: SecondKey, quanta: NDArray[np.int64]) -> tuple[Any, ...]:
    """The summary row of one second from all of its samples' quanta (12, n)."""
    si = values(quanta)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a channel without a value has no statistics: NaN
        statistics = np.stack(
            (
                np.nanmin(si[:9], axis=1),
                np.nanmax(si[:9], axis=1),
                np.nanmean(si[:9], axis=1),
                np.sqrt(np.nanmean(si[:9] ** 2, axis=1)),
            ),
            axis=1,
        )
        sigmas = np.sqrt(np.nanmean(si[9:] ** 2, axis=1))
    numbers = (*statistics.ravel().tolist(), *sigmas.tolist())
    return (key[0], 1, key[1], quanta.shape[1], *(None if math.isnan(number) else number for number in numbers))


def write_seconds(connection: Connection, rows: Sequence[tuple[Any, ...]]) -> None:
    """Write one-second rows and recompute the minutes, hours and days that they belong to."""
    upsert(connection, motion_summaries, rows)
    seconds = [(row[0], row[2]) for row in rows]
    for below_s, level_s in pairwise(LEVELS_S):
        _roll_up(connection, seconds, below_s, level_s)


def _roll_up(connection: Connection, seconds: Iterable[SecondKey], below_s: int, level_s: int) -> None:
    length_ns = level_s * NS_PER_S
    buckets = sorted({(station, bucket_start(t_gps_ns, length_ns)) for station, t_gps_ns in seconds})
    parameters = [(start, station, below_s, start, start + length_ns) for station, start in buckets]
    if parameters:
        connection.exec_driver_sql(_roll_up_statement(connection.dialect.paramstyle, level_s), parameters)


@cache
def _roll_up_statement(paramstyle: str, level_s: int) -> str:
    mark = "?" if paramstyle == "qmark" else "%s"
    start = mark if paramstyle == "qmark" else "%s::bigint"
    changes = ", ".join(f"{name} = excluded.{name}" for name in ("count", *_COLUMNS))
    return (
        f"INSERT INTO motion_summaries (station, bucket_s, t_gps_ns, count, {', '.join(_COLUMNS)}) "
        f"SELECT station, {level_s}, {start}, {', '.join(aggregates())} FROM motion_summaries "
        f"WHERE station = {mark} AND bucket_s = {mark} AND t_gps_ns >= {mark} AND t_gps_ns < {mark} GROUP BY station "
        f"ON CONFLICT (station, bucket_s, t_gps_ns) DO UPDATE SET {changes}"
    )


@cache
def aggregates() -> tuple[str, ...]:
    """SQL expressions that join several summary rows into one: the count, then every column in order."""
    parts = ["SUM(count)"]
    for channel in CHANNELS:
        weight = f"SUM(CASE WHEN {channel}_mean IS NOT NULL THEN count END)"
        parts += [
            f"MIN({channel}_min)",
            f"MAX({channel}_max)",
            f"SUM({channel}_mean * count) / {weight}",
            f"SQRT(SUM({channel}_rms * {channel}_rms * count) / {weight})",
        ]
    parts += [f"SQRT(SUM({s} * {s} * count) / SUM(CASE WHEN {s} IS NOT NULL THEN count END))" for s in SIGMAS]
    return tuple(parts)
