"""/v1/stream: solutions, motion, status and alerts as they come, over a WebSocket.

A client subscribes with the address, ``/v1/stream?station=a&station=b&channel=motion&resume_from=17``, or, having
connected to the bare address, with a message; a later message replaces the subscription::

    {"action": "subscribe", "stations": ["a", "b"], "channels": ["solution", "motion", "status", "alert",
     "quality", "attitude"],
     "resume_from": 1767225600000017, "feed": "0f3c…", "motion_rate_hz": 10}

All fields but ``action`` may be left out: all stations, all channels, from now on, every sample. ``resume_from`` is the
first sequence number wanted (the last one seen plus one), ``feed`` the id that ``hello`` gave with the numbers;
``motion_rate_hz`` thins motion out to about that many samples a second. The server speaks in JSON texts, one message
each::

    {"type": "hello", "feed": "0f3c9a52d1b7e684", "next_sequence": 1767225600000017,
     "oldest_sequence": 1767225600000001}

    {"type": "subscribed", "stations": ["a", "b"], "channels": ["motion"], "next_sequence": 1767225600000017}

    {"type": "solution", "sequence": 1767225600000018, "station": "a", "time": "2026-01-01T00:00:01.000Z",
     "status": "ppp_float", "reason": "", "n_satellites": 17, "systems": "GRE", "east_mm": 1.2, "north_mm": -0.4,
     "up_mm": 3.1, "sigma_east_mm": 2.0, "sigma_north_mm": 2.1, "sigma_up_mm": 5.0, "velocity_east_mm_s": null,
     "velocity_north_mm_s": null, "velocity_up_mm_s": null, "latitude_deg": 48.1, "longitude_deg": 11.5,
     "height_m": 555.2, "zenith_delay_mm": 2400.1, "receiver_clock_ns": 12.5, "correction_age_s": 5.0, "pdop": 1.4,
     "roll_deg": null, "pitch_deg": null, "heading_deg": null, "sigma_roll_deg": null, "sigma_pitch_deg": null,
     "sigma_heading_deg": null, "extras": {}}

    {"type": "motion", "sequence": 1767225600000019, "station": "a", "time": "2026-01-01T00:00:00.000Z",
     "interval_s": 0.5, "status": "ppp_float", "reason": "", "revision": 0, "east_mm": [1.2, 1.3],
     "north_mm": [0.1, 0.1], "up_mm": [3.0, 3.1], "velocity_east_mm_s": [0.1, 0.2], "velocity_north_mm_s": [0.0, 0.0],
     "velocity_up_mm_s": [0.1, 0.1], "acceleration_east_mm_s2": [1.0, 0.5], "acceleration_north_mm_s2": [0.2, 0.1],
     "acceleration_up_mm_s2": [0.0, 0.4], "sigma_east_mm": [2.0, 2.0], "sigma_north_mm": [2.1, 2.1],
     "sigma_up_mm": [5.0, 5.0]}

    {"type": "status", "sequence": 1767225600000020, "station": "a", "state": "receiving", "reason": "",
     "time": "2026-01-01T00:00:01.250Z", "last_epoch": "2026-01-01T00:00:01.000Z", "solution_status": "ppp_float",
     "n_satellites": 17, "counters": {"messages_1077": 12}}

    {"type": "alert", "sequence": 1767225600000021, "alert_id": "a:level-1:1451260817000000000", "station": "a",
     "threshold_id": "level-1", "kind": "motion", "quantity": "displacement_horizontal", "unit": "mm",
     "severity": "alarm", "state": "active", "level": 50.0, "value": 61.3,
     "text": "displacement_horizontal 61.3 mm, limit 50 mm",
     "time": "2026-01-01T00:00:00.000Z", "onset": "2026-01-01T00:00:00.000Z"}

    {"type": "quality", "sequence": 1767225600000021, "station": "a", "time": "2026-01-01T00:00:01.000Z",
     "tests": {"statistic": 41.2, "degrees_of_freedom": 44.0, "critical_value": 60.5}, "hdop": 0.6, "vdop": 0.9,
     "pdop": 1.1, "protection_horizontal_mm": 31.0, "protection_vertical_mm": 58.1, "integrity_risk": 1e-05,
     "events": [], "observations": [{"satellite": "G05", "kind": "phase", "signals": ["L1C", "L2W"],
     "residual_mm": 1.2, "sigma_mm": 6.1, "redundancy": 0.71, "mdb_mm": 21.0, "w": 0.4, "qdop": 0.2,
     "elevation_deg": 54.1, "azimuth_deg": 120.5, "external_east_mm": 2.1, "external_north_mm": -0.4,
     "external_up_mm": 1.0, "rejected": false, "reason": ""}]}

    {"type": "attitude", "sequence": 1767225600000021, "station": "a", "time": "2026-01-01T00:00:01.000Z",
     "status": "rtk_fixed", "roll_deg": -0.298, "pitch_deg": 0.419, "heading_deg": 24.993, "sigma_roll_deg": 0.02,
     "sigma_pitch_deg": 0.021, "sigma_heading_deg": 0.035}

    {"type": "missed", "first_sequence": 1767225600000022, "last_sequence": 1767225600000940, "count": 301}

    {"type": "error", "detail": "resume_from: Input should be greater than or equal to 0"}

A motion block of a platform with an IMU has its angles too, in columns ``roll_deg``, ``pitch_deg``, ``heading_deg`` and
``sigma_roll_deg`` and so on. The channel ``attitude`` has them alone: of a solution, or of a block's last sample.

A motion block of the same ``station`` and ``time`` with a higher ``revision`` replaces the one before it. ``time`` is
that of the first sample; sample k is at ``time`` + k × ``interval_s``. ``missed`` says that the client was too slow, or
away for too long, for what lies between two numbers; ``count`` is how many messages of its subscription those were,
null where it is not known any more. What was missed is in the store: ask ``/v1/stations/{id}/motion``.
"""

