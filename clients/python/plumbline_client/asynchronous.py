"""The asynchronous client: REST, and the live stream with automatic resumption."""

import asyncio
import json
from collections.abc import AsyncIterator, Mapping, Sequence
from datetime import datetime
from typing import Any, Self

import httpx
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake

from plumbline_client.errors import checked
from plumbline_client.requests import PAGE, Body, alert_path, clean, station_path, stream_url, threshold_path
from plumbline_client.series import Columns, motion_columns, solution_columns

_FIRST_PAUSE_S = 0.2
_LONGEST_PAUSE_S = 10.0


class AsyncClient:
    """A connection to a server. Every method raises :class:`PlumblineError` for what the server refuses."""

    def __init__(self, base_url: str, timeout_s: float = 30.0) -> None:
        self._base_url = base_url
        self._http = httpx.AsyncClient(base_url=base_url, timeout=timeout_s)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connection."""
        await self._http.aclose()

    async def _get(self, path: str, **parameters: Any) -> Any:
        return checked(await self._http.get(path, params=clean(parameters))).json()

    async def _send(self, method: str, path: str, body: Mapping[str, Any] | None = None) -> Any:
        response = checked(await self._http.request(method, path, json=body))
        return response.json() if response.content else None

    async def _all(self, path: str, **parameters: Any) -> list[Body]:
        items: list[Body] = []
        cursor = None
        while True:
            page = await self._get(path, cursor=cursor, limit=PAGE, **parameters)
            items += page["items"]
            cursor = page["next"]
            if cursor is None:
                return items

    async def stations(self) -> list[Body]:
        """Every station with its status."""
        return await self._all("/v1/stations")

    async def station(self, station: str) -> Body:
        """One station."""
        return dict(await self._get(station_path(station)))

    async def create_station(self, settings: Mapping[str, Any]) -> Body:
        """Add a station; the position as ``latitude_deg, longitude_deg, height_m`` or ``reference_position_ecef_m``."""
        return dict(await self._send("POST", "/v1/stations", settings))

    async def change_station(self, station: str, patch: Mapping[str, Any]) -> Body:
        """Change settings by a JSON merge patch."""
        return dict(await self._send("PATCH", station_path(station), patch))

    async def delete_station(self, station: str, purge: bool = False) -> None:
        """Remove a station (``purge``: with every result)."""
        checked(await self._http.delete(station_path(station), params=clean({"purge": purge})))

    async def status(self, station: str) -> Body:
        """What a station is doing."""
        return dict(await self._get(station_path(station, "status")))

    async def solutions(self, station: str, start: datetime | None = None, end: datetime | None = None) -> Columns:
        """All solutions of a span."""
        return solution_columns(await self._all(station_path(station, "solutions"), start=start, end=end))

    async def motion(
        self,
        station: str,
        start: datetime | None = None,
        end: datetime | None = None,
        max_points: int = 2000,
        resolution: str = "auto",
    ) -> Columns:
        """Motion of a span, at most ``max_points`` points; of an explicit resolution the first ones."""
        parameters = {"start": start, "end": end, "max_points": max_points, "resolution": resolution}
        return motion_columns(await self._get(station_path(station, "motion"), **parameters))

    async def thresholds(self, station: str | None = None) -> list[Body]:
        """Thresholds."""
        return list((await self._get("/v1/thresholds", station=station))["items"])

    async def create_threshold(self, threshold: Mapping[str, Any]) -> Body:
        """Add a threshold; ``level`` and ``dead_band`` in mm, mm/s or mm/s²."""
        return dict(await self._send("POST", "/v1/thresholds", threshold))

    async def change_threshold(self, threshold_id: str, changes: Mapping[str, Any]) -> Body:
        """Change some fields of a threshold."""
        return dict(await self._send("PATCH", threshold_path(threshold_id), changes))

    async def delete_threshold(self, threshold_id: str) -> None:
        """Remove a threshold."""
        await self._send("DELETE", threshold_path(threshold_id))

    async def alerts(self, station: str | None = None, state: str | None = None) -> list[Body]:
        """Alerts, the newest first."""
        return await self._all("/v1/alerts", station=station, state=state)

    async def alert(self, alert_id: str) -> Body:
        """One alert with its history."""
        return dict(await self._get(alert_path(alert_id)))

    async def acknowledge(self, alert_id: str, by: str = "", comment: str = "") -> Body:
        """Say that an alert is seen."""
        return dict(await self._send("POST", alert_path(alert_id, "acknowledge"), {"by": by, "comment": comment}))

    async def devices(self) -> list[Body]:
        """Devices that nobody knows."""
        return list((await self._get("/v1/devices"))["items"])

    async def adopt(self, device_id: str, station: str) -> Body:
        """Make a device a station's."""
        return dict(await self._send("POST", f"/v1/devices/{device_id}/adopt", {"station": station}))

    async def stream(
        self,
        stations: Sequence[str] | None = None,
        channels: Sequence[str] | None = None,
        motion_rate_hz: float | None = None,
        resume_from: int | None = None,
    ) -> AsyncIterator[Body]:
        """Solutions, motion, status and alerts as they come, and ``missed`` messages where something could not come.

        Connects again when the connection is lost, after growing pauses, and carries on after the last message. Raises
        ``ValueError`` when the server does not understand the subscription.
        """
        wanted = {"stations": stations, "channels": channels, "motion_rate_hz": motion_rate_hz}
        request = {"action": "subscribe"} | {name: value for name, value in wanted.items() if value is not None}
        feed, pause_s = None, _FIRST_PAUSE_S
        while True:
            try:
                async with connect(stream_url(self._base_url), max_size=None) as socket:
                    hello = json.loads(await socket.recv())
                    resume_from = hello["next_sequence"] if resume_from is None else resume_from
                    resumed = {"resume_from": resume_from, "feed": feed or hello["feed"]}
                    await socket.send(json.dumps(request | resumed))
                    feed = hello["feed"]
                    async for text in socket:
                        message = json.loads(text)
                        resume_from, pause_s = _after(message, resume_from), _FIRST_PAUSE_S
                        if message["type"] != "subscribed":
                            yield message
            except (ConnectionClosed, InvalidHandshake, OSError):
                pass  # lost or not there yet
            await asyncio.sleep(pause_s)
            pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)


def _after(message: Mapping[str, Any], resume_from: int) -> int:
    """The first number that is still wanted after a message."""
    if message["type"] == "error":
        raise ValueError(message["detail"])
    if message["type"] == "subscribed":
        return resume_from
    last = message["last_sequence"] if message["type"] == "missed" else message["sequence"]
    return int(last) + 1
