"""A batch of outputs and checkpoints into the tables, in the caller's transaction."""

import json
import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, select

from plumbline.gps_time import NS_PER_S
from plumbline.records import AlertEvent, Floats, Motion, Output, QualityReport, Solution, StationStatus
from plumbline.store import alert_log, quality_codec, summaries
from plumbline.store.motion_codec import N_CHANNELS, decode, encode, quantised
from plumbline.store.rows import Checkpoint
from plumbline.store.tables import checkpoints as checkpoint_table
from plumbline.store.tables import motion as motion_table
from plumbline.store.tables import quality as quality_table
from plumbline.store.tables import solutions as solution_table
from plumbline.store.tables import station_status
from plumbline.store.upsert import upsert

_UPPER_TRIANGLE = np.triu_indices(3)
_NO_VECTOR = (None, None, None)


def write(connection: Connection, batch: Sequence[Output], checkpoints: Sequence[Checkpoint]) -> int:
    """Store everything; returns the number of records. Rows are keyed by station and event time, replays harmless."""
    solutions = [_solution_row(output) for output in batch if isinstance(output, Solution)]
    upsert(connection, solution_table, solutions)
    reports = [_quality_row(output) for output in batch if isinstance(output, QualityReport)]
    upsert(connection, quality_table, reports)
    _write_motion(connection, [output for output in batch if isinstance(output, Motion)])
    alert_log.apply(connection, [output for output in batch if isinstance(output, AlertEvent)])
    statuses = [_status_row(output) for output in batch if isinstance(output, StationStatus)]
    upsert(connection, station_status, statuses, newer_by="t_receive_ns")
    upsert(connection, checkpoint_table, [_checkpoint_row(c) for c in checkpoints], not_older_by="t_receive_ns")
    return len(batch) + len(checkpoints)


