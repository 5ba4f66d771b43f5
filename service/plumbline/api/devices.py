"""/v1/devices: devices that talked to the server without being known, and their adoption."""

from typing import Annotated

from fastapi import HTTPException
from fastapi import Path as PathParameter

from plumbline.api.parts import CONFLICT, NOT_FOUND, ControlPart, StorePart, new_router
from plumbline.api.problems import not_found
from plumbline.api.schemas import Adoption, Listing, UnknownDevice
from plumbline.api.views import device_id, device_view
from plumbline.store import Device

router = new_router("devices")

DeviceName = Annotated[str, PathParameter(pattern=r"^[0-9a-f]{16}$", description="the device's `device_id`")]


async def _devices(store: StorePart, control: ControlPart) -> list[Device]:
    """Those of now and those of before, the last seen first; a device of now is as it is now."""
    found = {device.identity: device for device in await store.devices()}
    for device in await control.devices():
        stored = found.get(device.identity)
        adopted = stored.station if stored is not None else None
        found[device.identity] = Device(
            identity=device.identity,
            address=device.address,
            first_seen_gps_ns=min(device.first_seen_gps_ns, stored.first_seen_gps_ns)
            if stored is not None
            else device.first_seen_gps_ns,
            last_seen_gps_ns=device.last_seen_gps_ns,
            attempts=device.attempts,
            reason=device.reason,
            station=device.station or adopted,
        )
    return sorted(found.values(), key=lambda device: (-device.last_seen_gps_ns, device.identity))


@router.get("/devices")
async def list_devices(store: StorePart, control: ControlPart) -> Listing[UnknownDevice]:
    """Devices that were turned away because nobody knows them, the last seen first."""
    return Listing(items=[device_view(device) for device in await _devices(store, control)])


@router.post("/devices/{device}/adopt", responses=NOT_FOUND | CONFLICT)
async def adopt_device(device: DeviceName, body: Adoption, store: StorePart, control: ControlPart) -> UnknownDevice:
    """Make a device a station's: its identity becomes one of the station's registrations."""
    found = next((one for one in await _devices(store, control) if device_id(one.identity) == device), None)
    if found is None:
        raise not_found("device", device)
    row = await store.station(body.station)
    if row is None:
        raise not_found("station", body.station)
    settings = row.settings
    if found.identity not in settings.device.registrations:
        registrations = (*settings.device.registrations, found.identity)
        changed = settings.device.model_copy(update={"registrations": registrations})
        settings = settings.model_copy(update={"device": changed})
        if await store.change_station(settings, row.version) is None:
            raise HTTPException(409, "the station was changed at the same moment; try again")
    adopted = await store.adopt_device(found, body.station)
    await control.station_changed(body.station, settings)
    return device_view(adopted)
