"""A client of NTRIP casters (versions 1 and 2) under asyncio: fetches a mount point for ever, and behaves itself.

No state outlives a connection: every attempt has its own buffers. A caster that says no is asked again at its own pace:
``Retry-After`` where it gives one, else a pause that suits the answer, always with jitter.
"""

import asyncio
import base64
import contextlib
import logging
import random
import ssl
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from urllib.parse import urlsplit

import numpy as np

from plumbline import __version__
from plumbline.config import NtripSource
from plumbline.gnss.earth_frames import geodetic_from_ecef
from plumbline.gps_time import utc_from_gps
from plumbline.ingest.http_chunked import ChunkedDecoder

log = logging.getLogger(__name__)

MAX_HEAD_BYTES = 16_384
FIRST_PAUSE_S = 1.0
LONGEST_PAUSE_S = 120.0
REFUSED_PAUSE_S = {401: 300.0, 403: 300.0, 404: 120.0, 409: 60.0, 429: 120.0, 503: 30.0}
GGA_INTERVAL_S = 10.0
HEALTHY_AFTER_S = 30.0  # a connection that lasted this long resets the back-off


@dataclass(frozen=True, slots=True)
class Response:
    """The head of a caster's answer."""

    status: int
    reason: str
    chunked: bool = False
    retry_after_s: float | None = None


class StreamEnded(Exception):
    """The caster's answer or stream is over; ``response`` is set when it said no."""

    def __init__(self, reason: str, response: Response | None = None) -> None:
        super().__init__(reason)
        self.response = response


def request(source: NtripSource, gga: str | None = None) -> bytes:
    """The GET request for a source's mount point."""
    url = urlsplit(source.url)
    lines = [
        f"GET {url.path or '/'} HTTP/1.{1 if source.version == 2 else 0}",
        f"User-Agent: NTRIP plumbline/{__version__}",
    ]
    if source.version == 2:
        lines += [f"Host: {url.netloc.rpartition('@')[2]}", "Ntrip-Version: Ntrip/2.0", "Connection: close"]
        lines += [f"Ntrip-GGA: {gga}"] if gga else []
    if source.user is not None:
        credentials = f"{source.user}:{source.password or ''}".encode()
        lines.append(f"Authorization: Basic {base64.b64encode(credentials).decode('ascii')}")
    return "\r\n".join([*lines, "", ""]).encode("utf-8")


def parse_head(data: bytes) -> tuple[Response, bytes] | None:
    """The head of an answer and what came behind it; None: more is needed. Raises StreamEnded for what is no answer.

    ``ICY 200 OK`` needs no empty line behind it; a source table means that there is no such mount point.
    """
    first, end, rest = data.partition(b"\r\n")
    words = first.decode("latin-1").split(None, 2)
    if end and words[:2] == ["ICY", "200"]:
        return Response(200, "OK"), rest.removeprefix(b"\r\n")
    if end and words[:1] in (["SOURCETABLE"], ["ERROR"]):
        status = 401 if "password" in words[-1].lower() else 404
        return Response(status, first.decode("latin-1")), b""
    if end and (len(words) < 2 or not words[0].startswith("HTTP/") or not words[1].isdigit()):
        raise StreamEnded(f"not an NTRIP answer: {first[:60]!r}")
    head, end, rest = data.partition(b"\r\n\r\n")
    if not end and len(data) > MAX_HEAD_BYTES:
        raise StreamEnded("not an NTRIP caster: its answer has no end")
    return (_http_response(words, head), rest) if end else None


def _http_response(words: list[str], head: bytes) -> Response:
    """The answer of a version 2 caster, from the words of its first line and its whole head."""
    pairs = (line.partition(":") for line in head.decode("latin-1").split("\r\n")[1:])
    headers = {name.strip().lower(): value.strip() for name, _, value in pairs}
    status, reason = int(words[1]), words[2] if len(words) > 2 else ""
    if status == 200 and "sourcetable" in headers.get("content-type", "").lower():
        return Response(404, "no such mount point (the caster sent its table)")
    retry = headers.get("retry-after", "")
    chunked = "chunked" in headers.get("transfer-encoding", "").lower()
    return Response(status, reason, chunked, float(retry) if retry.isdigit() else None)


def gga_sentence(position_ecef_m: tuple[float, float, float], t_gps_ns: int) -> str:
    """NMEA 0183 GGA of a position, as casters of virtual reference stations want it."""
    latitude, longitude, height_m = (float(v) for v in geodetic_from_ecef(np.array(position_ecef_m)))
    fields = [f"{utc_from_gps(t_gps_ns):%H%M%S}.00"]
    for angle, width, sides in ((latitude, 2, "NS"), (longitude, 3, "EW")):
        minutes = round(abs(float(np.degrees(angle))) * 60.0, 5)
        fields += [f"{int(minutes // 60):0{width}d}{minutes % 60:08.5f}", sides[angle < 0]]
    body = f"GPGGA,{','.join(fields)},1,12,1.0,{height_m:.2f},M,0.00,M,,"
    checksum = 0
    for byte in body.encode("ascii"):
        checksum ^= byte
    return f"${body}*{checksum:02X}"