def _number(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else float(value)


def _vector(value: Floats | None) -> tuple[float | None, ...]:
    return (
        _NO_VECTOR if value is None else tuple(None if math.isnan(x) else x for x in np.asarray(value, float).tolist())
    )


def _solution_row(solution: Solution) -> tuple[Any, ...]:
    covariance = solution.covariance_enu_m2
    return (
        solution.station,
        solution.t_gps_ns,
        solution.t_receive_ns,
        solution.status.value,
        solution.reason,
        solution.n_satellites,
        *_vector(solution.position_ecef_m),
        *_vector(solution.displacement_enu_m),
        *((None,) * 6 if covariance is None else _vector(covariance[_UPPER_TRIANGLE])),
        *_vector(solution.velocity_enu_m_s),
        solution.systems,
        _number(solution.zenith_delay_m),
        _number(solution.receiver_clock_s),
        _number(solution.correction_age_s),
        _number(solution.pdop),
        json.dumps(dict(solution.extras), sort_keys=True) if solution.extras else None,
        *_vector(solution.attitude_rad),
        *_vector(solution.sigma_attitude_rad),
    )


def _quality_row(report: QualityReport) -> tuple[Any, ...]:
    return (
        report.station,
        report.t_gps_ns,
        report.t_receive_ns,
        int(report.satellite.size),
        int(np.count_nonzero(report.verdict)),
        _number(report.protection_horizontal_m),
        _number(report.protection_vertical_m),
        quality_codec.encode(report),
    )


def _status_row(status: StationStatus) -> tuple[Any, ...]:
    return (
        status.station,
        status.t_receive_ns,
        status.state,
        status.reason,
        status.last_epoch_gps_ns,
        status.solution_status.value if status.solution_status is not None else None,
        status.n_satellites,
        json.dumps(dict(status.counters), sort_keys=True),
    )


def _checkpoint_row(checkpoint: Checkpoint) -> tuple[Any, ...]:
    consumed = json.dumps(dict(checkpoint.consumed), sort_keys=True)
    return (checkpoint.station, checkpoint.t_receive_ns, checkpoint.state, consumed)


# --------------------------------------------------------------------------------------------- motion


@dataclass(frozen=True, slots=True)
class _Piece:
    """The part of a block that lies within one GPS second."""

    head: Motion
    quanta: NDArray[np.int64]

    @property
    def second(self) -> summaries.SecondKey:
        t_gps_ns = self.head.t_first_gps_ns
        return self.head.station, t_gps_ns - t_gps_ns % NS_PER_S


def _pieces(motion: Motion) -> Iterator[_Piece]:
    """A block cut at whole seconds, so that a stored block never reaches into the next second."""
    n = len(motion.displacement_enu_m)
    if n == 0:
        return
    quanta = quantised(motion)
    times = motion.t_first_gps_ns + motion.interval_ns * np.arange(n, dtype=np.int64)
    cuts = [0, *(np.flatnonzero(np.diff(times // NS_PER_S)) + 1).tolist(), n]
    for begin, end in pairwise(cuts):
        yield _Piece(replace(motion, t_first_gps_ns=int(times[begin])), quanta[:, begin:end])


def _write_motion(connection: Connection, blocks: Sequence[Motion]) -> None:
    newest: dict[tuple[str, int], _Piece] = {}
    for block in blocks:
        for piece in _pieces(block):
            key = piece.head.station, piece.head.t_first_gps_ns
            if key not in newest or piece.head.revision > newest[key].head.revision:
                newest[key] = piece
    if not newest:
        return
    stored = _stored_revisions(connection, newest)
    accepted = {k: p for k, p in newest.items() if k not in stored or p.head.revision > stored[k]}
    upsert(connection, motion_table, [_motion_row(piece) for piece in accepted.values()], newer_by="revision")
    by_second: defaultdict[summaries.SecondKey, list[_Piece]] = defaultdict(list)
    for piece in accepted.values():
        by_second[piece.second].append(piece)
    others = {(station, t - t % NS_PER_S) for station, t in stored if (station, t) not in accepted}
    rows = [
        summaries.second_row(second, _quanta_of(connection, second, pieces, second in others))
        for second, pieces in by_second.items()
    ]
    summaries.write_seconds(connection, rows)


def _stored_revisions(connection: Connection, pieces: dict[tuple[str, int], _Piece]) -> dict[tuple[str, int], int]:
    """(station, first sample's time) → revision of every stored block in the seconds that the pieces lie in."""
    spans: dict[str, tuple[int, int]] = {}
    for piece in pieces.values():
        station, second = piece.second
        low, high = spans.get(station, (second, second))
        spans[station] = min(low, second), max(high, second)
    columns = motion_table.c
    stored: dict[tuple[str, int], int] = {}
    for station, (low, high) in spans.items():
        query = select(columns.t_first_gps_ns, columns.revision).where(
            columns.station == station, columns.t_first_gps_ns >= low, columns.t_first_gps_ns < high + NS_PER_S
        )
        stored.update(((station, t), revision) for t, revision in connection.execute(query))
    return stored


def _quanta_of(
    connection: Connection, second: summaries.SecondKey, pieces: Sequence[_Piece], has_others: bool
) -> NDArray[np.int64]:
    """All quanta of a second, of the channels that every block has: at hand in one new block alone, else read back."""
    if len(pieces) == 1 and not has_others:
        return pieces[0].quanta[:N_CHANNELS]
    columns = motion_table.c
    query = (
        select(columns.samples, columns.n)
        .where(
            columns.station == second[0],
            columns.t_first_gps_ns >= second[1],
            columns.t_first_gps_ns < second[1] + NS_PER_S,
        )
        .order_by(columns.t_first_gps_ns)
    )
    return np.hstack([decode(data, n)[:N_CHANNELS] for data, n in connection.execute(query)])


def _motion_row(piece: _Piece) -> tuple[Any, ...]:
    head = piece.head
    return (
        head.station,
        head.t_first_gps_ns,
        piece.quanta.shape[1],
        head.interval_ns,
        head.t_receive_ns,
        head.status.value,
        head.revision,
        encode(piece.quanta),
        head.reason,
    )
