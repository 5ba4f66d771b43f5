"""One DTU: a TCP connection that registers, beats, cuts its bytes as a modem does, and comes back when lost."""

import asyncio
import contextlib
import random
import re
import ssl
import time
from collections import deque
from dataclasses import dataclass, field

from plumbline.errors import ConfigurationError, PlumblineError

_FIRST_BACK_OFF_S = 0.5
_LONGEST_BACK_OFF_S = 30.0


class DeviceError(PlumblineError):
    """A device cannot reach its server."""


@dataclass(frozen=True, slots=True)
class DeviceOptions:
    """How a device behaves."""

    host: str
    port: int
    registration: bytes = b""
    heartbeat: bytes = b""
    heartbeat_interval_s: float = 30.0
    prefix_packets: bool = False  # the registration stands before every packet
    largest_segment: int = 1021
    buffer_bytes: int = 1 << 20  # what a modem keeps while it has no network; the oldest is lost
    tls: ssl.SSLContext | None = None
    connect_timeout_s: float = 10.0
    give_up_s: float | None = None  # without a connection for so long, :meth:`Device.run` raises; None: never


@dataclass(slots=True)
class DeviceCounters:
    """What a device has done so far."""

    connections: int = 0
    sent_bytes: int = 0
    lost_bytes: int = 0
    received_bytes: int = 0
    heartbeats: int = 0


class Device:
    """A DTU. ``send`` never fails: it queues; ``run`` connects and sends until cancelled or closed and drained."""

    def __init__(self, options: DeviceOptions, seed: int = 0) -> None:
        self.options = options
        self.counters = DeviceCounters()
        self._random = random.Random(seed)
        self._queue: deque[bytes] = deque()
        self._queued_bytes = 0
        self._wake = asyncio.Event()
        self._drained = asyncio.Event()
        self._drained.set()
        self._closed = False

    def send(self, data: bytes) -> None:
        """Queue bytes; while there is no network and the buffer is full, the oldest are lost and counted."""
        self._queue.append(data)
        self._queued_bytes += len(data)
        while self._queued_bytes > self.options.buffer_bytes and len(self._queue) > 1:
            lost = self._queue.popleft()
            self._queued_bytes -= len(lost)
            self.counters.lost_bytes += len(lost)
        self._drained.clear()
        self._wake.set()

    async def drained(self) -> None:
        """Wait until everything queued has been handed to the network."""
        await self._drained.wait()

    def close(self) -> None:
        """End :meth:`run` once everything has been sent."""
        self._closed = True
        self._wake.set()

    async def run(self) -> None:
        """Connect, send, reconnect with exponential back-off and jitter, until closed and drained.

        Raises DeviceError when ``give_up_s`` is over.
        """
        failures = 0
        last = time.monotonic()
        while not (self._closed and not self._queue):
            try:
                async with asyncio.timeout(self.options.connect_timeout_s):
                    reader, writer = await asyncio.open_connection(
                        self.options.host, self.options.port, ssl=self.options.tls, limit=1 << 16
                    )
            except (OSError, TimeoutError) as error:
                if self.options.give_up_s is not None and time.monotonic() - last > self.options.give_up_s:
                    raise DeviceError(f"no connection to {self.options.host}:{self.options.port}: {error}") from error
                failures += 1
                longest = min(_FIRST_BACK_OFF_S * 2**failures, _LONGEST_BACK_OFF_S)
                await asyncio.sleep(self._random.uniform(0.5, 1.0) * longest)
                continue
            sent_before = self.counters.sent_bytes
            with contextlib.suppress(OSError):
                await self._serve(reader, writer)
            last = time.monotonic()
            failures = 0 if self.counters.sent_bytes > sent_before else failures + 1
            if not self._closed:
                await asyncio.sleep(self._random.uniform(0.2, 1.0) * _FIRST_BACK_OFF_S)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One connection's life: it ends when the server hangs up, the network breaks or all is sent and closed."""
        self.counters.connections += 1
        if self.options.registration and not self.options.prefix_packets:
            writer.write(self.options.registration)
            await writer.drain()
        tasks = [asyncio.create_task(job) for job in (self._listen(reader), self._beat(writer), self._pump(writer))]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            writer.close()
            with contextlib.suppress(OSError, TimeoutError):
                async with asyncio.timeout(2.0):
                    await writer.wait_closed()

    async def _listen(self, reader: asyncio.StreamReader) -> None:
        """Whatever comes back (echoed heartbeats, caster answers) is read and counted."""
        while data := await reader.read(4096):
            self.counters.received_bytes += len(data)

    async def _beat(self, writer: asyncio.StreamWriter) -> None:
        while self.options.heartbeat:
            await asyncio.sleep(self.options.heartbeat_interval_s)
            writer.write(self.options.heartbeat)
            self.counters.heartbeats += 1
        await asyncio.Event().wait()

    async def _pump(self, writer: asyncio.StreamWriter) -> None:
        while True:
            while self._queue:
                data = self._queue.popleft()
                self._queued_bytes -= len(data)
                for segment in self._segments(data):
                    writer.write(segment)
                    await writer.drain()
                self.counters.sent_bytes += len(data)
            self._drained.set()
            if self._closed:
                return
            self._wake.clear()
            await self._wake.wait()

    def _segments(self, data: bytes) -> list[bytes]:
        """Bytes cut at odd places, as a serial port's time-outs and a modem's buffers cut them."""
        segments, at = [], 0
        prefix = self.options.registration if self.options.prefix_packets else b""
        while at < len(data):
            size = self._random.randint(self.options.largest_segment // 2, self.options.largest_segment)
            segments.append(prefix + data[at : at + size])
            at += size
        return segments


@dataclass(frozen=True, slots=True)
class ServerAddress:
    """``host:port`` of the command line."""

    host: str
    port: int
    text: str = field(default="", compare=False)


def parse_address(text: str) -> ServerAddress:
    """Read ``host:port`` or ``[v6]:port``; raises ConfigurationError."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise ConfigurationError(f"{text!r} is no HOST:PORT")
    return ServerAddress(host.strip("[]"), int(port), text)


def bytes_of(text: str) -> bytes:
    r"""Bytes of a command line's text with the escapes ``\r``, ``\n``, ``\t``, ``\\`` and ``\xNN``."""
    plain = {"r": "\r", "n": "\n", "t": "\t", "\\": "\\"}

    def replace(match: re.Match[str]) -> str:
        return plain.get(match[1]) or chr(int(match[1][1:], 16))

    return re.sub(r"\\(r|n|t|\\|x[0-9a-fA-F]{2})", replace, text).encode("latin-1", "replace")


def tls_context(ca_file: str | None, insecure: bool) -> ssl.SSLContext:
    """A client's TLS: the system's authorities or ``ca_file``; ``insecure`` checks nothing (for self-signed tests)."""
    context = ssl.create_default_context(cafile=ca_file)
    if insecure:
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
    return context
