"""A zenoh session fitted to asyncio: batches per wake-up, blocking and reliable sending, coroutines that answer."""

import asyncio
import contextlib
import json
import logging
import socket
import threading
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import zenoh

log = logging.getLogger(__name__)

Answer = Callable[[str, bytes], Awaitable[bytes | None]]
OPEN_TIMEOUT_MS = 60_000
BUSY_S = 0.002
LINGER_S = 0.001
ASK_THREADS = 16
REPLY_THREADS = 4


class Message(NamedTuple):
    """What an inbox holds: for a liveliness key, ``alive`` says whether it has come or gone; the payload is empty."""

    key: str
    payload: bytes
    alive: bool = True


class Inbox:
    """Messages from zenoh's threads to one reader on an event loop: first in, first out over all its subscriptions.

    When more than ``max_bytes`` wait, further droppable messages are dropped and counted in ``dropped``; the reader
    learns of it by :meth:`take_overflow` and must get what it missed elsewhere (the archive). Nobody upstream is ever
    blocked.
    """

    def __init__(self, max_bytes: int = 256 << 20) -> None:
        self._loop = asyncio.get_running_loop()
        self._queue: deque[Message] = deque()
        self._ready = asyncio.Event()
        self._lock = threading.Lock()
        self._woken = False
        self._bytes = 0
        self._max_bytes = max_bytes
        self._overflowed = False
        self._last_get_s = 0.0
        self.dropped = 0

    def put(self, message: Message, *, droppable: bool = True) -> None:
        """Add a message, from any thread."""
        with self._lock:
            if droppable and self._bytes > self._max_bytes:
                self.dropped += 1
                self._overflowed = True
                return
            self._bytes += len(message.payload)
            self._queue.append(message)
            wake, self._woken = not self._woken, True
        if wake:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(self._ready.set)

    async def get(self) -> list[Message]:
        """Everything that waits; sleeps until there is something.

        Under a stream of messages it lingers for a millisecond, so that one wake-up is for many.
        """
        await self._ready.wait()
        if self._loop.time() - self._last_get_s < BUSY_S:
            await asyncio.sleep(LINGER_S)
        self._last_get_s = self._loop.time()
        return self.get_nowait()

    def get_nowait(self) -> list[Message]:
        """Everything that waits, which may be nothing."""
        with self._lock:
            batch = list(self._queue)
            self._queue.clear()
            self._bytes = 0
            self._woken = False
            self._ready.clear()
        return batch

    def take_overflow(self) -> bool:
        """Whether messages were dropped since this was last asked."""
        with self._lock:
            overflowed, self._overflowed = self._overflowed, False
        return overflowed


