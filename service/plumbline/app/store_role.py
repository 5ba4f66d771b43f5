"""The store role: results from the bus into the database, in batches; a checkpoint only behind all that it covers."""

import asyncio
import logging
import time
from collections import Counter, OrderedDict
from collections.abc import Coroutine
from typing import Any

from plumbline.app.day_keeper import DayKeeper
from plumbline.bus import Bus, Inbox, Message, codec, keys
from plumbline.bus.messages import (
    CheckpointMessage,
    Report,
    StationConfig,
    decode_checkpoint,
    decode_numbered,
    encode_configs,
    encode_fields,
)
from plumbline.errors import PlumblineError
from plumbline.records import Output
from plumbline.store import Checkpoint, Store

log = logging.getLogger(__name__)

BATCH_INTERVAL_S = 0.1
LONGEST_PAUSE_S = 10.0
RUNS_REMEMBERED = 4
ASK_AGAIN_S = 5.0
SLOW_WRITE_S = 5.0


class Continuity:
    """Whether the messages of a station's runs were all seen: each run counts from 0, and one gap spoils it."""

    def __init__(self) -> None:
        self._next: dict[str, OrderedDict[str, int]] = {}

    def follows(self, station: str, run: str, number: int) -> bool:
        """Take note of a message; False when one before it in its run was not seen."""
        runs = self._next.setdefault(station, OrderedDict())
        expected = runs.pop(run, 0)
        intact = expected == number
        runs[run] = number + 1 if intact else -1
        if len(runs) > RUNS_REMEMBERED:
            runs.popitem(last=False)
        return intact

    def forget(self) -> None:
        """Messages were lost, nobody knows whose: every run under way is spoiled."""
        for runs in self._next.values():
            for run in runs:
                runs[run] = -1


