"""The bus between two sessions over TCP: what the rest relies on. Oracle: counting."""

import asyncio
import multiprocessing
import time

from plumbline.bus import Bus, Inbox, Outbox


async def collect(inbox: Inbox, n: int, timeout_s: float = 20.0) -> list:
    got: list = []
    async with asyncio.timeout(timeout_s):
        while len(got) < n:
            got += await inbox.get()
    return got


async def test_order_holds_over_all_subscriptions_and_nothing_is_lost() -> None:
    hub = await Bus.open(listen=["tcp/127.0.0.1:0"])
    leaf = await Bus.open(connect=hub.endpoints)
    inbox = Inbox()
    for name in ("a", "b", "c"):
        hub.subscribe(f"t/{name}/**", inbox)
    await leaf.query("t/nobody", timeout_s=0.2)  # by now the subscriptions are known
    outbox = Outbox(leaf)
    for i in range(5000):
        assert outbox.put(f"t/{'abc'[i % 3]}/{i % 7}", i.to_bytes(4, "big") + bytes(500))
    await outbox.close()
    got = await collect(inbox, 5000)
    assert [int.from_bytes(m.payload[:4], "big") for m in got] == list(range(5000))
    await leaf.close()
    await hub.close()


async def test_closing_sends_what_was_put_and_unsubscribing_ends_delivery() -> None:
    hub = await Bus.open(listen=["tcp/127.0.0.1:0"])
    leaf = await Bus.open(connect=hub.endpoints)
    inbox = Inbox()
    end = hub.subscribe("t/**", inbox)
    await leaf.query("t/nobody", timeout_s=0.2)
    for _ in range(200):
        leaf.put("t/x", bytes(50_000))
    await leaf.close()
    assert len(await collect(inbox, 200)) == 200
    end()
    other = await Bus.open(connect=hub.endpoints)
    other.put("t/x", b"late")
    await asyncio.sleep(0.3)
    assert inbox.get_nowait() == []
    await other.close()
    await hub.close()


async def test_questions_are_answered_by_coroutines() -> None:
    hub = await Bus.open(listen=["tcp/127.0.0.1:0"])
    leaf = await Bus.open(connect=hub.endpoints)

    async def answer(key: str, payload: bytes) -> bytes | None:
        await asyncio.sleep(0.01)
        return None if payload == b"?" else key.encode() + payload

    hub.answer("q/*", answer)
    leaf.answer("q/leaf", answer)
    assert await leaf.query("q/one", b"!") == [b"q/one!"]
    assert await leaf.query("q/one", b"?", timeout_s=1.0) == []
    assert await hub.query("nobody/there", timeout_s=0.5) == []
    assert len(await hub.query("q/leaf", b"!")) == 2
    large = bytes(5_000_000)
    assert len((await leaf.query("q/one", large))[0]) == 5_000_005
    await leaf.close()
    await hub.close()


async def test_a_process_that_asks_itself_many_things_at_once_is_answered() -> None:
    bus = await Bus.open(listen=["tcp/127.0.0.1:0"])

    async def answer(key: str, payload: bytes) -> bytes:
        if payload == b"spoiled":
            raise ValueError("no such thing")
        return payload

    bus.answer("q/self", answer)
    questions = [bytes([i]) for i in range(60)]
    assert await asyncio.gather(*(bus.query("q/self", q, timeout_s=20.0) for q in questions)) == [
        [q] for q in questions
    ]
    assert await bus.query("q/self", b"spoiled", timeout_s=20.0) == []  # at once, not when the time is over
    await bus.close()


def live_and_die(endpoint: str) -> None:
    async def live() -> None:
        bus = await Bus.open(connect=[endpoint])
        bus.announce("alive/one")
        await asyncio.sleep(60)

    asyncio.run(live())


async def test_liveliness_tells_of_a_killed_process_at_once() -> None:
    hub = await Bus.open(listen=["tcp/127.0.0.1:0"])
    watcher = await Bus.open(connect=hub.endpoints)
    process = multiprocessing.get_context("spawn").Process(target=live_and_die, args=hub.endpoints)
    process.start()
    inbox = Inbox()
    watcher.watch("alive/**", inbox)
    (came,) = await collect(inbox, 1)
    assert (came.key, came.alive) == ("alive/one", True)
    late = Inbox()
    hub.watch("alive/**", late)  # those already there are told to who comes later
    assert [m.key for m in await collect(late, 1)] == ["alive/one"]
    process.kill()
    (went,) = await collect(inbox, 1, timeout_s=5.0)
    assert (went.key, went.alive) == ("alive/one", False)
    process.join()
    await watcher.close()
    await hub.close()


async def test_a_full_inbox_drops_and_says_so() -> None:
    hub = await Bus.open(listen=["tcp/127.0.0.1:0"])
    inbox = Inbox(max_bytes=10_000)
    hub.subscribe("t/**", inbox)
    hub.subscribe("must/arrive", inbox, droppable=False)
    for _ in range(30):
        hub.put("t/x", bytes(1000))
    hub.put("must/arrive", b"")
    await asyncio.sleep(0.2)
    assert [message.key for message in inbox.get_nowait()] == ["t/x"] * 11 + ["must/arrive"]
    assert inbox.take_overflow()
    assert not inbox.take_overflow()
    assert inbox.dropped == 19
    began = time.monotonic()
    hub.put("t/x", b"again")
    assert len(await collect(inbox, 1)) == 1
    assert time.monotonic() - began < 5
    await hub.close()
