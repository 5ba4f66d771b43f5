"""/v1/stations/{station}/quality, /availability and /explain: what solutions are worth, and why there are none."""

import time
from typing import Annotated, Final

from fastapi import HTTPException, Query, Response
from fastapi.responses import JSONResponse

from plumbline.api.parts import NOT_FOUND, Cursor, ExistingStation, Limit, Span, StorePart, new_router
from plumbline.api.quality_schemas import AvailabilityOut, ExplainOut, QualityOut
from plumbline.api.quality_views import availability_view, explain_view, quality_view
from plumbline.api.schemas import Listing
from plumbline.gps_time import DAY_NS, NS_PER_S, gps_ns_from_unix_ns
from plumbline.quality.availability import availability, day_start_ns
from plumbline.quality.explain import explain
from plumbline.store import StationRow, Store

router = new_router("quality")

_MAX_DAYS: Final = 31
_ON_ITS_WAY_NS: Final = 5 * NS_PER_S  # an epoch younger than that is not missed yet
Epochs = Annotated[int, Query(ge=1, le=3600, description="how many of the last epochs to look at")]


@router.get("/stations/{station}/quality", response_model=Listing[QualityOut], responses=NOT_FOUND)
async def get_quality(
    row: ExistingStation, store: StorePart, span: Span, limit: Limit = 100, cursor: Cursor = None
) -> Response:
    """Quality reports, one an epoch, in order of time."""
    try:
        page = await store.quality(row.settings.station, span[0], span[1], limit, cursor)
    except ValueError as error:
        raise HTTPException(422, f"query.cursor: {error}") from error
    return JSONResponse({"items": [quality_view(report) for report in page.items], "next": page.next})


@router.get("/stations/{station}/availability", responses=NOT_FOUND)
async def get_availability(row: ExistingStation, store: StorePart, span: Span) -> list[AvailabilityOut]:
    """Epochs expected, received, solved, converged and fixed by UTC day, at most 31 of them.

    Unless told, from the last day that has epochs up to now. Days that are over are kept when their epochs are not.
    """
    name = row.settings.station
    start, end = await _span(store, row, span)
    kept = await store.days(name, start, end)
    downtimes = await store.downtimes()
    days: list[AvailabilityOut] = []
    while start < end and len(days) < _MAX_DAYS:
        until = min(day_start_ns(start) + DAY_NS, end)
        day = kept.get(start)
        if day is None or day.t_end_gps_ns != until:
            day = availability(await store.epoch_marks(name, start, until), start, until, downtimes)
        days.append(availability_view(name, day))
        start = until
    return days


async def _span(store: Store, row: StationRow, span: tuple[int | None, int | None]) -> tuple[int, int]:
    """The span asked for; unless told, from the last day that has epochs up to now: a silence shows while it lasts.

    A recording's time ends with its last epoch.
    """
    now = gps_ns_from_unix_ns(time.time_ns())
    newest = await store.latest_solution(row.settings.station)
    if newest is None:
        last, begin = row.created_gps_ns, row.created_gps_ns
    else:
        last, begin = newest.t_gps_ns, day_start_ns(newest.t_gps_ns)
        begin = max(begin, row.created_gps_ns) if row.created_gps_ns <= last else begin
    is_live = abs(now - last) < _MAX_DAYS * DAY_NS
    end = max(now - _ON_ITS_WAY_NS, last + 1) if is_live else last + NS_PER_S
    return span[0] if span[0] is not None else begin, span[1] if span[1] is not None else end


@router.get("/stations/{station}/explain", responses=NOT_FOUND)
async def get_explain(row: ExistingStation, store: StorePart, epochs: Epochs = 120) -> ExplainOut:
    """Why the last epochs have no solution or a poor one, and what to do about it."""
    name = row.settings.station
    solutions, reports = await store.latest(name, epochs)
    return explain_view(name, len(solutions), explain(solutions, reports, await store.status(name)))