class StoreRole:
    """Writes what workers publish, and answers what they need to begin."""

    def __init__(self, store: Store, bus: Bus, name: str) -> None:
        self._store = store
        self._bus = bus
        self._name = name
        self._continuity = Continuity()
        self._asked: dict[str, float] = {}
        self._stopping = False
        self.counters: Counter[str] = Counter()
        self._failing = ""  # why the database does not take anything at the moment

    async def start(self) -> None:
        """Subscribe, answer, and only then be known."""
        self._inbox = Inbox()
        for prefix in (*keys.OUTPUTS.values(), keys.CHECKPOINT):
            self._bus.subscribe(f"{prefix}/**", self._inbox)
        self._bus.answer(keys.QUERY_STATIONS, self._answer_stations)
        self._bus.answer(f"{keys.QUERY_CHECKPOINT}/*", self._answer_checkpoint)
        self._bus.answer(keys.of(keys.QUERY_REPORT, self._name), self._answer_report)
        self._bus.announce(keys.of(keys.ALIVE_STORE, self._name))
        self._task = asyncio.get_running_loop().create_task(self._run())
        self._days = asyncio.get_running_loop().create_task(DayKeeper(self._store).run())

    async def stop(self) -> None:
        """Write what has come, then end."""
        self._stopping = True
        self._days.cancel()
        self._inbox.put(Message("", b""))
        await self._task

    # ----------------------------------------------------------------------------------------- writing

    async def _run(self) -> None:
        while True:
            batch = await self._inbox.get()
            if self._inbox.take_overflow():
                self.counters["overflows"] += 1
                self._continuity.forget()
            outputs, checkpoints = self._sort(batch)
            if outputs or checkpoints:
                await self._write(outputs, checkpoints)
            if self._stopping:
                batch = self._inbox.get_nowait()
                if not batch:
                    return
                await self._write(*self._sort(batch))
                return
            await asyncio.sleep(BATCH_INTERVAL_S)

    def _sort(self, batch: list[Message]) -> tuple[list[Output], list[Checkpoint]]:
        """Outputs in order, and the newest checkpoint of each station whose messages were all seen."""
        outputs: list[Output] = []
        checkpoints: dict[str, Checkpoint] = {}
        for message in batch:
            if not message.key:
                continue
            kind, _, station = message.key.rpartition("/")
            try:
                numbered = decode_numbered(message.payload)
                intact = self._continuity.follows(station, numbered.run, numbered.number)
                if kind != keys.CHECKPOINT:
                    outputs.append(codec.decode(numbered.body))
                elif intact:
                    checkpoints[station] = _stored(decode_checkpoint(numbered.body))
            except ValueError as error:
                intact = False
                log.error("unreadable message on %s: %s", message.key, error)
            if not intact:
                self._ask_again(station)
        return outputs, list(checkpoints.values())

    def _ask_again(self, station: str) -> None:
        """Have a station computed again from its last stored checkpoint: messages of it were missed."""
        now_s = time.monotonic()
        if now_s - self._asked.get(station, -ASK_AGAIN_S) >= ASK_AGAIN_S:
            self._asked[station] = now_s
            self.counters["rewinds"] += 1
            self._bus.put(keys.of(keys.REWIND, station), b"")

    async def _write(self, outputs: list[Output], checkpoints: list[Checkpoint]) -> None:
        """Write, however long the database takes to come back; meanwhile the inbox is what bounds the memory."""
        pause_s = 0.5
        while True:
            try:
                self.counters["rows"] += await self._watched(self._store.write(outputs, checkpoints))
                if self._failing:
                    log.warning("the database takes results again")
                self._failing = ""
                return
            except PlumblineError as error:
                self._failing = str(error)
                self.counters["failed_writes"] += 1
                log.error("the database does not take results, trying again in %.1f s: %s", pause_s, error)
            if self._stopping:
                return  # the checkpoints in the database are those of the rows in it: nothing is lost
            await asyncio.sleep(pause_s)
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)

    async def _watched(self, writing: Coroutine[Any, Any, int]) -> int:
        """A write's rows; it is told to be failing as long as it takes too long."""
        task = asyncio.ensure_future(writing)
        done, _ = await asyncio.wait((task,), timeout=SLOW_WRITE_S)
        if not done:
            self.counters["slow_writes"] += 1
            self._failing = self._failing or f"the database has not taken results for more than {SLOW_WRITE_S:.0f} s"
            log.error("%s", self._failing)
        return await task

    # ----------------------------------------------------------------------------------------- answers

    async def _answer_report(self, key: str, payload: bytes) -> bytes:
        failing = {"database": self._failing} if self._failing else {}
        counters = dict(self.counters) | {"inbox_dropped": self._inbox.dropped}
        return encode_fields(Report("store", self._name, counters, failing))

    async def _answer_stations(self, key: str, payload: bytes) -> bytes | None:
        try:
            return encode_configs(await station_configs(self._store))
        except PlumblineError as error:
            log.error("cannot tell the stations: %s", error)
            return None

    async def _answer_checkpoint(self, key: str, payload: bytes) -> bytes | None:
        """The checkpoint, or nothing at all in a full answer where there is none."""
        try:
            found = await self._store.checkpoint(keys.last_part(key))
        except PlumblineError as error:
            log.error("cannot tell a checkpoint: %s", error)
            return None
        if found is None:
            return b""
        return encode_fields(CheckpointMessage(found.station, found.t_receive_ns, found.state, found.consumed))


def _stored(message: CheckpointMessage) -> Checkpoint:
    return Checkpoint(message.station, message.t_receive_ns, message.state, message.consumed)


async def station_configs(store: Store, only: str | None = None) -> list[StationConfig]:
    """Every station (or one) as workers and ingest need it."""
    rows = await store.stations() if only is None else [row for row in [await store.station(only)] if row]
    thresholds = await store.thresholds(only)
    return [
        StationConfig(
            row.settings.station,
            row.settings,
            tuple(t for t in thresholds if t.station == row.settings.station),
            row.created_gps_ns,
            row.changed_gps_ns,
        )
        for row in rows
    ]
