"""The roles of one process, from start to an orderly end.

The end loses nothing that was received: devices are cut off first, then workers finish and save, then the store writes
what they sent, then the rest goes.
"""

import asyncio
import logging
import os
import signal
import time
from typing import Final

import uvloop

from plumbline.app.api_role import ApiRole
from plumbline.app.ingest_role import IngestRole
from plumbline.app.store_role import StoreRole
from plumbline.app.worker_pool import WorkerPool
from plumbline.bus import Bus
from plumbline.config import Mode, ServerSettings, StationSettings
from plumbline.errors import ConfigurationError, PlumblineError
from plumbline.records import Severity, Threshold
from plumbline.store import Store, database_url

log = logging.getLogger(__name__)

ROLES: Final = ("ingest", "worker", "store", "api")


class Server:
    """The roles of this process. :meth:`start`, then :meth:`stop`."""

    def __init__(self, settings: ServerSettings, roles: frozenset[str] = frozenset(ROLES)) -> None:
        unknown = roles - set(ROLES)
        if unknown:
            raise ConfigurationError(f"unknown role: {', '.join(sorted(unknown))}")
        self.settings = settings
        self._roles = roles
        self._bus: Bus | None = None
        self._store: Store | None = None
        self.ingest: IngestRole | None = None
        self.store_role: StoreRole | None = None
        self.api: ApiRole | None = None
        self.workers: WorkerPool | None = None

    async def start(self) -> None:
        """Bring up every role; raises OSError or PlumblineError when that cannot be."""
        settings, roles = self.settings, self._roles
        settings.data_dir.mkdir(parents=True, exist_ok=True)
        hub = roles == set(ROLES) or not settings.bus_connect
        bus = self._bus = await Bus.open((settings.bus_endpoint,) if hub else (), settings.bus_connect)
        if roles & {"store", "api"}:
            self._store = await self._open_store()
        if "store" in roles and self._store is not None:
            self.store_role = StoreRole(self._store, bus, f"s{os.getpid()}-{time.time_ns():x}")
            await self.store_role.start()
        if "ingest" in roles:
            ingest = IngestRole(settings, bus)
            await ingest.start()
            self.ingest = ingest
        if "api" in roles and self._store is not None:
            api = ApiRole(settings, self._store, bus)
            await api.start()
            self.api = api
        if "worker" in roles:
            connect = tuple(reachable(endpoint) for endpoint in bus.endpoints) or settings.bus_connect
            self.workers = WorkerPool(settings, connect, settings.workers or max((os.cpu_count() or 2) - 1, 1))
            await self.workers.start()
        log.info("serving: %s", ", ".join(self.addresses()))

    async def stop(self) -> None:
        """Receive no more, finish what was received, save it, end."""
        if self.ingest is not None:
            await self.ingest.stop()
        if self.workers is not None:
            await self.workers.stop()
        if self.store_role is not None:
            await self.store_role.stop()
        if self.api is not None:
            await self.api.stop()
        if self._store is not None:
            await self._store.close()
        if self._bus is not None:
            await self._bus.close()
        if self.ingest is not None:
            await self.ingest.close()
        log.info("stopped")

    def addresses(self) -> list[str]:
        """Where this process can be reached, ports resolved."""
        found = [f"bus {endpoint}" for endpoint in self._bus.endpoints] if self._bus is not None else []
        if self.ingest is not None:
            found.append(f"ingest {self.settings.ingest_host}:{self.ingest.server.port}")
        if self.api is not None:
            found.append(f"http://{self.settings.http_host}:{self.api.port}")
        return found

    # ----------------------------------------------------------------------------------------- parts

    async def _open_store(self) -> Store:
        settings = self.settings
        while True:
            try:
                store = await Store.open(database_url(settings))
                break
            except ConfigurationError:
                raise
            except PlumblineError as error:
                log.error("the database cannot be reached, trying again: %s", error)
                await asyncio.sleep(2.0)
        fetched = (
            StationSettings(station=source.station, name=source.url, mode=Mode.CORRECTIONS) for source in settings.ntrip
        )
        thresholds = (
            Threshold(**(t.model_dump() | {"severity": Severity(t.severity)}))  # the file gives the severity as text
            for t in settings.thresholds
        )
        await store.seed((*settings.stations, *fetched), tuple(thresholds))
        return store


def reachable(endpoint: str) -> str:
    """An endpoint to connect to on this machine, for one that listens on every address."""
    return endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")


async def serve(settings: ServerSettings, roles: frozenset[str]) -> None:
    """Run until SIGTERM or SIGINT."""
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    server = Server(settings, roles)
    try:
        await server.start()
        await stop.wait()
    finally:
        await server.stop()


def main(settings: ServerSettings, roles: frozenset[str] = frozenset(ROLES)) -> int:
    """Serve; the exit status is 0 after an orderly end and 1 when the server could not start (the log says why)."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    try:
        with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
            runner.run(serve(settings, roles))
    except (PlumblineError, OSError) as error:
        log.critical("cannot serve: %s", error)
        return 1
    return 0
