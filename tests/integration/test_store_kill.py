"""A writer killed with SIGKILL. Oracle: the transaction: whole batches are stored, checkpoint included, or nothing."""

import asyncio
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from plumbline.store import Store

T0 = 1_400_000_000_000_000_000
S = 1_000_000_000

WRITER = """
import asyncio, sys
import numpy as np
from plumbline.records import Motion, Solution, Status
from plumbline.store import Checkpoint, Store

async def main(url):
    store = await Store.open(url)
    done = await store.checkpoint("a")
    second = done.consumed["a"] if done else 0
    print("open", flush=True)
    while True:
        t = {T0} + second * {S}
        zeros = np.zeros((10, 3))
        block = Motion("a", t, t, {S} // 10, zeros, zeros, zeros, zeros, Status.PPP_FLOAT)
        second += 1
        checkpoint = Checkpoint("a", t, bytes(200_000), {{"a": second}})
        await store.write([Solution("a", t, t, Status.NO_BASE, ""), block], [checkpoint])

asyncio.run(main(sys.argv[1]))
"""


def test_a_killed_writer_leaves_whole_batches_and_the_next_carries_on(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'killed.sqlite'}"
    script = tmp_path / "writer.py"
    script.write_text(WRITER.format(T0=T0, S=S))
    before = 0
    for pause_s in (0.3, 0.5, 0.4):
        writer = subprocess.Popen([sys.executable, str(script), url], stdout=subprocess.PIPE)
        assert writer.stdout is not None
        assert writer.stdout.readline() == b"open\n"
        time.sleep(pause_s)
        os.kill(writer.pid, signal.SIGKILL)
        writer.wait()
        writer.stdout.close()
        before = asyncio.run(count_whole_batches(url, before))


async def count_whole_batches(url: str, at_least: int) -> int:
    """How many batches are stored; all of each must be."""
    store = await Store.open(url)
    try:
        checkpoint = await store.checkpoint("a")
        assert checkpoint is not None
        n = checkpoint.consumed["a"]
        assert n > at_least
        assert checkpoint.t_receive_ns == T0 + (n - 1) * S
        solutions = await store.solutions("a", limit=100_000)
        assert [solution.t_gps_ns for solution in solutions.items] == [T0 + i * S for i in range(n)]
        assert len(await store.motion_blocks("a", limit=100_000)) == n
        days = await store.motion("a", bucket_ns=86_400 * S)
        assert days.count.sum() == 10 * n
        return n
    finally:
        await store.close()
