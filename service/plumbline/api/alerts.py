"""/v1/alerts: what was raised, who has seen it, what was said of it."""

from typing import Annotated

from fastapi import HTTPException, Query
from fastapi import Path as PathParameter

from plumbline.api.parts import NOT_FOUND, Cursor, Limit, Span, StorePart, new_router
from plumbline.api.problems import not_found
from plumbline.api.schemas import Acknowledgement, AlertOut, Comment, Listing
from plumbline.api.views import alert_view
from plumbline.config import StationId
from plumbline.records import AlertState

router = new_router("alerts")

AlertName = Annotated[
    str, PathParameter(min_length=1, max_length=300, pattern=r"^[^\x00-\x1f\x7f]+$", description="the alert's id")
]


@router.get("/alerts")
async def list_alerts(
    store: StorePart,
    span: Span,
    station: Annotated[StationId | None, Query(description="only this station's")] = None,
    state: Annotated[AlertState | None, Query(description="only those in this state")] = None,
    limit: Limit = 100,
    cursor: Cursor = None,
) -> Listing[AlertOut]:
    """Alerts, the newest activation first, without their histories."""
    try:
        page = await store.alerts(station, state, span[0], span[1], limit, cursor)
    except ValueError as error:
        raise HTTPException(422, f"query.cursor: {error}") from error
    return Listing(items=[alert_view(alert) for alert in page.items], next=page.next)


@router.post("/alerts/{alert_id:path}/acknowledge", responses=NOT_FOUND)
async def acknowledge_alert(alert_id: AlertName, store: StorePart, body: Acknowledgement | None = None) -> AlertOut:
    """Say that an alert is seen. The first time counts; again changes nothing."""
    given = body or Acknowledgement()
    alert = await store.acknowledge(alert_id, given.by, given.comment)
    if alert is None:
        raise not_found("alert", alert_id)
    return alert_view(alert)


@router.post("/alerts/{alert_id:path}/comments", status_code=201, responses=NOT_FOUND)
async def comment_alert(alert_id: AlertName, store: StorePart, body: Comment) -> AlertOut:
    """Add a comment to an alert's history."""
    alert = await store.comment(alert_id, body.by, body.text)
    if alert is None:
        raise not_found("alert", alert_id)
    return alert_view(alert)


@router.get("/alerts/{alert_id:path}", responses=NOT_FOUND)
async def get_alert(alert_id: AlertName, store: StorePart) -> AlertOut:
    """One alert with its history."""
    alert = await store.alert(alert_id)
    if alert is None:
        raise not_found("alert", alert_id)
    return alert_view(alert)
