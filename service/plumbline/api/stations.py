"""/v1/stations: create, list, get, change, delete, and the present status."""

import json
from typing import Annotated, Any

from fastapi import Body, Header, HTTPException, Query, Response
from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError

from plumbline.api.parts import (
    CONFLICT,
    NOT_FOUND,
    ControlPart,
    Cursor,
    ExistingStation,
    Limit,
    StationName,
    StorePart,
    new_router,
)
from plumbline.api.problems import not_found
from plumbline.api.schemas import Listing, StationCreate, StationOut, StatusOut
from plumbline.api.units import ecef_of_degrees
from plumbline.api.views import station_view, status_view
from plumbline.config import StationSettings
from plumbline.store import StationRow

router = new_router("stations")

_DEGREES = ("latitude_deg", "longitude_deg", "height_m")
_PATCH = Body(
    description="JSON merge patch (RFC 7396) of the settings: null takes a field back to its default",
    openapi_examples={
        "rename": {"value": {"name": "North tower"}},
        "nested": {"value": {"device": {"registrations": ["866123456789012"]}}},
    },
)


def to_settings(body: StationCreate) -> StationSettings:
    """Settings of a request, a position in degrees made Earth-fixed."""
    values = body.model_dump(exclude=set(_DEGREES))
    if body.latitude_deg is not None and body.longitude_deg is not None and body.height_m is not None:
        values["reference_position_ecef_m"] = ecef_of_degrees(body.latitude_deg, body.longitude_deg, body.height_m)
    return StationSettings.model_validate(values)


@router.get("/stations")
async def list_stations(store: StorePart, limit: Limit = 100, cursor: Cursor = None) -> Listing[StationOut]:
    """Stations in order of their ids, each with its status."""
    try:
        page = await store.stations_page(limit, cursor)
    except ValueError as error:
        raise HTTPException(422, f"query.cursor: {error}") from error
    statuses = await store.statuses([row.settings.station for row in page.items])
    items = [station_view(row, statuses.get(row.settings.station)) for row in page.items]
    return Listing(items=items, next=page.next)


@router.post("/stations", status_code=201, responses=CONFLICT)
async def create_station(body: StationCreate, store: StorePart, control: ControlPart, response: Response) -> StationOut:
    """Add a station; 409 when its id is taken."""
    row = await store.create_station(to_settings(body))
    if row is None:
        raise HTTPException(409, f"there is a station {body.station!r} already")
    await control.station_changed(body.station, row.settings)
    response.headers["Location"] = f"/v1/stations/{body.station}"
    return _with_etag(row, station_view(row, None), response)


def _with_etag(row: StationRow, view: StationOut, response: Response) -> StationOut:
    response.headers["ETag"] = f'"{row.version}"'
    return view


@router.get("/stations/{station}", responses=NOT_FOUND)
async def get_station(row: ExistingStation, store: StorePart, response: Response) -> StationOut:
    """A station's settings and status."""
    return _with_etag(row, station_view(row, await store.status(row.settings.station)), response)


@router.patch("/stations/{station}", responses=NOT_FOUND | CONFLICT)
async def change_station(
    row: ExistingStation,
    patch: Annotated[dict[str, Any], _PATCH],
    store: StorePart,
    control: ControlPart,
    response: Response,
    if_match: Annotated[str | None, Header(description="the ETag that the change is based on")] = None,
) -> StationOut:
    """Change settings; 412 when the station has changed since the given ETag, 409 when it changes at this moment."""
    name = row.settings.station
    if if_match is not None and if_match.strip() not in ("*", f'"{row.version}"'):
        raise HTTPException(412, f"the station is at version {row.version}")
    settings = _patched(row.settings, patch)
    changed = await store.change_station(settings, row.version)
    if changed is None:
        raise HTTPException(409, "the station was changed or deleted at the same moment; read it and try again")
    await control.station_changed(name, settings)
    return _with_etag(changed, station_view(changed, await store.status(name)), response)


def _patched(settings: StationSettings, patch: dict[str, Any]) -> StationSettings:
    if patch.get("station", settings.station) != settings.station:
        raise HTTPException(422, "body.station: an id cannot be changed; create another station")
    values = settings.model_dump(mode="json")
    if any(patch.get(name) is not None for name in _DEGREES):
        values.pop("reference_position_ecef_m")
    try:
        return to_settings(StationCreate.model_validate_json(json.dumps(merge_patch(values, patch))))
    except ValidationError as error:
        raise RequestValidationError([{**item, "loc": ("body", *item["loc"])} for item in error.errors()]) from error


def merge_patch(target: Any, patch: Any) -> Any:
    """RFC 7396: members of ``patch`` replace those of ``target``, null removes, objects merge."""
    if not isinstance(patch, dict):
        return patch
    merged = dict(target) if isinstance(target, dict) else {}
    for name, value in patch.items():
        if value is None:
            merged.pop(name, None)
        else:
            merged[name] = merge_patch(merged.get(name), value)
    return merged


@router.delete("/stations/{station}", status_code=204, responses=NOT_FOUND)
async def delete_station(
    station: StationName,
    store: StorePart,
    control: ControlPart,
    purge: Annotated[bool, Query(description="delete every stored result of it, too")] = False,
) -> None:
    """Remove a station with its thresholds; its results stay unless purged."""
    if not await store.delete_station(station, purge):
        raise not_found("station", station)
    await control.station_changed(station, None)


@router.get("/stations/{station}/status", responses=NOT_FOUND)
async def get_status(row: ExistingStation, store: StorePart) -> StatusOut:
    """What a station is doing, and what keeps it from doing better."""
    name = row.settings.station
    return status_view(name, await store.status(name), row.settings.silent_after_s)
