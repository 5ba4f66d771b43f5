"""One device's connection: an asyncio protocol that moves bytes between the socket and the sans-IO parts."""

import asyncio
import socket
from collections import Counter
from typing import TYPE_CHECKING, cast

from plumbline.ingest.registration import Admitted, Refused, Registrar, Verdict
from plumbline.ingest.stream_split import DeviceStream, Received

if TYPE_CHECKING:
    from plumbline.ingest.server import IngestServer

SILENCE_S = 0.5  # a registration that was not ended otherwise is ended by this
REFUSAL_DELAY_S = 1.0  # how long a refused caller is kept waiting, so that a tight loop of reconnects is none
MAX_DELAYED = 256  # callers kept waiting at a time
MAX_REPLY_BACKLOG_BYTES = 65_536


class Connection(asyncio.Protocol):
    """From accept to close. ``bound_station`` is set on a port of one station, where no registration is needed."""

    _delayed = 0

    def __init__(self, server: "IngestServer", bound_station: str | None) -> None:
        self._server = server
        self._bound_station = bound_station
        self._transport: asyncio.Transport | None = None
        self._registrar: Registrar | None = None
        self._stream: DeviceStream | None = None
        self._reason = ""
        self._began = 0.0
        self.last_s = 0.0  # of the loop's time, when bytes came last
        self.address = self.peer = ""
        self.stations: tuple[str, ...] = ()

    # ----------------------------------------------------------------------------------------- asyncio calls these

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """A caller; it may enter, or is refused at once for a cap."""
        self._transport = cast(asyncio.Transport, transport)
        peer = transport.get_extra_info("peername") or ("unknown", 0)
        self.address, self.peer = str(peer[0]), f"{peer[0]}:{peer[1]}"
        self._began = self.last_s = asyncio.get_running_loop().time()
        _keep_alive(transport.get_extra_info("socket"))
        if not self._server.may_enter(self):
            self.end("refused")
        elif self._bound_station is not None:
            station = self._server.directory.stations.get(self._bound_station)
            if station is None:
                self.end("station_removed")
            else:
                self._decide(Admitted((station,), "port", station.station))
        else:
            self._registrar = Registrar(self._server.directory)

    def data_received(self, data: bytes) -> None:
        """Bytes: registration first, then the device's stream."""
        if self._reason:
            return
        self.last_s = asyncio.get_running_loop().time()
        if self._stream is not None:
            self._deliver(self._stream.receive(data))
        elif self._registrar is not None:
            self._decide(self._registrar.receive(data))

    def connection_lost(self, exc: Exception | None) -> None:
        """The end, whoever wanted it."""
        if self._stream is not None and not self._reason:
            self._deliver(self._stream.silence())
        elif self._registrar is not None and not self._reason:
            verdict = self._registrar.silence()
            refused = verdict if isinstance(verdict, Refused) else self._registrar.give_up("closed_before_registration")
            self._server.refuse(self, refused)
        self._server.left(self, self._reason or (f"lost: {exc}" if exc else "closed by the device"))

    # ----------------------------------------------------------------------------------------- registration

    def _decide(self, verdict: Verdict | None) -> None:
        if isinstance(verdict, Refused):
            self._server.refuse(self, verdict)
            self._turn_away(verdict)
        elif verdict is not None and not self._server.admit(self, verdict):
            self._turn_away(Refused("too_many_wrong_tokens", verdict.identity))
        elif verdict is not None:
            self.stations = tuple(station.station for station in verdict.stations)
            self._registrar = None
            self._stream = DeviceStream(verdict)
            self._write(verdict.reply)
            if verdict.rest:
                self._deliver(self._stream.receive(verdict.rest))

    def _turn_away(self, refused: Refused) -> None:
        """Reply now, close a little later."""
        self._reason = refused.reason
        self._write(refused.reply)
        if refused.reply or Connection._delayed >= MAX_DELAYED:
            self._close()
        else:
            Connection._delayed += 1
            asyncio.get_running_loop().call_later(REFUSAL_DELAY_S, self._close_delayed)

    def _close_delayed(self) -> None:
        Connection._delayed -= 1
        self._close()

    # ----------------------------------------------------------------------------------------- the stream

    def _deliver(self, received: Received) -> None:
        for station, data in received.parts:
            self._server.sink(station, data)
        self._write(received.reply)
        if received.error:
            self.end(received.error)

    def look(self, now: float) -> None:
        """The server's regular look: deadlines, and silences that decide something. ``now`` is the loop's time, s."""
        settings = self._server.settings
        quiet_s = now - self.last_s
        if self._reason:
            return
        if self._registrar is not None:
            if now - self._began > settings.registration_deadline_s:
                refused = self._registrar.give_up("registration_timeout")
                self._server.refuse(self, refused)
                self.end(refused.reason)
            elif quiet_s > SILENCE_S:
                self._decide(self._registrar.silence())
        elif quiet_s > settings.idle_deadline_s:
            self.end("idle")
        elif self._stream is not None and self._stream.holds and quiet_s > 0.05:
            self._deliver(self._stream.silence())

    def counters(self) -> Counter[str]:
        """What the stream has counted."""
        return self._stream.counters if self._stream is not None else Counter()

    # ----------------------------------------------------------------------------------------- the socket

    def _write(self, data: bytes) -> None:
        transport = self._transport
        if data and transport is not None and transport.get_write_buffer_size() < MAX_REPLY_BACKLOG_BYTES:
            transport.write(data)

    def _close(self) -> None:
        if self._transport is not None:
            self._transport.close()

    def end(self, reason: str) -> None:
        """End the connection from this side, at once."""
        if not self._reason and self._stream is not None and self._stream.holds:
            self._deliver(self._stream.silence())
        self._reason = self._reason or reason
        if self._transport is not None:
            self._transport.abort()


def _keep_alive(sock: socket.socket | None) -> None:
    """Have the operating system notice a dead peer within two minutes."""
    if sock is None:
        return
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in (("TCP_KEEPIDLE", 60), ("TCP_KEEPINTVL", 15), ("TCP_KEEPCNT", 4)):
        if hasattr(socket, option):
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
