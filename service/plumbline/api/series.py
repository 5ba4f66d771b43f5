"""/v1/stations/{station}/solutions and /motion: series by time, as JSON, CSV or (samples) MiniSEED."""

import asyncio
from enum import StrEnum
from typing import Annotated, Any, Final

from fastapi import HTTPException, Query, Request, Response

from plumbline.api import formats
from plumbline.api.formats import Format
from plumbline.api.parts import NOT_FOUND, Cursor, ExistingStation, Limit, Span, StorePart, new_router
from plumbline.api.schemas import Listing, MotionOut, SolutionOut
from plumbline.api.views import next_start, series_view, solution_view
from plumbline.gps_time import DAY_NS, NS_PER_S
from plumbline.records import Solution
from plumbline.store import MotionSeries, Page

router = new_router("series")

MAX_POINTS: Final = 100_000


class Resolution(StrEnum):
    """How finely motion is asked for."""

    AUTO = "auto"
    SAMPLES = "samples"
    SECOND = "1s"
    MINUTE = "1min"
    HOUR = "1h"
    DAY = "1d"


_BUCKET_NS: Final = {
    Resolution.AUTO: None,
    Resolution.SAMPLES: 0,
    Resolution.SECOND: NS_PER_S,
    Resolution.MINUTE: 60 * NS_PER_S,
    Resolution.HOUR: 3600 * NS_PER_S,
    Resolution.DAY: DAY_NS,
}
AskedFormat = Annotated[Format | None, Query(alias="format", description="instead of the Accept header")]
MaxPoints = Annotated[int, Query(ge=1, le=MAX_POINTS, description="never more points than this")]


@router.get(
    "/stations/{station}/solutions",
    response_model=Listing[SolutionOut],
    responses=NOT_FOUND | formats.responses("Solutions in order of time.", Format.CSV),
)
async def get_solutions(
    request: Request,
    row: ExistingStation,
    store: StorePart,
    span: Span,
    limit: Limit = 1000,
    cursor: Cursor = None,
    asked: AskedFormat = None,
) -> Response:
    """Solutions in order of time; as CSV the part that follows is in the Link header."""
    form = formats.choose(request, asked, Format.JSON, Format.CSV)
    try:
        page = await store.solutions(row.settings.station, span[0], span[1], limit, cursor)
    except ValueError as error:
        raise HTTPException(422, f"query.cursor: {error}") from error
    data = await asyncio.to_thread(_solution_bytes, page, form)
    return formats.response(form, data, formats.link_to_next(request, cursor=page.next))


def _solution_bytes(page: Page[Solution], form: Format) -> bytes:
    items = [solution_view(solution) for solution in page.items]
    if form is Format.JSON:
        return formats.json_bytes({"items": items, "next": page.next})
    names = [name for name in SolutionOut.model_fields if name != "extras"]
    return formats.csv_bytes(names, ([item[name] for name in names] for item in items))


@router.get(
    "/stations/{station}/motion",
    response_model=MotionOut,
    responses=NOT_FOUND | formats.responses("Motion in columns.", Format.CSV, Format.MINISEED),
)
async def get_motion(
    request: Request,
    row: ExistingStation,
    store: StorePart,
    span: Span,
    resolution: Resolution = Resolution.AUTO,
    max_points: MaxPoints = 2000,
    asked: AskedFormat = None,
) -> Response:
    """Motion of a span. `auto`: samples where `max_points` suffice, else the finest intervals with which they do.

    An explicit resolution gives the first `max_points` points; `next_start` and the Link header say where to
    read on. MiniSEED holds samples in SI units whatever the resolution.
    """
    form = formats.choose(request, asked, Format.JSON, Format.CSV, Format.MINISEED)
    bucket_ns = 0 if form is Format.MINISEED else _BUCKET_NS[resolution]
    series = await store.motion(row.settings.station, span[0], span[1], max_points, bucket_ns)
    data = await asyncio.to_thread(_motion_bytes, series, form)
    return formats.response(form, data, formats.link_to_next(request, start=next_start(series)))


def _motion_bytes(series: MotionSeries, form: Format) -> bytes:
    if form is Format.MINISEED:
        return formats.miniseed_bytes(series)
    view = series_view(series)
    if form is Format.JSON:
        return formats.json_bytes(view)
    columns: dict[str, Any] = {name: values for name, values in view.items() if isinstance(values, list)}
    del columns["blocks"]
    return formats.csv_bytes(columns, zip(*columns.values(), strict=True))
