"""/v1/stations/{station}/quality, /availability and /explain: what solutions are worth, and why there are none."""

from typing import Annotated, Final

from fastapi import HTTPException, Query, Response
from fastapi.responses import JSONResponse

from plumbline.api.parts import NOT_FOUND, Cursor, ExistingStation, Limit, Span, StorePart, new_router
from plumbline.api.quality_schemas import AvailabilityOut, ExplainOut, QualityOut
from plumbline.api.quality_views import availability_view, explain_view, quality_view
from plumbline.api.schemas import Listing
from plumbline.gps_time import DAY_NS, NS_PER_S, gps_minus_utc_s
from plumbline.quality.availability import availability
from plumbline.quality.explain import explain
from plumbline.records import Solution
from plumbline.store import Store

router = new_router("quality")

_MAX_DAYS: Final = 31
_PAGE: Final = 10_000
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
    """Epochs expected, received, solved, converged and fixed by UTC day, at most 31 of them: the last, unless told."""
    name = row.settings.station
    newest, _ = await store.latest(name, 1)
    if not newest:
        return []
    end = span[1] if span[1] is not None else newest[-1].t_gps_ns + NS_PER_S
    start = span[0] if span[0] is not None else _day_of(end - 1)
    days: list[AvailabilityOut] = []
    while start < end and len(days) < _MAX_DAYS:
        until = min(_day_of(start) + DAY_NS, end)
        days.append(availability_view(name, availability(await _solutions(store, name, start, until), start, until)))
        start = until
    return days


def _day_of(t_gps_ns: int) -> int:
    """Start of the UTC day that a time lies in, GPS ns (days with a leap second end a second early)."""
    leap_ns = round(gps_minus_utc_s(t_gps_ns) * NS_PER_S)
    utc_ns = t_gps_ns - leap_ns
    return utc_ns - utc_ns % DAY_NS + leap_ns


async def _solutions(store: Store, name: str, start: int, end: int) -> list[Solution]:
    page = await store.solutions(name, start, end, _PAGE, None)
    solutions = list(page.items)
    while page.next is not None:
        page = await store.solutions(name, start, end, _PAGE, page.next)
        solutions += page.items
    return solutions


@router.get("/stations/{station}/explain", responses=NOT_FOUND)
async def get_explain(row: ExistingStation, store: StorePart, epochs: Epochs = 120) -> ExplainOut:
    """Why the last epochs have no solution or a poor one, and what to do about it."""
    name = row.settings.station
    solutions, reports = await store.latest(name, epochs)
    return explain_view(name, len(solutions), explain(solutions, reports, await store.status(name)))
