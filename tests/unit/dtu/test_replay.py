"""A device's connection and the replay, against a real TCP server."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from tests.unit.dtu.frames import inertial, msm

from plumbline.errors import ConfigurationError
from plumbline.signals import System
from plumbline_dtu.device import Device, DeviceError, DeviceOptions, bytes_of, parse_address
from plumbline_dtu.replay import Replay, play

Connections = list[bytearray]


@asynccontextmanager
async def server(hang_up_after: int | None = None) -> AsyncIterator[tuple[int, Connections]]:
    """A listener that keeps what each connection sent; the first hangs up after so many bytes."""
    connections: Connections = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        received = bytearray()
        connections.append(received)
        first = len(connections) == 1
        while data := await reader.read(65536):
            received += data
            if first and hang_up_after is not None and len(received) >= hang_up_after:
                break
        writer.close()

    listener = await asyncio.start_server(serve, "127.0.0.1", 0)
    async with listener:
        yield listener.sockets[0].getsockname()[1], connections
        await asyncio.sleep(0.05)


async def wait_for(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(10):
        while not condition():  # noqa: ASYNC110 - counters have no event to wait for
            await asyncio.sleep(0.01)


async def test_everything_arrives_behind_the_registration() -> None:
    """Oracle: the bytes that were sent."""
    async with server() as (port, connections):
        device = Device(DeviceOptions("127.0.0.1", port, registration=b"D1,secret\r\n"))
        run = asyncio.create_task(device.run())
        data = bytes(range(256)) * 40
        device.send(data)
        device.close()
        await run
        await wait_for(lambda: bool(connections) and len(connections[0]) == 11 + len(data))
        assert bytes(connections[0]) == b"D1,secret\r\n" + data


async def test_prefix_stands_before_every_packet() -> None:
    """Oracle: taking the prefixes away leaves the data; packets are cut at odd places."""
    async with server() as (port, connections):
        device = Device(DeviceOptions("127.0.0.1", port, b"<ID>", prefix_packets=True, largest_segment=101))
        run = asyncio.create_task(device.run())
        device.send(b"x" * 1000)
        device.close()
        await run
        await wait_for(lambda: bool(connections) and connections[0].count(b"x") == 1000)
        packets = bytes(connections[0]).split(b"<ID>")
        assert packets[0] == b""
        assert 10 <= len(packets) - 1 <= 20
        assert {len(packet) for packet in packets[1:-1]} <= set(range(50, 102))


async def test_a_lost_connection_is_taken_up_again() -> None:
    """Oracle: the second connection registers anew and what was queued afterwards arrives."""
    async with server(hang_up_after=10) as (port, connections):
        device = Device(DeviceOptions("127.0.0.1", port, registration=b"D1\r\n"))
        run = asyncio.create_task(device.run())
        device.send(b"0123456789")
        await wait_for(lambda: device.counters.connections == 2)
        device.send(b"after")
        device.close()
        await run
        await wait_for(lambda: len(connections) == 2 and connections[1].endswith(b"after"))
        assert bytes(connections[1]) == b"D1\r\nafter"


async def test_heartbeats_and_their_echo_are_counted() -> None:
    """Oracle: the counters and the bytes between."""
    async with server() as (port, connections):
        options = DeviceOptions("127.0.0.1", port, b"ID", heartbeat=b"$HB", heartbeat_interval_s=0.02)
        device = Device(options)
        run = asyncio.create_task(device.run())
        await wait_for(lambda: device.counters.heartbeats >= 3)
        device.close()
        await run
        assert bytes(connections[0]).startswith(b"ID$HB$HB")


async def test_buffer_loses_the_oldest() -> None:
    """Oracle: the count of lost bytes, while nobody listens."""
    device = Device(DeviceOptions("127.0.0.1", 1, buffer_bytes=100))
    for _ in range(5):
        device.send(b"x" * 40)
    assert device.counters.lost_bytes == 120


async def test_a_replay_gives_up_if_told_to(tmp_path: Path) -> None:
    """Oracle: nobody listens on the port; without the option a device would try for ever."""
    (tmp_path / "a").write_bytes(msm(System.GPS, 0))
    options = DeviceOptions("127.0.0.1", 1, give_up_s=0.0)
    async with asyncio.timeout(20):
        with pytest.raises(DeviceError, match="no connection"):
            await play(Replay([("a", tmp_path / "a")], options, speed=0.0))


async def test_replay_keeps_pace_and_order(tmp_path: Path) -> None:
    """Oracle: each stream's bytes on its own connection; 3 s last 0.3 s at ten times the pace."""
    (tmp_path / "rover").write_bytes(b"".join(msm(System.GPS, 1000 * k) for k in range(4)))
    (tmp_path / "sensor").write_bytes(b"".join(inertial(1000 * k) for k in range(4)))
    async with server() as (port, connections):
        files = [("rover", tmp_path / "rover"), ("sensor", tmp_path / "sensor")]
        replay = Replay(files, DeviceOptions("127.0.0.1", port, registration=b"{name}\r\n"), speed=10.0)
        started = asyncio.get_running_loop().time()
        counters = await play(replay)
        assert asyncio.get_running_loop().time() - started >= 0.3
        await wait_for(lambda: sum(map(len, connections)) == sum(c.sent_bytes for c in counters.values()) + 15)
        got = sorted(bytes(connection) for connection in connections)
    assert got == [name.encode() + b"\r\n" + path.read_bytes() for name, path in files]


async def test_replay_on_one_connection(tmp_path: Path) -> None:
    """Oracle: pieces in time order, ties in the order given."""
    (tmp_path / "a").write_bytes(msm(System.GPS, 0) + msm(System.GPS, 1000))
    (tmp_path / "b").write_bytes(inertial(0) + inertial(1000))
    async with server() as (port, connections):
        options = DeviceOptions("127.0.0.1", port, registration=b"ID\r\n")
        await play(Replay([("a", tmp_path / "a"), ("b", tmp_path / "b")], options, speed=0.0))
        expected = b"ID\r\n" + msm(System.GPS, 0) + inertial(0) + msm(System.GPS, 1000) + inertial(1000)
        await wait_for(lambda: bool(connections) and bytes(connections[0]) == expected)


def test_addresses_and_escapes() -> None:
    """Oracle: the text."""
    assert (parse_address("[::1]:9000").host, parse_address("h:1").port) == ("::1", 1)
    assert bytes_of(r"ID\r\n\x02\\n") == b"ID\r\n\x02\\n"
    for text in ("host", "host:", "host:0", "host:99999", ":1"):
        with pytest.raises(ConfigurationError):
            parse_address(text)
