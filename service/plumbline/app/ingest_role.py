"""The ingest role: what devices and casters send goes to the archive first and onto the bus second."""

import asyncio
import contextlib
import logging
from collections import Counter
from pathlib import Path

from plumbline.app.archive_writer import ArchiveWriter
from plumbline.app.publisher import Publisher
from plumbline.archive import Archive
from plumbline.bus import Bus, Inbox, Outbox, codec, keys
from plumbline.bus.messages import (
    ArchiveReply,
    Report,
    StationConfig,
    decode_configs,
    encode_archive_reply,
    encode_chunk,
    encode_configs,
    encode_fields,
)
from plumbline.config import ServerSettings
from plumbline.ingest import ConnectionEvent, Directory, IngestServer, NtripClient, ReceiveClock
from plumbline.records import Chunk

log = logging.getLogger(__name__)

LEAST_TICK_S = 0.01
SYNC_INTERVAL_S = 1.0


class IngestRole:
    """Owns the archive of this machine. Without a store to ask it begins with the stations it knew last."""

    def __init__(self, settings: ServerSettings, bus: Bus) -> None:
        self._settings = settings
        self._bus = bus
        self._configs: dict[str, StationConfig] = {}
        self._cache = settings.data_dir / "stations.msgpack"
        self._tasks: list[asyncio.Task[None]] = []
        self.counters: Counter[str] = Counter()

    async def start(self) -> None:
        """Open the archive and listen; raises OSError when the ingest port is taken."""
        self._archive = await asyncio.to_thread(Archive, self._settings.data_dir / "archive")
        for station, mended in self._archive.mended.items():
            log.warning("archive of %s: %d bytes mended after a crash", station, mended)
        self._clock = ReceiveClock(self._archive.last_receive_ns())
        self._outbox = Outbox(self._bus)
        self._writer = ArchiveWriter(self._archive, self._clock, self._publish_chunk)
        archive_id = self._archive.archive_id
        self._publisher = Publisher(self._outbox, archive_id, self._clock.now, self._writer.complete_ns)
        self._inbox = Inbox()
        self._bus.subscribe(f"{keys.SETTINGS}/**", self._inbox)
        self._bus.watch(f"{keys.ALIVE_STORE}/**", self._inbox)
        await self._learn_stations()
        self.server = IngestServer(self._settings, self._directory(), self._writer.take, self._event, self._clock)
        self._bus.answer(keys.of(keys.QUERY_ARCHIVE, archive_id, "*"), self._answer_archive)
        self._bus.answer(keys.of(keys.QUERY_DEVICES, archive_id), self._answer_devices)
        self._bus.answer(keys.of(keys.QUERY_REPORT, archive_id), self._answer_report)
        await self.server.start()
        self._bus.announce(keys.of(keys.ALIVE_INGEST, archive_id))
        create = asyncio.get_running_loop().create_task
        self._tasks = [create(self._tick()), create(self._sync()), create(self._follow_settings())]
        for source in self._settings.ntrip:
            client = NtripClient(source, self._writer.take, self._ntrip_event, self._clock.now)
            self._tasks.append(create(client.run()))

    async def stop(self) -> None:
        """Accept nothing any more; everything received is then on the bus. The archive still answers."""
        for task in self._tasks:
            task.cancel()
        await self.server.stop()
        self._writer.retry()
        self._publisher.tick()
        await self._outbox.close()
        await asyncio.to_thread(self._archive.sync)

    async def close(self) -> None:
        """Close the archive; nobody asks any more."""
        await asyncio.to_thread(self._archive.close)

    # ----------------------------------------------------------------------------------------- bytes

    def _publish_chunk(self, chunk: Chunk) -> None:
        self._publisher.put(keys.of(keys.RAW, chunk.station), encode_chunk(chunk))

    def _event(self, event: ConnectionEvent) -> None:
        log.info("%s %s: %s", event.station, event.kind, event.reason)
        body = codec.encode([event.kind, event.reason, event.t_gps_ns])
        self._publisher.put(keys.of(keys.CONNECTION, event.station), body)

    def _ntrip_event(self, station: str, kind: str, reason: str) -> None:
        self._event(ConnectionEvent(station, kind, reason, self._clock.now()))

    async def _tick(self) -> None:
        interval_s = max(self._settings.hold_back_s, LEAST_TICK_S)
        while True:
            self._writer.retry()
            self._publisher.tick()
            await asyncio.sleep(interval_s)

    async def _sync(self) -> None:
        while True:
            await asyncio.sleep(SYNC_INTERVAL_S)
            try:
                await asyncio.to_thread(self._archive.sync)
            except OSError as error:
                self.counters["archive_errors"] += 1
                log.error("the archive cannot be synced: %s", error)

    # ----------------------------------------------------------------------------------------- answers

    async def _answer_archive(self, key: str, payload: bytes) -> bytes | None:
        """[receive time to begin at, about how many bytes]."""
        station = keys.last_part(key)
        from_ns, max_bytes = codec.decode(payload)
        end, t_now_ns, generation = self._archive.end(station), self._writer.complete_ns(), self._publisher.generation
        chunks = await asyncio.to_thread(self._archive.read, station, 0, max_bytes, from_ns)
        return encode_archive_reply(ArchiveReply(end, generation, t_now_ns, tuple(chunks)))

    async def _answer_devices(self, key: str, payload: bytes) -> bytes:
        """Unknown devices, and the stations with a device connected."""
        callers = [[getattr(caller, name) for name in caller.__slots__] for caller in self.server.callers.listed()]
        return codec.encode({"callers": callers, "connected": self.server.connected()})

    async def _answer_report(self, key: str, payload: bytes) -> bytes:
        failing = {"archive": self._writer.failing} if self._writer.failing else {}
        return encode_fields(Report("ingest", self._archive.archive_id, self._metrics(), failing))

    def _metrics(self) -> dict[str, int]:
        counters = dict(self.counters)
        for part in (self._publisher.counters, self._writer.counters, self.server.counters):
            counters |= part
        counters |= {f"refused_{reason}": n for reason, n in self.server.callers.refusals.items()}
        return counters | {
            "open_connections": self.server.n_connections,
            "connected_stations": len(self.server.connected()),
            "clock_steps_back": self._clock.steps_back,
            "bytes_waiting_for_disk": self._writer.waiting_bytes,
        }

    # ----------------------------------------------------------------------------------------- stations

    async def _learn_stations(self) -> None:
        """Ask the store; where it does not answer, the last answer, kept in a file, has to do until it comes."""
        for _ in range(10):
            if await self._ask_store():
                return
            await asyncio.sleep(0.2)
        with contextlib.suppress(OSError, ValueError):
            self._configs = {c.station: c for c in decode_configs(self._cache.read_bytes())}
        log.warning("no store answers: beginning with %d stations known before", len(self._configs))

    async def _ask_store(self) -> bool:
        answers = await self._bus.query(keys.QUERY_STATIONS, timeout_s=1.0)
        if answers:
            self._configs = {c.station: c for answer in answers for c in decode_configs(answer)}
            self._remember()
        return bool(answers)

    def _remember(self) -> None:
        temporary = Path(f"{self._cache}.new")
        with contextlib.suppress(OSError):
            temporary.write_bytes(encode_configs(list(self._configs.values())))
            temporary.replace(self._cache)

    def _directory(self) -> Directory:
        """Stations that devices may be of: all but those that casters are asked for."""
        fetched = {source.station for source in self._settings.ntrip}
        return Directory(c.settings for c in self._configs.values() if c.settings and c.station not in fetched)

    async def _follow_settings(self) -> None:
        """Changes as they are told; a store that comes (back) is asked for what was missed meanwhile."""
        while True:
            for message in await self._inbox.get():
                if message.key.startswith(keys.ALIVE_STORE):
                    if message.alive:
                        await self._ask_store()
                    continue
                try:
                    self._configs |= {config.station: config for config in decode_configs(message.payload)}
                except ValueError as error:
                    log.error("unreadable settings: %s", error)
            self._configs = {name: c for name, c in self._configs.items() if c.settings is not None}
            self._remember()
            await self.server.change_directory(self._directory())
