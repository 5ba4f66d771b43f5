"""/v1/thresholds: when a quantity of a station is alarming."""

from typing import Annotated

from fastapi import HTTPException, Query, Response
from fastapi import Path as PathParameter

from plumbline.alerts.quantities import QUANTITIES
from plumbline.api.parts import CONFLICT, NOT_FOUND, ControlPart, StorePart, new_router
from plumbline.api.problems import not_found
from plumbline.api.schemas import Listing, ThresholdChange, ThresholdCreate, ThresholdOut
from plumbline.api.units import to_si, unit_of_quantity
from plumbline.api.views import threshold_view
from plumbline.config import StationId
from plumbline.records import Threshold

router = new_router("thresholds")

ThresholdName = Annotated[StationId, PathParameter(description="the threshold's id")]


def to_threshold(body: ThresholdCreate) -> Threshold:
    """A threshold in SI units."""
    if body.quantity not in QUANTITIES:
        raise HTTPException(422, f"body.quantity: {body.quantity!r} is none of {', '.join(QUANTITIES)}")
    _, unit = unit_of_quantity(body.quantity)
    if body.unit is not None and body.unit != unit:
        raise HTTPException(422, f"body.unit: the unit of {body.quantity!r} is {unit!r}")
    if body.dead_band > abs(body.level) > 0:
        raise HTTPException(422, "body.dead_band: wider than the level, so that the alert could never clear")
    return Threshold(
        threshold_id=body.threshold_id,
        station=body.station,
        quantity=body.quantity,
        level=to_si(body.quantity, body.level),
        severity=body.severity,
        on_delay_s=body.on_delay_s,
        off_delay_s=body.off_delay_s,
        dead_band=to_si(body.quantity, body.dead_band),
        enabled=body.enabled,
    )


async def _tell(store: StorePart, control: ControlPart, station: str) -> None:
    await control.thresholds_changed(station, await store.thresholds(station))


@router.get("/thresholds")
async def list_thresholds(
    store: StorePart, station: Annotated[StationId | None, Query(description="only this station's")] = None
) -> Listing[ThresholdOut]:
    """All thresholds by id."""
    return Listing(items=[threshold_view(threshold) for threshold in await store.thresholds(station)])


@router.post("/thresholds", status_code=201, responses=NOT_FOUND | CONFLICT)
async def create_threshold(
    body: ThresholdCreate, store: StorePart, control: ControlPart, response: Response
) -> ThresholdOut:
    """Add a threshold to a station; 409 when its id is taken."""
    threshold = to_threshold(body)
    if await store.station(body.station) is None:
        raise not_found("station", body.station)
    if not await store.create_threshold(threshold):
        raise HTTPException(409, f"there is a threshold {body.threshold_id!r} already")
    await _tell(store, control, threshold.station)
    response.headers["Location"] = f"/v1/thresholds/{body.threshold_id}"
    return threshold_view(threshold)


@router.get("/thresholds/{threshold_id}", responses=NOT_FOUND)
async def get_threshold(threshold_id: ThresholdName, store: StorePart) -> ThresholdOut:
    """One threshold."""
    return threshold_view(await _existing(threshold_id, store))


async def _existing(threshold_id: str, store: StorePart) -> Threshold:
    threshold = await store.threshold(threshold_id)
    if threshold is None:
        raise not_found("threshold", threshold_id)
    return threshold


@router.patch("/thresholds/{threshold_id}", responses=NOT_FOUND)
async def change_threshold(
    threshold_id: ThresholdName, body: ThresholdChange, store: StorePart, control: ControlPart
) -> ThresholdOut:
    """Change some of a threshold's fields. A new quantity of another unit needs a new level and dead band."""
    before = threshold_view(await _existing(threshold_id, store))
    changes = body.model_dump(exclude_unset=True, exclude_none=True)
    quantity = changes.get("quantity", before.quantity)
    if unit_of_quantity(quantity)[1] != before.unit and not {"level", "dead_band"} <= changes.keys():
        raise HTTPException(422, "body.quantity: of another unit than before; give level and dead_band with it")
    values = before.model_dump(exclude={"unit"}) | changes
    threshold = to_threshold(ThresholdCreate.model_validate(values))
    if not await store.change_threshold(threshold):
        raise not_found("threshold", threshold_id)
    await _tell(store, control, threshold.station)
    return threshold_view(threshold)


@router.delete("/thresholds/{threshold_id}", status_code=204, responses=NOT_FOUND)
async def delete_threshold(threshold_id: ThresholdName, store: StorePart, control: ControlPart) -> None:
    """Remove a threshold."""
    threshold = await _existing(threshold_id, store)
    await store.delete_threshold(threshold_id)
    await _tell(store, control, threshold.station)
