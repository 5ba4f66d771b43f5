"""Devices over real sockets: good ones, bad ones, many at once; RTKLIB's str2str as an independent NTRIP pusher."""

import asyncio
import base64
import contextlib
import shutil
import ssl
import subprocess
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest

from plumbline.config import DeviceSettings, NtripSource, ServerSettings, StationSettings
from plumbline.ingest import ConnectionEvent, Directory, IngestServer, NtripClient, ReceiveClock
from plumbline.ingest.http_chunked import chunk
from plumbline.rtcm3.framing import frame

FRAME = frame(b"\x43\x50\x07" + bytes(50))  # 1077 of RTCM station 7


def station(name: str, *registrations: str, **device: object) -> StationSettings:
    return StationSettings(station=name, device=DeviceSettings(registrations=registrations, **device))  # type: ignore[arg-type]


STATIONS = (
    station("plain", "HELLO"),
    station("closed", token="pw"),
    station("beat", "BEAT", heartbeat="HB", echo_heartbeat=True),
    station("prefixed", "PFX1234", prefix_mode=True),
    station("one", "GATE", rtcm_station_ids=(7,)),
    station("two", "GATE", rtcm_station_ids=(8,)),
)


class Listening:
    """A listener and what came of it."""

    def __init__(self, **settings: object) -> None:
        values: dict[str, object] = {
            "ingest_host": "127.0.0.1",
            "ingest_port": 0,
            "registration_deadline_s": 1.0,
        } | settings
        self.bytes: dict[str, bytes] = {}
        self.events: list[ConnectionEvent] = []
        self.server = IngestServer(
            ServerSettings(**values),  # type: ignore[arg-type]
            Directory(STATIONS),
            self._sink,
            self.events.append,
            ReceiveClock(),
        )

    def _sink(self, name: str, data: bytes) -> None:
        self.bytes[name] = self.bytes.get(name, b"") + data

    async def call(self, *pieces: bytes, pause_s: float = 0.0, read: bool = False) -> bytes:
        """Connect, send, and read until the server closes (``read``), or close after a moment."""
        reader, writer = await asyncio.open_connection("127.0.0.1", self.server.port)
        try:
            for piece in pieces:
                writer.write(piece)
                await writer.drain()
                await asyncio.sleep(pause_s)
            if read:
                async with asyncio.timeout(5.0):
                    return await reader.read()
            await asyncio.sleep(0.05)
        except ConnectionError:
            pass
        finally:
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()
        return b""

    async def until(self, done: Callable[[], object], timeout_s: float = 5.0) -> None:
        async with asyncio.timeout(timeout_s):
            while not done():  # noqa: ASYNC110 - the world outside has no event
                await asyncio.sleep(0.01)


@pytest.fixture
async def listening() -> AsyncIterator[Callable]:
    started: list[Listening] = []

    async def start(**settings: object) -> Listening:
        one = Listening(**settings)
        await one.server.start()
        started.append(one)
        return one

    yield start
    for one in started:
        await one.server.stop()
        await one.until(lambda one=one: one.server.n_connections == 0)


async def test_forms_of_registration_over_tcp(listening: Callable) -> None:
    at = await listening()
    await at.call(b"HELLO" + FRAME)
    await at.call(b"closed,pw\r\n", FRAME, pause_s=0.05)
    await at.call(b"PFX1234" + FRAME[:20] + b"PFX1234" + FRAME[20:])
    await at.call(b"GATE" + FRAME + frame(b"\x43\x50\x08" + bytes(9)))
    await at.call(b"SOURCE pw /closed\r\nSource-Agent: NTRIP t\r\n\r\n", FRAME, pause_s=0.05)
    authorisation = base64.b64encode(b"u:pw")
    head = b"POST /closed HTTP/1.1\r\nAuthorization: Basic " + authorisation + b"\r\nTransfer-Encoding: chunked\r\n\r\n"
    await at.call(head, chunk(FRAME[:9]), chunk(FRAME[9:]), pause_s=0.02)
    await at.until(lambda: at.bytes.get("closed") == FRAME * 3)
    assert at.bytes["plain"] == at.bytes["prefixed"] == at.bytes["one"] == FRAME
    assert at.bytes["two"] == frame(b"\x43\x50\x08" + bytes(9))
    assert {event.station for event in at.events if event.kind == "connected"} >= {"plain", "closed", "one", "two"}


