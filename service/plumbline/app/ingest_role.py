"""The ingest role: what devices and casters send goes to the archive first and onto the bus second."""

import asyncio
import contextlib
import logging
from collections import Counter
from pathlib import Path

from plumbline.archive import Archive
from plumbline.bus import Bus, Inbox, Outbox, codec, keys
from plumbline.bus.messages import (
    ArchiveReply,
    StationConfig,
    Tick,
    decode_configs,
    encode_archive_reply,
    encode_chunk,
    encode_configs,
    encode_fields,
)
from plumbline.config import ServerSettings
from plumbline.ingest import ConnectionEvent, Directory, IngestServer, NtripClient, ReceiveClock

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
        self._generation = self._clock.now()
        self._outbox = Outbox(self._bus)
        self._inbox = Inbox()
        self._bus.subscribe(f"{keys.SETTINGS}/**", self._inbox)
        await self._learn_stations()
        self.server = IngestServer(self._settings, self._directory(), self._sink, self._event, self._clock)
        archive_id = self._archive.archive_id
        self._bus.answer(keys.of(keys.QUERY_ARCHIVE, archive_id, "*"), self._answer_archive)
        self._bus.answer(keys.of(keys.QUERY_DEVICES, archive_id), self._answer_devices)
        await self.server.start()
        self._bus.announce(keys.of(keys.ALIVE_INGEST, archive_id))
        create = asyncio.get_running_loop().create_task
        self._tasks = [create(self._tick()), create(self._sync()), create(self._follow_settings())]
        for source in self._settings.ntrip:
            client = NtripClient(source, self._sink, self._ntrip_event, self._clock.now)
            self._tasks.append(create(client.run()))

    async def stop(self) -> None:
        """Accept nothing any more; everything received is then on the bus. The archive still answers."""
        for task in self._tasks:
            task.cancel()
        await self.server.stop()
        self._publish_tick()
        await self._outbox.close()
        await asyncio.to_thread(self._archive.sync)

    async def close(self) -> None:
        """Close the archive; nobody asks any more."""
        await asyncio.to_thread(self._archive.close)

    # ----------------------------------------------------------------------------------------- bytes

    def _sink(self, station: str, data: bytes) -> None:
        try:
            chunk = self._archive.append(station, self._clock.now(), data)
        except OSError as error:
            if not self.counters["archive_errors"]:
                log.critical("the archive cannot be written, bytes of %s are lost: %s", station, error)
            self.counters["archive_errors"] += 1
            return
        self.counters["chunks"] += 1
        self.counters["bytes"] += len(data)
        self._put(keys.of(keys.RAW, station), encode_chunk(chunk))

    def _put(self, key: str, payload: bytes) -> None:
        """Publish, or, while the bus is jammed, tell by a new generation that the archive has more."""
        if not self._outbox.put(key, payload):
            self.counters["not_published"] += 1
            self._generation = self._clock.now()

    def _event(self, event: ConnectionEvent) -> None:
        log.info("%s %s: %s", event.station, event.kind, event.reason)
        body = codec.encode([event.kind, event.reason, event.t_gps_ns])
        self._put(keys.of(keys.CONNECTION, event.station), body)

    def _ntrip_event(self, station: str, kind: str, reason: str) -> None:
        self._event(ConnectionEvent(station, kind, reason, self._clock.now()))

    async def _tick(self) -> None:
        interval_s = max(self._settings.hold_back_s, LEAST_TICK_S)
        while True:
            self._publish_tick()
            await asyncio.sleep(interval_s)

    def _publish_tick(self) -> None:
        archive_id = self._archive.archive_id
        self._put(keys.of(keys.CLOCK, archive_id), encode_fields(Tick(archive_id, self._generation, self._clock.now())))

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
        """[offset or −1, receive time to begin at where there is no offset, about how many bytes]."""
        station = keys.last_part(key)
        offset, from_ns, max_bytes = codec.decode(payload)
        end, t_now_ns, generation = self._archive.end(station), self._clock.now(), self._generation
        begin_ns = from_ns if offset < 0 else None
        chunks = await asyncio.to_thread(self._archive.read, station, max(offset, 0), max_bytes, begin_ns)
        return encode_archive_reply(ArchiveReply(end, generation, t_now_ns, tuple(chunks)))

    async def _answer_devices(self, key: str, payload: bytes) -> bytes:
        """Unknown devices, and the stations with a device connected."""
        callers = [[getattr(caller, name) for name in caller.__slots__] for caller in self.server.callers.listed()]
        return codec.encode({"callers": callers, "connected": self.server.connected()})

    def metrics(self) -> dict[str, int]:
        """Counters and gauges of ingest."""
        refusals = {f"refused_{reason}": n for reason, n in self.server.callers.refusals.items()}
        now = {"open_connections": self.server.n_connections, "connected_stations": len(self.server.connected())}
        steps = {"clock_steps_back": self._clock.steps_back}
        return dict(self.counters) | dict(self.server.counters) | refusals | now | steps

    # ----------------------------------------------------------------------------------------- stations

    async def _learn_stations(self) -> None:
        """Ask the store; where it does not answer, the last answer, kept in a file, has to do for now."""
        for _ in range(10):
            answers = await self._bus.query(keys.QUERY_STATIONS, timeout_s=1.0)
            if answers:
                self._configs = {c.station: c for answer in answers for c in decode_configs(answer)}
                self._remember()
                return
            await asyncio.sleep(0.2)
        with contextlib.suppress(OSError, ValueError):
            self._configs = {c.station: c for c in decode_configs(self._cache.read_bytes())}
            log.warning("no store answers: beginning with %d stations known before", len(self._configs))

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
        while True:
            for message in await self._inbox.get():
                try:
                    configs = decode_configs(message.payload)
                except ValueError as error:
                    log.error("unreadable settings: %s", error)
                    continue
                for config in configs:
                    self._configs[config.station] = config
            self._configs = {name: c for name, c in self._configs.items() if c.settings is not None}
            self._remember()
            await self.server.change_directory(self._directory())
