"""Alerts: their rows follow the events of the rules and what people do; the history keeps both."""

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Connection, Row, and_, insert, or_, select, update

from plumbline.gps_time import gps_ns_from_unix_ns
from plumbline.records import AlertEvent, AlertState, Severity
from plumbline.store.cursors import from_cursor, to_cursor
from plumbline.store.rows import AlertNote, AlertRow, Page
from plumbline.store.tables import alert_history
from plumbline.store.tables import alerts as alert_table
from plumbline.store.upsert import insert_new

_C = alert_table.c


def apply(connection: Connection, events: Sequence[AlertEvent]) -> None:
    """Take events of the rules in; an event that is known changes nothing."""
    for event in events:
        row = {
            "alert_id": event.alert_id,
            "station": event.station,
            "threshold_id": event.threshold_id,
            "quantity": event.quantity,
            "severity": event.severity.value,
            "level": float(event.level),
            "value": float(event.value),
            "text": event.text,
            "t_onset_gps_ns": event.t_onset_gps_ns,
            "t_active_gps_ns": event.t_gps_ns if event.state is AlertState.ACTIVE else event.t_onset_gps_ns,
            "acknowledged_by": "",
        }
        insert_new(connection, alert_table, row)
        mine = _C.alert_id == event.alert_id
        if event.state is AlertState.CLEARED:
            uncleared = and_(mine, _C.t_cleared_gps_ns.is_(None))
            connection.execute(update(alert_table).where(uncleared).values(t_cleared_gps_ns=event.t_gps_ns))
        elif event.state is AlertState.ACKNOWLEDGED:
            unseen = and_(mine, _C.t_acknowledged_gps_ns.is_(None))
            connection.execute(update(alert_table).where(unseen).values(t_acknowledged_gps_ns=event.t_gps_ns))
        note = AlertNote(event.t_gps_ns, event.state.value, "", event.text, float(event.value))
        insert_new(connection, alert_history, _note_row(event.alert_id, note))


def _note_row(alert_id: str, note: AlertNote) -> dict[str, Any]:
    return {
        "alert_id": alert_id,
        "t_gps_ns": note.t_gps_ns,
        "kind": note.kind,
        "by": note.by,
        "text": note.text,
        "value": note.value,
    }


def alerts(
    connection: Connection,
    station: str | None,
    state: str | None,
    start: int | None,
    end: int | None,
    limit: int,
    cursor: str | None,
) -> Page[AlertRow]:
    """A page of alerts, the newest activation first."""
    query = select(alert_table)
    if station is not None:
        query = query.where(_C.station == station)
    if state is not None:
        query = query.where(_in_state(AlertState(state)))
    if start is not None:
        query = query.where(_C.t_active_gps_ns >= start)
    if end is not None:
        query = query.where(_C.t_active_gps_ns < end)
    if cursor is not None:
        t_gps_ns, alert_id = from_cursor(cursor, int, str)
        same_time = and_(_C.t_active_gps_ns == t_gps_ns, _C.alert_id < alert_id)
        query = query.where(or_(_C.t_active_gps_ns < t_gps_ns, same_time))
    query = query.order_by(_C.t_active_gps_ns.desc(), _C.alert_id.desc()).limit(limit + 1)
    rows = connection.execute(query).all()
    items = tuple(_alert(row) for row in rows[:limit])
    more = len(rows) > limit
    return Page(items, to_cursor([items[-1].t_active_gps_ns, items[-1].alert_id]) if more else None)


def _in_state(state: AlertState) -> Any:
    if state is AlertState.CLEARED:
        return _C.t_cleared_gps_ns.is_not(None)
    seen = _C.t_acknowledged_gps_ns.is_not(None)
    return and_(_C.t_cleared_gps_ns.is_(None), seen if state is AlertState.ACKNOWLEDGED else ~seen)


def _alert(row: Row[Any]) -> AlertRow:
    return AlertRow(
        alert_id=row.alert_id,
        station=row.station,
        threshold_id=row.threshold_id,
        quantity=row.quantity,
        severity=Severity(row.severity),
        level=row.level,
        value=row.value,
        text=row.text,
        t_onset_gps_ns=row.t_onset_gps_ns,
        t_active_gps_ns=row.t_active_gps_ns,
        t_acknowledged_gps_ns=row.t_acknowledged_gps_ns,
        acknowledged_by=row.acknowledged_by,
        t_cleared_gps_ns=row.t_cleared_gps_ns,
    )


def alert(connection: Connection, alert_id: str) -> AlertRow | None:
    """One alert with its history in order of time."""
    row = connection.execute(select(alert_table).where(_C.alert_id == alert_id)).first()
    if row is None:
        return None
    columns = alert_history.c
    query = select(alert_history).where(columns.alert_id == alert_id).order_by(columns.t_gps_ns, columns.kind)
    history = tuple(AlertNote(n.t_gps_ns, n.kind, n.by, n.text, n.value) for n in connection.execute(query))
    return replace(_alert(row), history=history)


def acknowledge(connection: Connection, alert_id: str, by: str, text: str) -> AlertRow | None:
    """Mark an alert as seen, once."""
    now = gps_ns_from_unix_ns(time.time_ns())
    unseen = and_(_C.alert_id == alert_id, _C.t_acknowledged_gps_ns.is_(None))
    done = connection.execute(update(alert_table).where(unseen).values(t_acknowledged_gps_ns=now, acknowledged_by=by))
    if done.rowcount:
        insert_new(connection, alert_history, _note_row(alert_id, AlertNote(now, "acknowledged", by, text)))
    return alert(connection, alert_id)


def comment(connection: Connection, alert_id: str, by: str, text: str) -> AlertRow | None:
    """Add a comment at the present time."""
    if alert(connection, alert_id) is None:
        return None
    note = AlertNote(gps_ns_from_unix_ns(time.time_ns()), "comment", by, text)
    connection.execute(insert(alert_history).values(_note_row(alert_id, note)))
    return alert(connection, alert_id)


def close_open(connection: Connection, station: str, threshold_id: str, why: str) -> None:
    """Clear the alerts of a threshold that nobody judges any more, at the present time."""
    now = gps_ns_from_unix_ns(time.time_ns())
    mine = and_(_C.station == station, _C.threshold_id == threshold_id)
    is_open = and_(mine, _C.t_cleared_gps_ns.is_(None))
    for alert_id in connection.execute(select(_C.alert_id).where(is_open)).scalars().all():
        insert_new(connection, alert_history, _note_row(alert_id, AlertNote(now, "cleared", "", why)))
    connection.execute(update(alert_table).where(is_open).values(t_cleared_gps_ns=now))


def open_events(connection: Connection, station: str) -> tuple[AlertEvent, ...]:
    """The activations of a station's alerts that are not cleared, the oldest first."""
    query = select(alert_table).where(_C.station == station, _C.t_cleared_gps_ns.is_(None))
    return tuple(
        AlertEvent(
            alert_id=row.alert_id,
            station=row.station,
            threshold_id=row.threshold_id,
            state=AlertState.ACTIVE,
            severity=Severity(row.severity),
            t_gps_ns=row.t_active_gps_ns,
            t_onset_gps_ns=row.t_onset_gps_ns,
            t_receive_ns=row.t_active_gps_ns,
            quantity=row.quantity,
            value=row.value,
            level=row.level,
            text=row.text,
        )
        for row in connection.execute(query.order_by(_C.t_active_gps_ns, _C.alert_id))
    )