class Bus:
    """One zenoh session. Open it with :meth:`open`; :meth:`close` ends everything that was declared on it."""

    def __init__(self, session: Any, endpoints: tuple[str, ...]) -> None:
        self._session = session
        self._declared: list[Any] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self._asking = ThreadPoolExecutor(ASK_THREADS, "bus-ask")
        self._replying = ThreadPoolExecutor(REPLY_THREADS, "bus-reply")  # never the same: one may ask oneself
        self.endpoints = endpoints  # where it listens, ports resolved

    @classmethod
    async def open(cls, listen: Sequence[str] = (), connect: Sequence[str] = ()) -> "Bus":
        """A session that listens (then it routes between those that connect) or only connects. Scouting is off.

        Raises ``ConnectionError`` when it can neither listen nor connect.
        """
        endpoints = tuple(resolve_port(endpoint) for endpoint in listen)
        config = _config(endpoints, tuple(connect))
        try:
            session = await asyncio.to_thread(zenoh.open, config)
        except zenoh.ZError as error:
            raise ConnectionError(f"bus: {error}") from error
        return cls(session, endpoints)

    async def close(self) -> None:
        """Undeclare everything and end the session; what was put before is sent first."""
        self._cancel_tasks()
        await asyncio.to_thread(self._close)
        self._cancel_tasks()
        for pool in (self._asking, self._replying):
            pool.shutdown(wait=False, cancel_futures=True)

    def _cancel_tasks(self) -> None:
        for task in list(self._tasks):
            task.cancel()

    def _close(self) -> None:
        for declared in reversed(self._declared):
            with contextlib.suppress(zenoh.ZError):
                declared.undeclare()
        with contextlib.suppress(zenoh.ZError):
            self._session.close()

    def put(self, key: str, payload: bytes) -> None:
        """Send to every subscriber, reliably and in order; blocks while the link is full."""
        self._session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)

    def subscribe(self, key: str, inbox: Inbox, *, droppable: bool = True) -> Callable[[], None]:
        """Have what is put under a key expression delivered; the answer ends it."""

        def receive(sample: Any) -> None:
            inbox.put(Message(str(sample.key_expr), sample.payload.to_bytes()), droppable=droppable)

        return self._keep(self._session.declare_subscriber(key, _direct(receive)))

    def announce(self, key: str) -> Callable[[], None]:
        """A liveliness token: it vanishes for everybody within a moment of this process's end."""
        return self._keep(self._session.liveliness().declare_token(key))

    def watch(self, key: str, inbox: Inbox) -> Callable[[], None]:
        """Have the coming and going of liveliness tokens delivered, those already there first."""

        def receive(sample: Any) -> None:
            inbox.put(Message(str(sample.key_expr), b"", sample.kind == zenoh.SampleKind.PUT), droppable=False)

        return self._keep(self._session.liveliness().declare_subscriber(key, _direct(receive), history=True))

    def answer(self, key: str, handler: Answer) -> Callable[[], None]:
        """Answer queries under a key expression with what a coroutine makes of (key, payload); None: silence."""
        loop = asyncio.get_running_loop()

        async def respond(query: Any, query_key: str, payload: bytes) -> None:
            try:
                reply = await handler(query_key, payload)
                if reply is not None:
                    reply_key = key if "*" in query_key else query_key
                    await loop.run_in_executor(self._replying, query.reply, reply_key, reply)
            except Exception:  # whoever asked hears nothing, and asks again
                log.exception("a question on %s has no answer", query_key)
            await loop.run_in_executor(self._replying, query.drop)

        def start(query: Any, query_key: str, payload: bytes) -> None:
            task = loop.create_task(respond(query, query_key, payload))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

        def receive(query: Any) -> None:
            payload = query.payload.to_bytes() if query.payload is not None else b""
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(start, query, str(query.key_expr), payload)

        return self._keep(self._session.declare_queryable(key, receive))

    async def query(self, key: str, payload: bytes = b"", timeout_s: float = 10.0) -> list[bytes]:
        """The answers of all that answer to a key expression; empty when nobody does in time."""

        def ask() -> list[bytes]:
            replies = self._session.get(
                key,
                payload=payload,
                timeout=timeout_s,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
            return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]

        return await asyncio.get_running_loop().run_in_executor(self._asking, ask)

    def _keep(self, declared: Any) -> Callable[[], None]:
        self._declared.append(declared)

        def end() -> None:
            if declared in self._declared:
                self._declared.remove(declared)
                declared.undeclare()

        return end


class Outbox:
    """Puts from a thread of its own, in order, so that a full link never stops the event loop.

    When more than ``max_bytes`` wait, :meth:`put` refuses and answers False: it must be had from elsewhere.
    """

    def __init__(self, bus: Bus, max_bytes: int = 64 << 20) -> None:
        self._bus = bus
        self._queue: deque[tuple[str, bytes]] = deque()
        self._condition = threading.Condition()
        self._bytes = 0
        self._max_bytes = max_bytes
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="bus-outbox", daemon=True)
        self._thread.start()

    def put(self, key: str, payload: bytes) -> bool:
        """Send soon; False when too much waits already."""
        with self._condition:
            if self._bytes > self._max_bytes:
                return False
            self._bytes += len(payload)
            self._queue.append((key, payload))
            self._condition.notify()
        return True

    async def close(self) -> None:
        """Send what waits, then end the thread."""
        with self._condition:
            self._ended = True
            self._condition.notify()
        await asyncio.to_thread(self._thread.join)

    def _run(self) -> None:
        while True:
            with self._condition:
                while not self._queue and not self._ended:
                    self._condition.wait()
                if not self._queue:
                    return
                batch = list(self._queue)
                self._queue.clear()
                self._bytes = 0
            for key, payload in batch:
                with contextlib.suppress(zenoh.ZError):
                    self._bus.put(key, payload)


def _direct(callback: Callable[[Any], None]) -> Any:
    """A callback called on zenoh's receiving thread itself: only so is the order kept between subscriptions."""
    return zenoh.handlers.Callback(callback, indirect=False)


def resolve_port(endpoint: str) -> str:
    """An endpoint ``tcp/host:port`` with a free port in place of 0."""
    head, _, port = endpoint.rpartition(":")
    if port != "0":
        return endpoint
    host = head.partition("/")[2].strip("[]")
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.bind((host, 0))
        return f"{head}:{probe.getsockname()[1]}"


def _config(listen: tuple[str, ...], connect: tuple[str, ...]) -> zenoh.Config:
    values: dict[str, Any] = {
        "mode": "router" if listen else "client",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "connect/endpoints": list(connect),
        "connect/timeout_ms": -1 if listen else OPEN_TIMEOUT_MS,
        "connect/exit_on_failure": not listen,
    }
    if listen:
        values |= {"listen/endpoints": list(listen), "listen/exit_on_failure": True}
    config = zenoh.Config()
    for key, value in values.items():
        config.insert_json5(key, json.dumps(value))
    return config