def pause_s(failures: int, response: Response | None, jitter: Callable[[], float] = random.random) -> float:
    """How long to wait before the next attempt: what the caster asks for, or ever longer, with jitter."""
    if response is not None and response.retry_after_s is not None:
        return response.retry_after_s * (1.0 + 0.1 * jitter())
    least = REFUSED_PAUSE_S.get(response.status, 10.0) if response is not None else 0.0
    backed_off = min(FIRST_PAUSE_S * 2.0 ** min(failures, 16), LONGEST_PAUSE_S)
    return max(least, backed_off) * (0.5 + jitter())


class NtripClient:
    """Fetches one source into ``sink(station, data)``; ``on_event(station, kind, reason)`` hears of its connections."""

    def __init__(
        self,
        source: NtripSource,
        sink: Callable[[str, bytes], None],
        on_event: Callable[[str, str, str], None],
        clock: Callable[[], int],
        stall_s: float = 60.0,
        pause: Callable[[int, Response | None], float] = pause_s,
    ) -> None:
        self._source = source
        self._sink = sink
        self._on_event = on_event
        self._clock = clock
        self._stall_s = stall_s
        self._pause = pause
        self.counters: Counter[str] = Counter()

    async def run(self) -> None:
        """Fetch until cancelled."""
        loop = asyncio.get_running_loop()
        failures = 0
        while True:
            began = loop.time()
            response = None
            try:
                await self._fetch()
            except StreamEnded as error:
                reason, response = str(error), error.response
            except TimeoutError:
                reason = f"nothing came for {self._stall_s:g} s"
            except (OSError, ssl.SSLError) as error:
                reason = f"cannot reach the caster: {error}"
            failures = 0 if loop.time() - began > HEALTHY_AFTER_S else failures + 1
            wait_s = self._pause(failures - 1, response)
            self.counters["reconnects"] += 1
            log.warning("%s: %s; again in %.0f s", self._source.station, reason, wait_s)
            self._on_event(self._source.station, "disconnected", reason)
            await asyncio.sleep(wait_s)

    async def _fetch(self) -> None:
        """One connection, from open to its end, which always raises."""
        url = urlsplit(self._source.url)
        secure = url.scheme == "https"
        async with asyncio.timeout(self._stall_s):
            reader, writer = await asyncio.open_connection(
                url.hostname,
                url.port or (443 if secure else 2101),
                ssl=ssl.create_default_context() if secure else None,
            )
        sender = None
        try:
            writer.write(request(self._source, self._gga()))
            response, rest = await self._head(reader)
            if response.status != 200:
                raise StreamEnded(f"{response.status} {response.reason}", response)
            self._on_event(self._source.station, "connected", f"{url.hostname}{url.path}")
            sender = asyncio.create_task(self._send_gga(writer))
            await self._body(reader, response, rest)
        finally:
            if sender is not None:
                sender.cancel()
            writer.close()
            with contextlib.suppress(OSError, ssl.SSLError):
                await writer.wait_closed()

    async def _head(self, reader: asyncio.StreamReader) -> tuple[Response, bytes]:
        data = b""
        while (parsed := parse_head(data)) is None:
            data += await self._read(reader)
        return parsed

    async def _body(self, reader: asyncio.StreamReader, response: Response, data: bytes) -> None:
        decoder = ChunkedDecoder() if response.chunked else None
        while True:
            content = decoder.receive(data) if decoder is not None else data
            if content:
                self.counters["bytes"] += len(content)
                self._sink(self._source.station, content)
            if decoder is not None and (decoder.error or decoder.ended):
                raise StreamEnded(decoder.error or "the caster ended the stream")
            data = await self._read(reader)

    async def _read(self, reader: asyncio.StreamReader) -> bytes:
        async with asyncio.timeout(self._stall_s):
            data = await reader.read(65_536)
        if not data:
            raise StreamEnded("the caster closed the connection")
        return data

    def _gga(self) -> str | None:
        position = self._source.send_position_ecef_m
        return None if position is None else gga_sentence(position, self._clock())

    async def _send_gga(self, writer: asyncio.StreamWriter) -> None:
        """Tell the caster where we are, at once and every ten seconds."""
        while (gga := self._gga()) is not None:
            writer.write(f"{gga}\r\n".encode("ascii"))
            with contextlib.suppress(OSError):
                await writer.drain()
            await asyncio.sleep(GGA_INTERVAL_S)