import asyncio
import json
from contextlib import suppress
from functools import lru_cache
from typing import Annotated, Any, Literal

from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from plumbline.api.feed import Channel, Entry, Feed, Interest, Missed, Subscription
from plumbline.api.quality_views import quality_view
from plumbline.api.views import alert_event_view, attitude_view, motion_view, solution_view, status_view
from plumbline.config import StationId
from plumbline.gps_time import NS_PER_S
from plumbline.records import AlertEvent, Motion, Output, QualityReport, Solution

router = APIRouter(prefix="/v1")

Sequence = Annotated[int, Field(ge=0, lt=2**63)]


class Subscribe(BaseModel):
    """What a client asks for."""

    model_config = ConfigDict(extra="forbid")

    action: Literal["subscribe"]
    stations: Annotated[list[StationId], Field(max_length=10_000)] | None = None
    channels: Annotated[list[Channel], Field(max_length=100)] | None = None
    resume_from: Sequence | None = None
    feed: Annotated[str, Field(max_length=64)] | None = None
    motion_rate_hz: Annotated[float, Field(gt=0, le=1e6)] | None = None


def view_of(output: Output, step: int = 1) -> dict[str, Any]:
    """An output's fields in a stream message, on its own channel."""
    if isinstance(output, Solution):
        return solution_view(output)
    if isinstance(output, Motion):
        return motion_view(output, step)
    if isinstance(output, AlertEvent):
        return alert_event_view(output)
    if isinstance(output, QualityReport):
        return quality_view(output)
    return status_view(output.station, output).model_dump(mode="json")


@lru_cache(maxsize=1024)
def message_text(entry: Entry, step: int) -> str:
    """An entry as the client reads it; made once for all subscribers who want the same."""
    output = entry.output
    if entry.channel is Channel.ATTITUDE and isinstance(output, Solution | Motion):
        view = attitude_view(output)
    else:
        view = view_of(output, step)
    return _json({"type": entry.channel.value, "sequence": entry.sequence, **view})


