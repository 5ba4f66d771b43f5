"""The blocking client: REST only."""

from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any, Self

import httpx

from plumbline_client.errors import checked
from plumbline_client.requests import PAGE, Body, alert_path, clean, station_path, threshold_path
from plumbline_client.series import Columns, motion_columns, solution_columns


class Client:
    """A connection to a server. Every method raises :class:`PlumblineError` for what the server refuses."""

    def __init__(self, base_url: str, timeout_s: float = 30.0) -> None:
        self._http = httpx.Client(base_url=base_url, timeout=timeout_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._http.close()

    def _get(self, path: str, **parameters: Any) -> Any:
        return checked(self._http.get(path, params=clean(parameters))).json()

    def _send(self, method: str, path: str, body: Mapping[str, Any] | None = None, **headers: str) -> Any:
        response = checked(self._http.request(method, path, json=body, headers=headers))
        return response.json() if response.content else None

    def _all(self, path: str, **parameters: Any) -> Iterator[Body]:
        cursor = None
        while True:
            page = self._get(path, cursor=cursor, limit=PAGE, **parameters)
            yield from page["items"]
            cursor = page["next"]
            if cursor is None:
                return

    def stations(self) -> list[Body]:
        """Every station with its status."""
        return list(self._all("/v1/stations"))

    def station(self, station: str) -> Body:
        """One station."""
        return dict(self._get(station_path(station)))

    def create_station(self, settings: Mapping[str, Any]) -> Body:
        """Add a station; the position as ``latitude_deg, longitude_deg, height_m`` or ``reference_position_ecef_m``."""
        return dict(self._send("POST", "/v1/stations", settings))

    def change_station(self, station: str, patch: Mapping[str, Any]) -> Body:
        """Change settings by a JSON merge patch."""
        return dict(self._send("PATCH", station_path(station), patch))

    def delete_station(self, station: str, purge: bool = False) -> None:
        """Remove a station (``purge``: with every result)."""
        checked(self._http.delete(station_path(station), params=clean({"purge": purge})))

    def status(self, station: str) -> Body:
        """What a station is doing."""
        return dict(self._get(station_path(station, "status")))

    def solutions(self, station: str, start: datetime | None = None, end: datetime | None = None) -> Columns:
        """All solutions of a span."""
        return solution_columns(list(self._all(station_path(station, "solutions"), start=start, end=end)))

    def motion(
        self,
        station: str,
        start: datetime | None = None,
        end: datetime | None = None,
        max_points: int = 2000,
        resolution: str = "auto",
    ) -> Columns:
        """Motion of a span, at most ``max_points`` points; of an explicit resolution the first ones."""
        parameters = {"start": start, "end": end, "max_points": max_points, "resolution": resolution}
        return motion_columns(self._get(station_path(station, "motion"), **parameters))

    def thresholds(self, station: str | None = None) -> list[Body]:
        """Thresholds."""
        return list(self._get("/v1/thresholds", station=station)["items"])

    def create_threshold(self, threshold: Mapping[str, Any]) -> Body:
        """Add a threshold; ``level`` and ``dead_band`` in mm, mm/s or mm/s²."""
        return dict(self._send("POST", "/v1/thresholds", threshold))

    def change_threshold(self, threshold_id: str, changes: Mapping[str, Any]) -> Body:
        """Change some fields of a threshold."""
        return dict(self._send("PATCH", threshold_path(threshold_id), changes))

    def delete_threshold(self, threshold_id: str) -> None:
        """Remove a threshold."""
        self._send("DELETE", threshold_path(threshold_id))

    def alerts(self, station: str | None = None, state: str | None = None) -> list[Body]:
        """Alerts, the newest first."""
        return list(self._all("/v1/alerts", station=station, state=state))

    def alert(self, alert_id: str) -> Body:
        """One alert with its history."""
        return dict(self._get(alert_path(alert_id)))

    def acknowledge(self, alert_id: str, by: str = "", comment: str = "") -> Body:
        """Say that an alert is seen."""
        return dict(self._send("POST", alert_path(alert_id, "acknowledge"), {"by": by, "comment": comment}))

    def devices(self) -> list[Body]:
        """Devices that nobody knows."""
        return list(self._get("/v1/devices")["items"])

    def adopt(self, device_id: str, station: str) -> Body:
        """Make a device a station's."""
        return dict(self._send("POST", f"/v1/devices/{device_id}/adopt", {"station": station}))