async def test_what_a_refused_device_sees(listening: Callable) -> None:
    at = await listening()
    assert await at.call(b"SOURCE bad /closed\r\n\r\n", read=True) == b"ERROR - Bad Password\r\n"
    assert (await at.call(b"POST /nobody HTTP/1.1\r\n\r\n", read=True)).startswith(b"HTTP/1.1 404 Not Found\r\n")
    assert await at.call(b"867322041234567", read=True) == b""  # closed after a while, listed
    assert await at.call(b"closed,wrong\n", read=True) == b""
    refusals = at.server.callers.refusals
    assert refusals == {"bad_token": 2, "unknown_device": 2}
    assert [caller.identity for caller in at.server.callers.listed()] == ["closed", "867322041234567", "nobody"]
    await at.server.change_directory(Directory([*STATIONS, station("new", "867322041234567")]))
    assert "867322041234567" not in {caller.identity for caller in at.server.callers.listed()}
    await at.call(b"867322041234567" + FRAME)
    await at.until(lambda: at.bytes.get("new") == FRAME)  # adopted


async def test_heartbeats_are_echoed(listening: Callable) -> None:
    at = await listening()
    reader, writer = await asyncio.open_connection("127.0.0.1", at.server.port)
    writer.write(b"BEAT" + FRAME + b"HB")
    async with asyncio.timeout(2.0):
        assert await reader.readexactly(2) == b"HB"
    writer.close()
    await at.until(lambda: at.server.counters["heartbeats"] == 1)


async def test_a_port_of_its_own_needs_no_registration(listening: Callable) -> None:
    at = await listening()
    await at.server.change_directory(Directory([station("ported", port=19731)]))
    _, writer = await asyncio.open_connection("127.0.0.1", 19731)
    writer.write(FRAME)
    await at.until(lambda: at.bytes.get("ported") == FRAME)
    writer.close()
    await at.server.change_directory(Directory())
    with pytest.raises(ConnectionError):
        await asyncio.open_connection("127.0.0.1", 19731)


async def test_the_newer_connection_wins(listening: Callable) -> None:
    at = await listening()
    reader, writer = await asyncio.open_connection("127.0.0.1", at.server.port)
    writer.write(b"HELLO" + FRAME)
    await at.until(lambda: "plain" in at.bytes)
    await at.call(b"HELLO" + FRAME)
    async with asyncio.timeout(2.0):
        with contextlib.suppress(ConnectionError):
            assert await reader.read() == b""
    writer.close()
    assert at.bytes["plain"] == FRAME * 2
    assert at.server.counters["superseded"] == 1
    await at.until(lambda: [event.kind for event in at.events] == ["connected", "connected", "disconnected"])


async def test_slow_silent_huge_and_senseless_callers(listening: Callable) -> None:
    at = await listening(registration_deadline_s=0.6, idle_deadline_s=0.7)
    await asyncio.gather(
        at.call(b"", read=True),  # says nothing
        at.call(*[b"S"] + [bytes([c]) for c in b"OURCE pw /clo"], pause_s=0.06, read=True),  # a byte at a time
        at.call(b"SOURCE " + b"x" * 100_000, read=True),
        at.call(bytes(range(256)) * 4000, read=True),
        at.call(FRAME * 100, read=True),
        at.call(b"HEL"),  # goes away in the middle
        at.call(b"HELLO" + FRAME, read=True),  # half open: admitted, then silent for ever
    )
    refusals = at.server.callers.refusals
    assert refusals["registration_timeout"] == 2
    assert refusals["registration_too_long"] == 1
    assert refusals["data_before_registration"] == 1
    assert refusals["unknown_device"] == 1
    assert refusals["closed_before_registration"] == 1
    assert [event.reason for event in at.events if event.kind == "disconnected"] == ["idle"]
    await at.until(lambda: at.server.n_connections == 0)


async def test_caps_in_total_and_by_address(listening: Callable) -> None:
    at = await listening(max_connections_per_address=3, registration_deadline_s=5.0)
    open_ones = [await asyncio.open_connection("127.0.0.1", at.server.port) for _ in range(5)]
    await at.until(lambda: at.server.callers.refusals["too_many_connections_from_address"] == 2)
    for _, writer in open_ones:
        writer.close()
    await at.until(lambda: at.server.n_connections == 0)
    await at.call(b"HELLO" + FRAME)  # there is room again
    assert at.bytes["plain"] == FRAME


async def test_a_reconnect_storm_is_survived(listening: Callable) -> None:
    at = await listening()
    for _ in range(5):
        await asyncio.gather(*(at.call(b"HELLO" + FRAME) for _ in range(60)))
    await at.until(lambda: at.server.n_connections == 0)
    assert at.server.counters["connections"] == 300
    assert len(at.bytes["plain"]) >= len(FRAME) * 5
    assert at.server.connected() == {}
    await at.call(b"HELLO" + FRAME)
    assert at.bytes["plain"].endswith(FRAME)


