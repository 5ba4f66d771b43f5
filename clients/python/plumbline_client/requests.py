"""What both clients ask: addresses and parameters, made in one place."""

from collections.abc import Mapping
from datetime import datetime
from typing import Any
from urllib.parse import quote

PAGE = 1000
Body = dict[str, Any]


def clean(parameters: Mapping[str, Any]) -> dict[str, str]:
    """Query parameters without those left out; times as ISO 8601 (they must have a zone)."""
    return {name: _text(value) for name, value in parameters.items() if value is not None}


def _text(value: Any) -> str:
    if isinstance(value, datetime):
        if value.tzinfo is None:
            raise ValueError("a time needs its zone: datetime(..., tzinfo=UTC)")
        return value.isoformat()
    return str(value).lower() if isinstance(value, bool) else str(value)


def station_path(station: str, *parts: str) -> str:
    """The address of a station or of something of it."""
    return "/".join(("/v1/stations", quote(station, safe=""), *parts))


def threshold_path(threshold_id: str) -> str:
    """The address of a threshold."""
    return "/v1/thresholds/" + quote(threshold_id, safe="")


def alert_path(alert_id: str, *parts: str) -> str:
    """The address of an alert or of something to do with it."""
    return "/".join(("/v1/alerts", quote(alert_id, safe=""), *parts))


def stream_url(base_url: str) -> str:
    """The WebSocket's address on a server."""
    scheme, _, rest = base_url.rstrip("/").partition("://")
    return f"{'wss' if scheme == 'https' else 'ws'}://{rest}/v1/stream"
