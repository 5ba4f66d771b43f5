"""What routes are given: the server's parts, and the query parameters that several share."""

from typing import Annotated, Any, Final

from fastapi import APIRouter, Depends, HTTPException, Query, Request
from fastapi import Path as PathParameter

from plumbline.api.control import Control
from plumbline.api.feed import Feed
from plumbline.api.problems import not_found, refuse_odd_json, refuse_unknown_query
from plumbline.api.units import Moment, gps_ns
from plumbline.config import StationId
from plumbline.store import StationRow, Store

MAX_PAGE: Final = 10_000


def _problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    content = {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
    return {status: {"description": "a problem document (RFC 9457)", "content": content} for status in statuses}


NOT_FOUND: Final = _problems(404)
CONFLICT: Final = _problems(409)


def new_router(tag: str) -> APIRouter:
    """A router whose requests are checked at the door."""
    doors = [Depends(refuse_unknown_query), Depends(refuse_odd_json)]
    return APIRouter(prefix="/v1", tags=[tag], dependencies=doors, responses=_problems(422, 503))


def _store(request: Request) -> Store:
    store: Store = request.app.state.store
    return store


def _feed(request: Request) -> Feed:
    feed: Feed = request.app.state.feed
    return feed


def _control(request: Request) -> Control:
    control: Control = request.app.state.control
    return control


StorePart = Annotated[Store, Depends(_store)]
FeedPart = Annotated[Feed, Depends(_feed)]
ControlPart = Annotated[Control, Depends(_control)]
StationName = Annotated[StationId, PathParameter(description="the station's id")]
Limit = Annotated[int, Query(ge=1, le=MAX_PAGE, description="at most this many")]
Cursor = Annotated[str | None, Query(max_length=500, description="`next` of the part before")]


async def _row(station: StationName, store: StorePart) -> StationRow:
    row = await store.station(station)
    if row is None:
        raise not_found("station", station)
    return row


#: The station that the address names; 404 where there is none.
ExistingStation = Annotated[StationRow, Depends(_row)]


def _span(
    start: Annotated[Moment | None, Query(description="ISO 8601 with a zone; left out: from the first on")] = None,
    end: Annotated[Moment | None, Query(description="ISO 8601 with a zone, exclusive; left out: all")] = None,
) -> tuple[int | None, int | None]:
    if start is not None and end is not None and end < start:
        raise HTTPException(422, "query.end lies before query.start")
    return gps_ns(start), gps_ns(end)


#: start and end of a span, GPS ns.
Span = Annotated[tuple[int | None, int | None], Depends(_span)]
