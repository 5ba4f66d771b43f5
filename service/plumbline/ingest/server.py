"""The listener that devices connect to: sockets, deadlines and caps around the sans-IO parts."""

import asyncio
import logging
import ssl
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from plumbline.config import ServerSettings
from plumbline.ingest.callers import Callers
from plumbline.ingest.clock import ReceiveClock
from plumbline.ingest.connection import Connection
from plumbline.ingest.directory import Directory
from plumbline.ingest.registration import Admitted, Refused

log = logging.getLogger(__name__)

LAST_READ_S = 1.0
QUIET_S = 0.05

Sink = Callable[[str, bytes], None]


@dataclass(frozen=True, slots=True)
class ConnectionEvent:
    """A station's device came or went."""

    station: str
    kind: str  # "connected", "disconnected"
    reason: str  # "ntrip2 from 10.0.0.7:40000", "superseded", "idle" …
    t_gps_ns: int


class IngestServer:
    """Listens on the ingest port and on every port bound to a station.

    ``sink(station, data)`` gets the bytes of admitted devices in the order they came; ``on_event`` comings and goings.
    """

    def __init__(
        self,
        settings: ServerSettings,
        directory: Directory,
        sink: Sink,
        on_event: Callable[[ConnectionEvent], None],
        clock: ReceiveClock,
    ) -> None:
        self.settings = settings
        self.directory = directory
        self.sink = sink
        self.on_event = on_event
        self.clock = clock
        self.callers = Callers()
        self.counters: Counter[str] = Counter()
        self.port = 0  # where it listens, once started
        self._connections: set[Connection] = set()
        self._by_address: Counter[str] = Counter()
        self._active: dict[str, Connection] = {}
        self._servers: dict[int, asyncio.Server] = {}
        self._sweeper: asyncio.Task[None] | None = None
        self._accepting = False

    # ----------------------------------------------------------------------------------------- life

    async def start(self) -> None:
        """Listen; raises OSError when the ingest port is taken (a taken station port is logged and counted)."""
        self._accepting = True
        server = await self._listen(self.settings.ingest_port, None)
        self.port = server.sockets[0].getsockname()[1]
        self._servers[0] = server
        await self._follow_ports()
        self._sweeper = asyncio.create_task(self._sweep())

    async def stop(self) -> None:
        """Accept nobody any more and end every connection; what has arrived goes through the sink first."""
        self._accepting = False
        if self._sweeper is not None:
            self._sweeper.cancel()
        for server in self._servers.values():
            server.close()
        await self._read_what_has_arrived()
        for connection in list(self._connections):
            connection.end("server_stops")
        await asyncio.sleep(0)

    async def _read_what_has_arrived(self) -> None:
        """Until the sockets are empty, or the devices go on for longer than the end can wait."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + LAST_READ_S
        while loop.time() < deadline:
            await asyncio.sleep(QUIET_S)
            if all(loop.time() - connection.last_s > QUIET_S for connection in self._connections):
                return

    async def change_directory(self, directory: Directory) -> None:
        """Follow a change of stations: ports open and close, devices whose settings changed have to come again."""
        before, self.directory = self.directory, directory
        for station, connection in list(self._active.items()):
            now = directory.stations.get(station)
            if now is None or now.device != before.stations[station].device:
                connection.end("settings_changed")
        for caller in self.callers.listed():
            if directory.of_name(caller.identity):
                self.callers.forget(caller.identity)
        await self._follow_ports()

    async def _listen(self, port: int, station: str | None) -> asyncio.Server:
        settings = self.settings
        context = None
        if settings.tls_certificate is not None:
            context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
            context.load_cert_chain(settings.tls_certificate, settings.tls_key)
        return await asyncio.get_running_loop().create_server(
            lambda: Connection(self, station),
            settings.ingest_host,
            port,
            ssl=context,
            ssl_handshake_timeout=settings.registration_deadline_s if context else None,
            backlog=1024,
        )

    async def _follow_ports(self) -> None:
        wanted = {port: station.station for port, station in self.directory.ports.items()}
        for port in [port for port in self._servers if port and port not in wanted]:
            self._servers.pop(port).close()
        for port, station in wanted.items():
            if port not in self._servers:
                try:
                    self._servers[port] = await self._listen(port, station)
                except OSError as error:
                    self.counters["station_port_taken"] += 1
                    log.error("cannot listen on port %d of station %s: %s", port, station, error.strerror)

    async def _sweep(self) -> None:
        """End idle connections, release what was held back, and decide on registrations that fell silent."""
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(0.1)
            now = loop.time()
            for connection in list(self._connections):
                connection.look(now)

    # ----------------------------------------------------------------------------------------- called by connections

    def may_enter(self, connection: Connection) -> bool:
        """Count a new connection in, or refuse it for a cap."""
        address = connection.address
        reason = ""
        if not self._accepting:
            reason = "server_stops"
        elif len(self._connections) >= self.settings.max_connections:
            reason = "too_many_connections"
        elif self._by_address[address] >= self.settings.max_connections_per_address:
            reason = "too_many_connections_from_address"
        self._connections.add(connection)
        self._by_address[address] += 1
        self.counters["connections"] += 1
        if reason:
            self.refuse(connection, Refused(reason, ""))
        return not reason

    def admit(self, connection: Connection, admitted: Admitted) -> bool:
        """Make a connection the one of its stations; an older one of any of them ends. False: refused after all."""
        identity = admitted.identity
        if self.callers.must_pause(identity, connection.address, self.clock.now()):
            self.refuse(connection, Refused("too_many_wrong_tokens", identity))
            return False
        self.callers.forget(identity)
        for station in admitted.stations:
            older = self._active.get(station.station)
            if older is not None and older is not connection:
                self.counters["superseded"] += 1
                older.end("superseded")
            self._active[station.station] = connection
            self._tell(station.station, "connected", f"{admitted.form} from {connection.peer}")
        return True

    def refuse(self, connection: Connection, refused: Refused) -> None:
        """Count and list a caller that is not let in."""
        caller = self.callers.refuse(refused.identity, connection.address, refused.reason, self.clock.now())
        if caller is None or caller.attempts & (caller.attempts - 1) == 0:  # the 1st, 2nd, 4th, 8th … time
            log.warning("refused %s: %s %r", connection.peer, refused.reason, refused.identity)

    def left(self, connection: Connection, reason: str) -> None:
        """A connection has ended."""
        self._connections.discard(connection)
        self._by_address[connection.address] -= 1
        if self._by_address[connection.address] <= 0:
            del self._by_address[connection.address]
        for name, n in connection.counters().items():
            self.counters[name] += n
        for station in connection.stations:
            if self._active.get(station) is connection:
                del self._active[station]
                self._tell(station, "disconnected", reason)

    def _tell(self, station: str, kind: str, reason: str) -> None:
        self.on_event(ConnectionEvent(station, kind, reason, self.clock.now()))

    # ----------------------------------------------------------------------------------------- views

    @property
    def n_connections(self) -> int:
        """Open connections, registered or not."""
        return len(self._connections)

    def connected(self) -> dict[str, str]:
        """Stations with a device connected now, and where it calls from."""
        return {station: connection.peer for station, connection in sorted(self._active.items())}
