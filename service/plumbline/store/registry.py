"""Stations, thresholds, status, devices and checkpoints."""

import json
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Connection, Row, delete, select, update

from plumbline.config import StationSettings
from plumbline.gps_time import gps_ns_from_unix_ns
from plumbline.records import Severity, StationStatus, Status, Threshold
from plumbline.store import alert_log, tables
from plumbline.store.cursors import from_cursor, to_cursor
from plumbline.store.rows import Checkpoint, Device, Page, StationRow
from plumbline.store.upsert import insert_new, upsert

_S = tables.stations.c
_T = tables.thresholds.c
_D = tables.devices.c


def _now_gps_ns() -> int:
    return gps_ns_from_unix_ns(time.time_ns())


# --------------------------------------------------------------------------------------------- stations


def stations(connection: Connection, limit: int | None, cursor: str | None) -> Page[StationRow]:
    """Stations by id, all or a page."""
    query = select(tables.stations).order_by(_S.station)
    if cursor is not None:
        query = query.where(_S.station > from_cursor(cursor, str)[0])
    if limit is not None:
        query = query.limit(limit + 1)
    rows = connection.execute(query).all()
    more = limit is not None and len(rows) > limit
    items = tuple(_station(row) for row in rows[:limit])
    return Page(items, to_cursor([items[-1].settings.station]) if more else None)


def station(connection: Connection, name: str) -> StationRow | None:
    """One station."""
    row = connection.execute(select(tables.stations).where(_S.station == name)).first()
    return None if row is None else _station(row)


def _station(row: Row[Any]) -> StationRow:
    settings = StationSettings.model_validate_json(row.settings)
    return StationRow(settings, row.version, row.created_gps_ns, row.changed_gps_ns)


def create_station(connection: Connection, settings: StationSettings) -> StationRow | None:
    """Add a station with no past: a checkpoint of an earlier one of the id would not fit it."""
    now = _now_gps_ns()
    row = {
        "station": settings.station,
        "settings": settings.model_dump_json(),
        "version": 1,
        "created_gps_ns": now,
        "changed_gps_ns": now,
    }
    if not insert_new(connection, tables.stations, row):
        return None
    for table in (tables.checkpoints, tables.station_status):
        connection.execute(delete(table).where(table.c.station == settings.station))
    return StationRow(settings, 1, now, now)


def change_station(
    connection: Connection, settings: StationSettings, expected_version: int | None
) -> StationRow | None:
    """Replace settings and count the version up."""
    change = update(tables.stations).where(_S.station == settings.station)
    if expected_version is not None:
        change = change.where(_S.version == expected_version)
    values = {"settings": settings.model_dump_json(), "version": _S.version + 1, "changed_gps_ns": _now_gps_ns()}
    done = connection.execute(change.values(values))
    return station(connection, settings.station) if done.rowcount else None


def delete_station(connection: Connection, name: str, purge: bool) -> bool:
    """Remove a station, and with ``purge`` everything that was ever stored of it."""
    if not connection.execute(delete(tables.stations).where(_S.station == name)).rowcount:
        return False
    for one in thresholds(connection, name):
        delete_threshold(connection, one.threshold_id)
    for table in (tables.station_status, tables.checkpoints):
        connection.execute(delete(table).where(table.c.station == name))
    connection.execute(update(tables.devices).where(_D.station == name).values(station=None))
    if purge:
        ids = select(tables.alerts.c.alert_id).where(tables.alerts.c.station == name)
        connection.execute(delete(tables.alert_history).where(tables.alert_history.c.alert_id.in_(ids)))
        results = (tables.solutions, tables.quality, tables.motion, tables.motion_summaries, tables.availability)
        for table in (tables.alerts, *results):
            connection.execute(delete(table).where(table.c.station == name))
    return True


def seed(connection: Connection, settings: Sequence[StationSettings], some_thresholds: Sequence[Threshold]) -> None:
    """Add what is not there yet."""
    for one in settings:
        create_station(connection, one)
    for threshold_ in some_thresholds:
        create_threshold(connection, threshold_)


# --------------------------------------------------------------------------------------------- thresholds


def _threshold_row(threshold: Threshold) -> dict[str, Any]:
    return {
        "threshold_id": threshold.threshold_id,
        "station": threshold.station,
        "quantity": threshold.quantity,
        "level": threshold.level,
        "severity": threshold.severity.value,
        "on_delay_s": threshold.on_delay_s,
        "off_delay_s": threshold.off_delay_s,
        "dead_band": threshold.dead_band,
        "enabled": int(threshold.enabled),
    }