def _json(message: dict[str, Any]) -> str:
    return json.dumps(message, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def _step(output: Output, rate_hz: float | None) -> int:
    """Every how many-th sample of a block makes about the rate."""
    if rate_hz is None or not isinstance(output, Motion) or output.interval_ns <= 0:
        return 1
    return max(1, round(NS_PER_S / output.interval_ns / rate_hz))


def _text(item: Missed | Entry, rate_hz: float | None) -> str:
    if isinstance(item, Missed):
        numbers = {"first_sequence": item.first, "last_sequence": item.last, "count": item.count}
        return _json({"type": "missed", **numbers})
    return message_text(item, _step(item.output, rate_hz))


class _Session:
    """One client's connection: its present subscription and the task that sends it."""

    def __init__(self, websocket: WebSocket, feed: Feed) -> None:
        self._websocket = websocket
        self._feed = feed
        self._subscription: Subscription | None = None
        self._sender: asyncio.Task[None] | None = None

    async def hello(self) -> None:
        """Say which feed this is and which numbers it has."""
        numbers = {"next_sequence": self._feed.next_sequence, "oldest_sequence": self._feed.oldest_sequence}
        await self.send({"type": "hello", "feed": self._feed.feed_id, **numbers})

    async def send(self, message: dict[str, Any]) -> None:
        """Send one message."""
        await self._websocket.send_text(_json(message))

    async def subscribe(self, wanted: Subscribe) -> None:
        """Put a subscription in the place of the one before."""
        await self.stop()
        interest = Interest(
            None if wanted.stations is None else frozenset(wanted.stations),
            None if wanted.channels is None else frozenset(wanted.channels),
        )
        answer = {"stations": wanted.stations, "channels": wanted.channels, "next_sequence": self._feed.next_sequence}
        resume_from = wanted.resume_from
        if resume_from is not None and (
            wanted.feed not in (None, self._feed.feed_id) or resume_from > self._feed.next_sequence
        ):
            resume_from = self._feed.oldest_sequence - 1  # numbers of another feed: all there is, and word of a gap
        self._subscription = self._feed.subscribe(interest, resume_from)
        await self.send({"type": "subscribed", **answer})
        self._sender = asyncio.create_task(self._send_all(self._subscription, wanted.motion_rate_hz))

    async def _send_all(self, subscription: Subscription, rate_hz: float | None) -> None:
        with suppress(WebSocketDisconnect, RuntimeError):  # gone: the receiving side notices, too
            while True:
                await self._websocket.send_text(_text(await subscription.next(), rate_hz))

    async def stop(self) -> None:
        """End the present subscription."""
        if self._subscription is not None:
            self._feed.unsubscribe(self._subscription)
        if self._sender is not None:
            self._sender.cancel()
            with suppress(asyncio.CancelledError):
                await self._sender
        self._subscription = self._sender = None


def _of_address(websocket: WebSocket) -> Subscribe | None:
    """The subscription in the address; None when there is none. Raises ``ValidationError``."""
    names = {"station": "stations", "channel": "channels"}
    values: dict[str, Any] = {}
    for name in websocket.query_params:
        given = websocket.query_params.getlist(name)
        if name in names:
            values[names[name]] = [part for text in given for part in text.split(",")]
        else:
            values[name] = given[-1]
    return Subscribe.model_validate({**values, "action": "subscribe"}) if values else None


def _complaint(error: ValidationError) -> str:
    items = error.errors(include_input=False, include_url=False)[:5]
    text = "; ".join(f"{'.'.join(str(part) for part in item['loc'])}: {item['msg']}" for item in items)
    return text.encode("utf-8", "replace").decode("utf-8")


@router.websocket("/stream")
async def stream(websocket: WebSocket) -> None:
    """Serve one client until it leaves."""
    await websocket.accept()
    session = _Session(websocket, websocket.app.state.feed)
    try:
        await session.hello()
        try:
            wanted = _of_address(websocket)
        except ValidationError as error:
            await session.send({"type": "error", "detail": _complaint(error)})
            await websocket.close(1008, "the address asks for what there is not")
            return
        if wanted is not None:
            await session.subscribe(wanted)
        while True:
            await _take(session, await websocket.receive())
    except (WebSocketDisconnect, RuntimeError):
        pass  # the client left, also in the middle of a message to it
    finally:
        await session.stop()


async def _take(session: _Session, message: Any) -> None:
    """Act on one message of the client."""
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1005))
    try:
        await session.subscribe(Subscribe.model_validate_json(message.get("text") or message.get("bytes") or b""))
    except ValidationError as error:
        await session.send({"type": "error", "detail": _complaint(error)})