async def test_tls(listening: Callable, tmp_path: Path) -> None:
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    command = f"openssl req -x509 -newkey rsa:2048 -nodes -keyout {key} -out {certificate} -days 1 -subj /CN=localhost"
    await asyncio.to_thread(subprocess.run, command.split(), check=True, capture_output=True)
    at = await listening(tls_certificate=certificate, tls_key=key)
    context = ssl.create_default_context(cafile=certificate)
    _, writer = await asyncio.open_connection("127.0.0.1", at.server.port, ssl=context, server_hostname="localhost")
    writer.write(b"HELLO" + FRAME)
    await at.until(lambda: at.bytes.get("plain") == FRAME)
    writer.close()
    await at.call(b"HELLO" + FRAME)  # without TLS: no entry
    assert at.bytes["plain"] == FRAME


@pytest.mark.realdata
@pytest.mark.skipif(shutil.which("str2str") is None, reason="RTKLIB's str2str is not installed")
async def test_rtklib_pushes_over_tcp_and_ntrip(listening: Callable, data_dir: Path) -> None:
    at = await listening()
    recording = data_dir / "str-2018-195" / "week-rollover-STR24.rtcm3"
    at_port = f"127.0.0.1:{at.server.port}"
    pusher = await asyncio.create_subprocess_exec(
        *("str2str", "-in", str(recording), "-out", f"ntrips://:pw@{at_port}/closed"),
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.DEVNULL,
    )
    try:
        await at.until(lambda: len(at.bytes.get("closed", b"")) >= 65_536, timeout_s=30.0)
    finally:
        with contextlib.suppress(ProcessLookupError):
            pusher.kill()
        await pusher.wait()
    # its first block; of an unpaced file it throws away later ones that do not fit its socket
    assert at.bytes["closed"][:65_536] == recording.read_bytes()[:65_536]
    assert any(event.reason.startswith("ntrip1") for event in at.events)


class Caster:
    """A caster of answers, one a connection."""

    def __init__(self, *answers: bytes) -> None:
        self._answers = list(answers)
        self.requests: list[bytes] = []

    async def __aenter__(self) -> "Caster":
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.requests.append(await reader.readuntil(b"\r\n\r\n"))
        answer = self._answers.pop(0) if self._answers else b""
        for begin in range(0, len(answer), 11):
            writer.write(answer[begin : begin + 11])
            await writer.drain()
        if self._answers:
            writer.close()
        else:
            await reader.read()  # the last connection stays open, silent
            writer.close()

    async def __aexit__(self, *exception: object) -> None:
        self._server.close()


async def test_ntrip_client_through_refusals_breaks_and_stalls() -> None:
    got: list[bytes] = []
    events: list[tuple[str, str, str]] = []
    chunked = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"
    answers = (
        b"HTTP/1.1 401 Unauthorized\r\n\r\n",
        b"HTTP/1.1 503 Service Unavailable\r\nRetry-After: 5\r\n\r\n",
        chunked + chunk(FRAME) + chunk(FRAME)[:10],  # breaks off inside a chunk: nothing of it may leak into the next
        chunked + chunk(FRAME) + b"0\r\n\r\n",
        b"ICY 200 OK\r\n\r\n" + FRAME,
    )
    pauses: list[int | None] = []

    def pause(failures: int, response: object) -> float:
        pauses.append(getattr(response, "status", None))
        return 0.01

    async with Caster(*answers) as caster:
        url = f"http://127.0.0.1:{caster.port}/MOUNT"
        source = NtripSource(station="ssr", url=url, user="u", password="p", send_position_ecef_m=(6378137.0, 0.0, 0.0))
        client = NtripClient(
            source,
            lambda _, data: got.append(data),
            lambda *event: events.append(event),
            ReceiveClock().now,
            stall_s=0.5,
            pause=pause,
        )
        running = asyncio.create_task(client.run())
        async with asyncio.timeout(10.0):
            while len(caster.requests) < 6:  # noqa: ASYNC110 - the world outside has no event
                await asyncio.sleep(0.01)
        running.cancel()
    assert b"".join(got) == FRAME + FRAME[:6] + FRAME + FRAME
    assert pauses[:4] == [401, 503, None, None]
    assert [e[2] for e in events if "nothing came" in e[2]] == ["nothing came for 0.5 s"]
    assert all(b"\r\nNtrip-GGA: $GPGGA," in request for request in caster.requests)
