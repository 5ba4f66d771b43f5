"""Worker processes: started, watched, started again when they die."""

import asyncio
import contextlib
import logging
import os
import signal
import sys

from plumbline.config import ServerSettings

log = logging.getLogger(__name__)

FIRST_PAUSE_S = 0.2
LONGEST_PAUSE_S = 30.0
HEALTHY_AFTER_S = 30.0
STOP_DEADLINE_S = 40.0


class WorkerPool:
    """As many ``python -m plumbline.worker`` as asked for."""

    def __init__(self, settings: ServerSettings, connect: tuple[str, ...], n: int) -> None:
        self._settings = settings.model_copy(update={"bus_connect": connect})
        self._n = n
        self._processes: dict[int, asyncio.subprocess.Process] = {}
        self._tasks: list[asyncio.Task[None]] = []
        self._stopping = False
        self.deaths = 0

    async def start(self) -> None:
        """Start every worker; they report for work on the bus by themselves."""
        create = asyncio.get_running_loop().create_task
        self._tasks = [create(self._keep_running(slot)) for slot in range(self._n)]

    async def stop(self) -> None:
        """Have every worker finish what was received, and wait for it; one that does not end in time is killed."""
        self._stopping = True
        for process in self._processes.values():
            with contextlib.suppress(ProcessLookupError):
                process.send_signal(signal.SIGTERM)
        _, late = await asyncio.wait(self._tasks, timeout=STOP_DEADLINE_S) if self._tasks else (None, set())
        for process in self._processes.values():
            if late and process.returncode is None:
                log.error("worker %d does not end: killed; its stations go on from their checkpoints", process.pid)
                process.kill()

    @property
    def pids(self) -> tuple[int, ...]:
        """The running workers."""
        return tuple(process.pid for process in self._processes.values() if process.returncode is None)

    async def _keep_running(self, slot: int) -> None:
        loop = asyncio.get_running_loop()
        pause_s = FIRST_PAUSE_S
        while not self._stopping:
            began_s = loop.time()
            code = await self._run_once(slot)
            if self._stopping:
                return
            self.deaths += 1
            pause_s = FIRST_PAUSE_S if loop.time() - began_s > HEALTHY_AFTER_S else min(2 * pause_s, LONGEST_PAUSE_S)
            log.error("worker %d ended with %s; starting another in %.1f s", slot, code, pause_s)
            await asyncio.sleep(pause_s)

    async def _run_once(self, slot: int) -> int:
        threads = dict.fromkeys(("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1")
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            *("-m", "plumbline.worker", "--settings", "-", "--parent", str(os.getpid())),
            stdin=asyncio.subprocess.PIPE,
            env=os.environ | threads,
            start_new_session=True,  # a Ctrl-C at the terminal is for the main process, which then ends the workers
        )
        self._processes[slot] = process
        await process.communicate(self._settings.model_dump_json().encode())
        return process.returncode or 0
