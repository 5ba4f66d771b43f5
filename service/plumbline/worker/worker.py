"""A worker: takes its share of stations, feeds their pipelines in receive order, publishes, checkpoints, takes over.

There is one way to begin with a station, whatever brought it here (start, take-over, a store that lost messages): its
last stored checkpoint, then the archive from where the checkpoint had consumed it, then live.
"""

import asyncio
import contextlib
import logging
import time
from collections import Counter
from collections.abc import Callable, Iterable

from plumbline.bus import Bus, Inbox, Message, codec, keys
from plumbline.bus.messages import (
    ArchiveReply,
    CheckpointMessage,
    Numbered,
    Report,
    StationConfig,
    decode_archive_reply,
    decode_checkpoint,
    decode_chunk,
    decode_configs,
    decode_tick,
    encode_fields,
    encode_numbered,
)
from plumbline.config import Mode, ServerSettings
from plumbline.gps_time import NS_PER_S, gps_ns_from_unix_ns
from plumbline.records import Chunk, Output
from plumbline.worker.merging import Cursor, Merger
from plumbline.worker.ownership import owner
from plumbline.worker.processing import Processing, real_processing
from plumbline.worker.shared_books import OWNER_KEY, SLOTS, SharedBooks
from plumbline.worker.station import StationRunner, new_run

log = logging.getLogger(__name__)

ADVANCE_NS = NS_PER_S // 5
FETCHES_AT_A_TIME = 8
FETCH_BYTES = 1 << 20
CHUNKS_AT_A_TIME = 500
SETTLE_S = 0.2  # membership changes come in bursts
DRAIN_S = 20.0
ASK_AGAIN_S = 0.5
WAKE = Message("wake", b"")


