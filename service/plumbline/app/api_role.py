"""The API role: the web server, its live feed from the bus, and the words that it sends to the other roles."""

import asyncio
import contextlib
import logging
import socket
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import uvicorn
from prometheus_client import CollectorRegistry
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from plumbline.api import Feed, create_app
from plumbline.app.store_role import station_configs
from plumbline.bus import Bus, Inbox, Message, codec, keys
from plumbline.bus.messages import StationConfig, decode_numbered, decode_report, encode_configs
from plumbline.config import ServerSettings, StationSettings
from plumbline.gps_time import gps_ns_from_unix_ns
from plumbline.records import Threshold
from plumbline.store import Device, Store

log = logging.getLogger(__name__)

GRACE_S = 3  # for requests under way when the server stops
REPORT_INTERVAL_S = 2.0


class BusControl:
    """What the API's changes mean for the rest: :class:`plumbline.api.Control` over the bus."""

    def __init__(self, store: Store, bus: Bus) -> None:
        self._store = store
        self._bus = bus
        self.failing: dict[str, str] = {}  # parts that processes say do not work, and why
        self.alive: set[str] = set()  # keys of the liveliness tokens of all processes

    async def station_changed(self, station: str, settings: StationSettings | None) -> None:
        """Tell ingest and workers at once."""
        configs = await station_configs(self._store, station) if settings is not None else []
        await self._tell(configs or [StationConfig(station, None)])

    async def thresholds_changed(self, station: str, thresholds: Sequence[Threshold]) -> None:
        """Tell the station's worker at once."""
        now_ns = gps_ns_from_unix_ns(time.time_ns())
        configs = await station_configs(self._store, station)
        await self._tell([replace(c, thresholds=tuple(thresholds), changed_gps_ns=now_ns) for c in configs])

    async def _tell(self, configs: Sequence[StationConfig]) -> None:
        for config in configs:
            await asyncio.to_thread(self._bus.put, keys.of(keys.SETTINGS, config.station), encode_configs([config]))

    async def devices(self) -> Sequence[Device]:
        """Unknown devices that call now, of every ingest, the latest first."""
        found: dict[str, Device] = {}
        for answer in await self._bus.query(f"{keys.QUERY_DEVICES}/*", timeout_s=2.0):
            for identity, address, first_ns, last_ns, attempts, reason in codec.decode(answer)["callers"]:
                if identity not in found or last_ns > found[identity].last_seen_gps_ns:
                    found[identity] = Device(identity, address, first_ns, last_ns, attempts, reason)
        return sorted(found.values(), key=lambda device: -device.last_seen_gps_ns)

    async def not_ready(self) -> Mapping[str, str]:
        """Roles that nobody plays, and what processes say does not work: a disk or a database that takes nothing."""
        roles = {"ingest": keys.ALIVE_INGEST, "worker": keys.ALIVE_WORKER, "store": keys.ALIVE_STORE}
        missing = {
            role: "no process of this role is alive"
            for role, prefix in roles.items()
            if not any(key.startswith(prefix) for key in self.alive)
        }
        return missing | self.failing


class Counters(Collector):
    """Every process's counters as one metric family a role, as last told."""

    def __init__(self) -> None:
        self.told: dict[str, dict[str, Mapping[str, int]]] = {}  # role → process → counter → value

    def collect(self) -> Iterator[Metric]:
        """For prometheus_client."""
        for role, processes in sorted(self.told.items()):
            family = GaugeMetricFamily(f"plumbline_{role}", f"Counters of the {role} role", labels=("process", "what"))
            for process, values in sorted(processes.items()):
                for name, value in sorted(values.items()):
                    family.add_metric((process, name), value)
            yield family


class _WebServer(uvicorn.Server):
    """Signals are the composition root's business."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


class ApiRole:
    """The web server on the settings' host and port."""

    def __init__(self, settings: ServerSettings, store: Store, bus: Bus) -> None:
        self._settings = settings
        self._store = store
        self._bus = bus
        self._control = BusControl(store, bus)
        self._counters = Counters()
        self._told_ns: dict[str, int] = {}
        self.feed = Feed()
        self.port = 0

    async def start(self) -> None:
        """Listen; raises OSError when the port is taken."""
        settings = self._settings
        self._inbox = Inbox(max_bytes=64 << 20)
        for prefix in keys.OUTPUTS.values():
            self._bus.subscribe(f"{prefix}/**", self._inbox)
        self._bus.watch("plumbline/alive/**", self._inbox)
        registry = CollectorRegistry()
        registry.register(self._counters)
        app = create_app(self._store, self.feed, self._control, settings, registry)
        sock = socket.create_server((settings.http_host, settings.http_port), backlog=512)
        self.port = sock.getsockname()[1]
        config = uvicorn.Config(app, log_level="warning", access_log=False, timeout_graceful_shutdown=GRACE_S)
        self._web = _WebServer(config)
        create = asyncio.get_running_loop().create_task
        self._serving = create(self._web.serve(sockets=[sock]))
        self._tasks = [create(self._feed_on()), create(self._gather_reports())]

    async def stop(self) -> None:
        """Finish what is under way, within a grace, and end."""
        for task in self._tasks:
            task.cancel()
        self._web.should_exit = True
        await self._serving

    async def _feed_on(self) -> None:
        while True:
            for message in await self._inbox.get():
                if message.key.startswith("plumbline/alive/"):
                    (self._control.alive.add if message.alive else self._control.alive.discard)(message.key)
                else:
                    self._pass_on(message)

    def _pass_on(self, message: Message) -> None:
        """To the feed, unless it has been there: what is computed again after a take-over is no news."""
        try:
            output = codec.decode(decode_numbered(message.payload).body)
        except ValueError as error:
            log.error("unreadable message on %s: %s", message.key, error)
            return
        if output.t_receive_ns >= self._told_ns.get(message.key, 0):
            self._told_ns[message.key] = output.t_receive_ns
            self.feed.publish(output)

    async def _gather_reports(self) -> None:
        """Ask every process how it is now and then, so that a scrape or a probe waits for nobody."""
        while True:
            told: dict[str, dict[str, Mapping[str, int]]] = {}
            failing: dict[str, str] = {}
            for answer in await self._bus.query(f"{keys.QUERY_REPORT}/*", timeout_s=2.0):
                report = decode_report(answer)
                told.setdefault(report.role, {})[report.process] = report.counters
                failing |= report.failing
            self._counters.told, self._control.failing = told, failing
            await asyncio.sleep(REPORT_INTERVAL_S)