def _threshold(row: Row[Any]) -> Threshold:
    return Threshold(
        row.threshold_id,
        row.station,
        row.quantity,
        row.level,
        Severity(row.severity),
        row.on_delay_s,
        row.off_delay_s,
        row.dead_band,
        bool(row.enabled),
    )


def thresholds(connection: Connection, name: str | None) -> tuple[Threshold, ...]:
    """Thresholds of a station or of all, by id."""
    query = select(tables.thresholds).order_by(_T.threshold_id)
    if name is not None:
        query = query.where(_T.station == name)
    return tuple(_threshold(row) for row in connection.execute(query))


def threshold(connection: Connection, threshold_id: str) -> Threshold | None:
    """One threshold."""
    row = connection.execute(select(tables.thresholds).where(_T.threshold_id == threshold_id)).first()
    return None if row is None else _threshold(row)


def create_threshold(connection: Connection, new: Threshold) -> bool:
    """Add a threshold unless its id is taken."""
    return insert_new(connection, tables.thresholds, _threshold_row(new))


def change_threshold(connection: Connection, changed: Threshold) -> bool:
    """Replace a threshold; one that is disabled or of another quantity now leaves no alert active."""
    before = threshold(connection, changed.threshold_id)
    if before is not None and (not changed.enabled or before.quantity != changed.quantity):
        alert_log.close_open(connection, before.station, changed.threshold_id, "the threshold was changed")
    query = update(tables.thresholds).where(_T.threshold_id == changed.threshold_id).values(_threshold_row(changed))
    return bool(connection.execute(query).rowcount)


def delete_threshold(connection: Connection, threshold_id: str) -> bool:
    """Remove a threshold, and clear its alerts: nobody judges them any more."""
    before = threshold(connection, threshold_id)
    if before is not None:
        alert_log.close_open(connection, before.station, threshold_id, "the threshold was removed")
    return bool(connection.execute(delete(tables.thresholds).where(_T.threshold_id == threshold_id)).rowcount)


# --------------------------------------------------------------------------------------------- status, checkpoints


def statuses(connection: Connection, names: Sequence[str] | None) -> dict[str, StationStatus]:
    """Newest status by station."""
    query = select(tables.station_status)
    if names is not None:
        query = query.where(tables.station_status.c.station.in_(names))
    return {row.station: _status(row) for row in connection.execute(query)}


def _status(row: Row[Any]) -> StationStatus:
    return StationStatus(
        row.station,
        row.t_receive_ns,
        row.state,
        row.reason,
        row.last_epoch_gps_ns,
        Status(row.solution_status) if row.solution_status else None,
        row.n_satellites,
        json.loads(row.counters),
    )


def checkpoint(connection: Connection, name: str) -> Checkpoint | None:
    """A station's last checkpoint."""
    row = connection.execute(select(tables.checkpoints).where(tables.checkpoints.c.station == name)).first()
    if row is None:
        return None
    return Checkpoint(row.station, row.t_receive_ns, bytes(row.state), json.loads(row.consumed))


# --------------------------------------------------------------------------------------------- devices


def devices(connection: Connection) -> tuple[Device, ...]:
    """All devices, the one seen last first."""
    query = select(tables.devices).order_by(_D.last_seen_gps_ns.desc(), _D.identity)
    return tuple(Device(*row) for row in connection.execute(query))


def save_devices(connection: Connection, seen: Sequence[Device]) -> None:
    """Remember devices; first sight and adoption of a known one stay."""
    known = {device.identity: device for device in devices(connection)}
    rows = []
    for device in seen:
        before = known.get(device.identity, device)
        first = min(before.first_seen_gps_ns, device.first_seen_gps_ns)
        merged = replace(device, first_seen_gps_ns=first, station=device.station or before.station)
        known[device.identity] = merged
        rows.append(_device_row(merged))
    upsert(connection, tables.devices, rows)


def _device_row(device: Device) -> tuple[Any, ...]:
    times = device.first_seen_gps_ns, device.last_seen_gps_ns
    return (device.identity, device.address, *times, device.attempts, device.reason, device.station)


def adopt_device(connection: Connection, device: Device, name: str) -> Device:
    """Note whose device it is, whether or not it was remembered before."""
    adopted = replace(device, station=name)
    upsert(connection, tables.devices, [_device_row(adopted)])
    return adopted