class Worker:
    """See the module. :meth:`run` until :meth:`stop` is called; what was received is then processed and saved."""

    def __init__(self, settings: ServerSettings, bus: Bus, processing: Processing | None = None) -> None:
        self.worker_id = f"w{new_run()}"
        self.counters: Counter[str] = Counter()
        self._settings = settings
        self._bus = bus
        self._processing = processing or real_processing()
        self._inbox = Inbox()
        self._merger = Merger()
        self._books = SharedBooks(self._processing)
        self._configs: dict[str, StationConfig] = {}
        self._runners: dict[str, StationRunner] = {}
        self._workers: set[str] = set()
        self._store_seen = False
        self._subscriptions: dict[str, Callable[[], None]] = {}
        self._fetching: set[tuple[str, str, str]] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._next_checkpoint_s: dict[str, float] = {}
        self._advanced_ns = 0
        self._stopping = False
        self._unsettled = True  # the shares must be worked out again
        self._must_restart = True
        self._changed_at_s = 0.0

    # ----------------------------------------------------------------------------------------- life

    async def run(self) -> None:
        """Work until stopped."""
        self._bus.subscribe(f"{keys.CLOCK}/**", self._inbox)
        for key in (keys.SETTINGS, keys.REWIND, keys.CONNECTION):
            self._bus.subscribe(f"{key}/**", self._inbox, droppable=False)
        self._bus.watch("plumbline/alive/**", self._inbox)
        self._bus.answer(keys.of(keys.QUERY_REPORT, self.worker_id), self._answer_report)
        await self._learn_stations()
        self._bus.announce(keys.of(keys.ALIVE_WORKER, self.worker_id))
        while not self._stopping:
            await self._turn()
        await self._drain()
        self._save_all()

    def stop(self) -> None:
        """Finish what was received, save, and return from :meth:`run`."""
        self._stopping = True

    async def _turn(self) -> None:
        """Take in what came, process what may be processed, see to what is due."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.25):
                await self._inbox_ready()
        self._take_in()
        settled = time.monotonic() - self._changed_at_s > SETTLE_S
        if self._unsettled and self._workers and (settled or self._must_restart):
            await self._settle()
        while self._process() and not self._stopping:
            await asyncio.sleep(0)
            self._take_in()
        self._fetch_wanted()
        self._save_due()

    async def _inbox_ready(self) -> None:
        self._take(await self._inbox.get())

    async def _drain(self) -> None:
        """Have everything that the archives hold for this worker's stations, as far as that can be had in time."""
        if self._unsettled and self._workers:
            await self._settle()
        self._merger.refetch()
        deadline_s = time.monotonic() + DRAIN_S
        while time.monotonic() < deadline_s and (self._merger.wanted() or self._fetching or self._process()):
            self._fetch_wanted()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(0.1):
                    await self._inbox_ready()
            if self._must_restart:
                await self._settle()

    # ----------------------------------------------------------------------------------------- what comes in

    def _take_in(self) -> None:
        self._take(self._inbox.get_nowait())

    def _take(self, batch: list[Message]) -> None:
        if self._inbox.take_overflow():
            self.counters["inbox_overflows"] += 1
            self._merger.refetch()
        for message in batch:
            try:
                self._message(message)
            except ValueError as error:
                self.counters["messages_not_readable"] += 1
                log.error("unreadable message on %s: %s", message.key, error)

    def _message(self, message: Message) -> None:
        key, payload, alive = message
        kind, _, name = key.rpartition("/")
        if kind == keys.RAW:
            self._merger.offer(decode_chunk(name, payload))
        elif kind == keys.CLOCK:
            self._merger.tick(decode_tick(payload))
        elif kind == keys.ALIVE_INGEST:
            self._ingest_moved(name, alive)
        elif kind == keys.ALIVE_WORKER:
            (self._workers.add if alive else self._workers.discard)(name)
            self._disturb()
        elif kind == keys.ALIVE_STORE:
            self._store_moved(name, alive)
        elif kind == keys.SETTINGS:
            for config in decode_configs(payload):
                self._config_changed(config)
        elif kind == keys.REWIND:
            self._rewind(name)
        elif kind == keys.CONNECTION and name in self._runners:
            event, reason, t_gps_ns = codec.decode(payload)
            self._publish(self._runners[name], self._runners[name].connection_event(event, reason, t_gps_ns))

    def _disturb(self) -> None:
        self._unsettled = True
        self._changed_at_s = time.monotonic()

    def _ingest_moved(self, archive: str, alive: bool) -> None:
        if not alive:
            self._merger.ingest_went(archive)
            return
        self._merger.ingest_came(archive)
        for station, runner in self._runners.items():
            for stream in (station, *runner.neighbours):
                from_ns = self._begin_ns(runner)
                self._merger.follow(archive, stream, correction=False, from_ns=from_ns, consumer=station)
        for stream, from_ns in self._books.streams().items():
            self._merger.follow(archive, stream, correction=True, from_ns=from_ns)

    def _store_moved(self, name: str, alive: bool) -> None:
        """A store that has come (back) may have missed messages: begin again at what it has."""
        if not alive:
            return
        if self._store_seen:
            log.warning("store %s has come: beginning again at what it has", name)
            self._must_restart = True
            self._disturb()
        self._store_seen = True

    def _config_changed(self, config: StationConfig) -> None:
        before = self._configs.get(config.station)
        if config.settings is None:
            self._configs.pop(config.station, None)
        else:
            self._configs[config.station] = config
        corrections = {c.settings.mode for c in (before, config) if c and c.settings}
        if Mode.CORRECTIONS in corrections and (before is None or corrections != {Mode.CORRECTIONS}):
            self._must_restart = True
        self._setups_changed(config)
        self._disturb()

    def _setups_changed(self, changed: StationConfig) -> None:
        """Tell the station of its change, and those that have it for a neighbour; other streams: open them again."""
        for station, runner in list(self._runners.items()):
            config = self._configs.get(station)
            if config is None or changed.station not in (station, *_neighbours(config)):
                continue
            before = runner.neighbours
            runner.change(config, self._neighbours_of(config, changed))
            if runner.neighbours != before:
                self._save(station)
                self._drop(station)

    def _neighbours_of(self, config: StationConfig, changed: StationConfig | None = None) -> list[StationConfig]:
        """The neighbours that a station's settings name, as far as there are such stations.

        ``changed`` may be one that is deleted: then it is what changed.
        """
        found = [self._configs.get(name) for name in _neighbours(config)]
        named = [c for c in found if c is not None and not self._is_correction(c.station)]
        deleted = changed is not None and changed.settings is None and changed.station != config.station
        return [*named, changed] if changed is not None and deleted else named

    def _rewind(self, station: str) -> None:
        """The store has missed something of a station: drop it unsaved, to be opened again."""
        if station in self._runners:
            self.counters["rewinds"] += 1
            self._drop(station)
            self._disturb()

    # ----------------------------------------------------------------------------------------- shares

    async def _learn_stations(self) -> None:
        """Ask the store for the stations until it answers."""
        while not self._stopping:
            answers = await self._bus.query(keys.QUERY_STATIONS, timeout_s=2.0)
            if answers:
                self._configs = {c.station: c for answer in answers for c in decode_configs(answer) if c.settings}
                return
            await asyncio.sleep(ASK_AGAIN_S)

    def _is_correction(self, station: str) -> bool:
        config = self._configs[station]
        return config.settings is not None and config.settings.mode is Mode.CORRECTIONS

    def _mine(self) -> list[str]:
        """The stations that are this worker's, in order."""
        return [
            station
            for station in sorted(self._configs)
            if not self._is_correction(station) and owner(station, self._workers) == self.worker_id
        ]

    async def _settle(self) -> None:
        """Let go of stations that are no longer this worker's, and open those that have become so."""
        self._unsettled = False
        if self._must_restart:
            self._must_restart = False
            await self._restart()
            return
        mine = self._mine()
        for station in [station for station in self._runners if station not in mine]:
            self._save(station)
            self._drop(station)
        await self._open([station for station in mine if station not in self._runners])

    async def _restart(self) -> None:
        """Begin with everything again: stations from their checkpoints, books from a snapshot that is old enough.

        Settings that were changed while the store, or this worker, was away are learnt too.
        """
        self.counters["restarts"] += 1
        for station in list(self._subscriptions):
            self._drop(station)
        self._books.clear()
        await self._learn_stations()
        mine = self._mine()
        checkpoints = await self._checkpoints(mine)
        corrections = [station for station in sorted(self._configs) if self._is_correction(station)]
        if corrections:
            needed_ns = await self._first_needed_ns(checkpoints)
            snapshots = await self._checkpoints([SLOTS.format(slot) for slot in range(self._books.n_slots)])
            self._books.restore([s for s in snapshots.values() if s is not None], corrections, needed_ns)
            for stream, from_ns in self._books.streams().items():
                self._follow(stream, True, from_ns)
        self._start_runners(checkpoints)

    async def _open(self, stations: list[str]) -> None:
        self._start_runners(await self._checkpoints(stations))

    def _start_runners(self, checkpoints: dict[str, CheckpointMessage | None]) -> None:
        interval_s = self._settings.checkpoint_interval_s
        for n, (station, checkpoint) in enumerate(sorted(checkpoints.items())):
            config = self._configs.get(station)
            if config is None or station in self._runners:
                continue
            neighbours = self._neighbours_of(config)
            runner = StationRunner(self._processing, config, self._books.books, checkpoint, neighbours)
            self._runners[station] = runner
            self._next_checkpoint_s[station] = time.monotonic() + interval_s * (0.5 + 0.5 * (n + 1) / len(checkpoints))
            for stream in (station, *runner.neighbours):
                self._follow(stream, False, self._begin_ns(runner), consumer=station)

    def _begin_ns(self, runner: StationRunner) -> int:
        """Bytes received up to this time are not for the runner: consumed, or older than the station."""
        return runner.consumed_ns or runner.config.created_gps_ns

    def _follow(self, station: str, correction: bool, from_ns: int, consumer: str | None = None) -> None:
        """Subscribe first and ask the archives second, so that there is no moment between them."""
        if station not in self._subscriptions:
            self._subscriptions[station] = self._bus.subscribe(keys.of(keys.RAW, station), self._inbox)
        for archive in self._merger.archives:
            self._merger.follow(archive, station, correction=correction, from_ns=from_ns, consumer=consumer)

    def _drop(self, station: str) -> None:
        """Forget a station without saving it."""
        runner = self._runners.pop(station, None)
        self._merger.unfollow(station)
        for stream in {station, *(runner.neighbours if runner else ())}:
            if not self._merger.is_followed(stream):
                self._unsubscribe(stream)

    def _unsubscribe(self, station: str) -> None:
        end = self._subscriptions.pop(station, None)
        if end is not None:
            end()

    async def _checkpoints(self, stations: Iterable[str]) -> dict[str, CheckpointMessage | None]:
        """The last stored checkpoints, None where there is none.

        Waits for a store that does not answer; when this worker is to stop, its stations are left out instead.
        """
        limit, found = asyncio.Semaphore(16), dict[str, CheckpointMessage | None]()

        async def ask(station: str) -> None:
            async with limit:
                while station not in found:
                    answers = await self._bus.query(keys.of(keys.QUERY_CHECKPOINT, station), timeout_s=5.0)
                    if answers:
                        found[station] = decode_checkpoint(answers[0]) if answers[0] else None
                    elif self._stopping:
                        return
                    else:
                        await asyncio.sleep(ASK_AGAIN_S)

        await asyncio.gather(*(ask(station) for station in stations))
        return found

    async def _first_needed_ns(self, checkpoints: dict[str, CheckpointMessage | None]) -> int:
        """The receive time of the first bytes that any of the stations has not consumed; now, where there are none."""
        needed_ns = gps_ns_from_unix_ns(time.time_ns())
        for station, checkpoint in checkpoints.items():
            created_ns = self._configs[station].created_gps_ns
            for archive in self._merger.archives:
                from_ns = checkpoint.t_receive_ns if checkpoint else created_ns
                reply = await self._ask_archive(archive, station, from_ns, 1)
                if reply is not None and reply.chunks:
                    needed_ns = min(needed_ns, reply.chunks[0].t_receive_ns)
        return needed_ns

    # ----------------------------------------------------------------------------------------- the archive

    async def _ask_archive(self, archive: str, station: str, after_ns: int, max_bytes: int) -> ArchiveReply | None:
        """About so many bytes of a stream's chunks received after a time; None: no answer."""
        question = codec.encode([after_ns + 1, max_bytes])
        answers = await self._bus.query(keys.of(keys.QUERY_ARCHIVE, archive, station), question, timeout_s=10.0)
        return decode_archive_reply(archive, station, answers[0]) if answers else None

    def _fetch_wanted(self) -> None:
        for cursor in self._merger.wanted():
            if len(self._fetching) >= FETCHES_AT_A_TIME:
                return
            if cursor.key not in self._fetching:
                self._fetching.add(cursor.key)
                task = asyncio.get_running_loop().create_task(self._fetch(cursor))
                self._tasks.add(task)
                task.add_done_callback(self._tasks.discard)

    async def _fetch(self, cursor: Cursor) -> None:
        try:
            after_ns = self._merger.asked(cursor)
            reply = await self._ask_archive(cursor.archive, cursor.station, after_ns, FETCH_BYTES)
            if reply is None:
                self.counters["archive_silent"] += 1
                await asyncio.sleep(ASK_AGAIN_S)
            else:
                self._merger.fetched(cursor, reply)
        except ValueError as error:
            self.counters["messages_not_readable"] += 1
            log.error("unreadable answer of archive %s about %s: %s", cursor.archive, cursor.station, error)
            await asyncio.sleep(ASK_AGAIN_S)
        finally:
            self._fetching.discard(cursor.key)
            self._inbox.put(WAKE)

    # ----------------------------------------------------------------------------------------- what goes out

    def _process(self) -> bool:
        """Process what may be; True when there may be more at once."""
        n = 0
        if self._must_restart:
            return False  # whatever is at hand will be computed again, from the right state
        for consumer, chunk in self._merger.deliver(CHUNKS_AT_A_TIME):
            n += 1
            if consumer in self._books:
                self._books.receive(chunk)
            elif not self._station_chunk(consumer, chunk):
                return False
        self._advance()
        return n >= CHUNKS_AT_A_TIME

    def _station_chunk(self, station: str, chunk: Chunk) -> bool:
        """Process a chunk for a station; False when the books are too far ahead of it, so that all must begin again."""
        if chunk.t_receive_ns < self._books.answers_from_ns():
            log.info("the books are ahead of %s: beginning again", station)
            self._must_restart = self._unsettled = True
            return False
        runner = self._runners.get(station)
        if runner is not None:
            self.counters["chunks"] += 1
            self._publish(runner, runner.receive(chunk))
        return True

    def _advance(self) -> None:
        """Let time pass for the stations that have nothing waiting."""
        now_ns = self._merger.clock_ns()
        if now_ns - self._advanced_ns < ADVANCE_NS:
            return
        self._advanced_ns = now_ns
        for station, runner in self._runners.items():
            t_ns = self._merger.idle_until_ns(station)
            if t_ns is not None:
                self._publish(runner, runner.advance(t_ns))
        if owner(OWNER_KEY, self._workers) == self.worker_id:
            self._see_to_books(now_ns)

    def _see_to_books(self, now_ns: int) -> None:
        for status in self._books.statuses_if_due(now_ns):
            message = encode_numbered(Numbered(new_run(), 0, codec.encode(status)))
            self._bus.put(keys.of(keys.STATUS, status.station), message)
        consumed = {f"{a}/{s}": o for s in self._books.streams() for a, o in self._merger.consumed(s).items()}
        snapshot = self._books.snapshot_if_due(consumed)
        if snapshot is not None:
            self._bus.put(*snapshot)

    def _publish(self, runner: StationRunner, outputs: list[Output]) -> None:
        for key, payload in runner.messages(outputs):
            self._bus.put(key, payload)
        self.counters["outputs"] += len(outputs)

    def _save_due(self) -> None:
        now_s = time.monotonic()
        for station, due_s in self._next_checkpoint_s.items():
            if now_s >= due_s and not self._must_restart:
                self._next_checkpoint_s[station] = now_s + self._settings.checkpoint_interval_s
                self._save(station)

    def _save(self, station: str) -> None:
        """Send a checkpoint behind all that was sent of a station."""
        runner = self._runners.get(station)
        if runner is not None and runner.unsaved and not self._must_restart:
            self._bus.put(*runner.checkpoint(self._merger.consumed(station)))
            self.counters["checkpoints"] += 1

    def _save_all(self) -> None:
        for station in self._runners:
            self._save(station)

    async def _answer_report(self, key: str, payload: bytes) -> bytes:
        gauges = {"stations": len(self._runners), "inbox_dropped": self._inbox.dropped}
        failures = sum(runner.failures for runner in self._runners.values())
        counters = gauges | {"failures": failures} | dict(self.counters)
        return encode_fields(Report("worker", self.worker_id, counters, {}))


def _neighbours(config: StationConfig) -> tuple[str, ...]:
    """The stations that a station's settings name as its neighbours, but for itself."""
    names = config.settings.neighbours if config.settings is not None else ()
    return tuple(name for name in names if name != config.station)
