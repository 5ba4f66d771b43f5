"""/healthz, /readyz, /metrics, and the counting of requests."""

import asyncio
import time
from typing import Final

from fastapi import APIRouter, FastAPI, Request, Response
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from plumbline.api.feed import Feed
from plumbline.api.parts import ControlPart, StorePart
from plumbline.api.problems import problem
from plumbline.api.schemas import Health
from plumbline.errors import StoreError
from plumbline.gps_time import NS_PER_S, unix_ns_from_gps

router = APIRouter(tags=["operations"])

DATABASE_DEADLINE_S: Final = 3.0
_STATES: Final = ("waiting", "receiving", "silent")


@router.get("/healthz")
async def healthz() -> Health:
    """The process runs and its loop turns."""
    return Health(status="alive")


@router.get("/readyz", response_model=Health, responses={503: {"description": "a problem document: what is not ready"}})
async def readyz(request: Request, store: StorePart, control: ControlPart) -> object:
    """The server can do its work: the database answers and every part says that it is ready."""
    waiting = dict(await control.not_ready())
    try:
        await asyncio.wait_for(store.ping(), DATABASE_DEADLINE_S)
    except (TimeoutError, StoreError):
        waiting["store"] = "the database does not answer"
    if waiting:
        return problem(request, 503, "; ".join(f"{part}: {reason}" for part, reason in sorted(waiting.items())))
    return Health(status="ready")


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
async def metrics(request: Request, store: StorePart) -> Response:
    """Prometheus' text format."""
    meters: Meters = request.app.state.meters
    try:
        await asyncio.wait_for(meters.read_stations(store), DATABASE_DEADLINE_S)
    except (TimeoutError, StoreError):
        meters.forget_stations()
    return Response(generate_latest(meters.registry), media_type=CONTENT_TYPE_LATEST)


class _FeedCollector(Collector):
    """The feed's counters at the moment of the scrape."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed

    def collect(self) -> list[Metric]:
        """Subscribers, outputs by channel, and what slow subscribers missed."""
        published = CounterMetricFamily("plumbline_stream_published", "outputs given to the stream", labels=["channel"])
        for channel, count in sorted(self._feed.published.items()):
            published.add_metric([channel], count)
        return [
            published,
            CounterMetricFamily("plumbline_stream_missed", "outputs that slow subscribers missed", self._feed.lost),
            GaugeMetricFamily("plumbline_stream_subscribers", "open subscriptions", self._feed.n_subscribers),
        ]


class Meters:
    """What the API itself measures."""

    def __init__(self, registry: CollectorRegistry, feed: Feed) -> None:
        self.registry = registry
        names = ("method", "route", "status")
        self.requests = Counter("plumbline_http_requests", "requests answered", names, registry=registry)
        self.seconds = Histogram("plumbline_http_seconds", "time to answer", ("route",), registry=registry)
        self._states = Gauge("plumbline_stations", "stations by state", ("state",), registry=registry)
        self._last = Gauge(
            "plumbline_station_last_receive_seconds", "POSIX time of the last input", ("station",), registry=registry
        )
        self._satellites = Gauge("plumbline_station_satellites", "satellites used", ("station",), registry=registry)
        self._counters = Gauge(
            "plumbline_station_counter", "what was not used or seen, by reason", ("station", "what"), registry=registry
        )
        registry.register(_FeedCollector(feed))

    async def read_stations(self, store: StorePart) -> None:
        """Bring the stations' gauges up to date."""
        statuses = await store.statuses()
        self.forget_stations()
        for state in _STATES:
            self._states.labels(state).set(sum(status.state == state for status in statuses.values()))
        for station, status in statuses.items():
            self._last.labels(station).set(unix_ns_from_gps(status.t_receive_ns) / NS_PER_S)
            self._satellites.labels(station).set(status.n_satellites)
            for what, count in status.counters.items():
                self._counters.labels(station, what).set(count)

    def forget_stations(self) -> None:
        """Show no station's numbers: better none than old ones."""
        for gauge in (self._states, self._last, self._satellites, self._counters):
            gauge.clear()


class Measured:
    """ASGI middleware: counts and times requests by route."""

    def __init__(self, app: ASGIApp, owner: FastAPI) -> None:
        self._app = app
        self._owner = owner

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Note the status that is sent and how long the answer took."""
        if scope["type"] != "http":
            return await self._app(scope, receive, send)
        status, began = 500, time.monotonic()

        async def noting(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        try:
            await self._app(scope, receive, noting)
        finally:
            meters: Meters | None = getattr(self._owner.state, "meters", None)
            if meters is not None:
                route = getattr(scope.get("route"), "path", "other")
                meters.requests.labels(scope["method"][:10], route, str(status)).inc()
                meters.seconds.labels(route).observe(time.monotonic() - began)
