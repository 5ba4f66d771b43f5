"""Real servers in processes of their own, and devices that send recordings to them over TCP."""

import asyncio
import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from plumbline_dtu.shake_table.experiment import Experiment, Levels, schedule
from plumbline_dtu.shake_table.write import simulate


class Serving:
    """A `plumbline serve` process."""

    def __init__(self, folder: Path, config: str, *arguments: str) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.data_dir = folder / "data"
        n = len(list(folder.glob("log-*")))
        self._log = folder / f"log-{n}.txt"
        toml = folder / f"plumbline-{n}.toml"
        toml.write_text(config, encoding="utf-8")
        command = [sys.executable, "-m", "plumbline.cli", "serve", "--config", str(toml)]
        command += ["--data-dir", str(self.data_dir), *arguments]
        threads = dict.fromkeys(("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        with self._log.open("w") as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=log, env=os.environ | threads)

    @property
    def log(self) -> str:
        """What it has written so far."""
        return self._log.read_text(encoding="utf-8")

    def wait_until_serving(self, timeout_s: float = 240.0) -> "Serving":
        """Until it says where it can be reached."""
        self.wait_for(lambda: "serving: " in self.log, timeout_s)
        return self

    def wait_for(
        self, done: Callable[[], bool], timeout_s: float = 120.0, progress: Callable[[], object] = lambda: None
    ) -> None:
        """Until something holds; fails with the log when the process ends or nothing has moved for a time."""
        deadline, before = time.monotonic() + timeout_s, progress()
        while not done():
            if (now := progress()) != before:
                deadline, before = time.monotonic() + timeout_s, now
            assert self.process.poll() is None, f"the server ended with {self.process.returncode}:\n{self.log[-4000:]}"
            assert time.monotonic() < deadline, f"waited in vain; the server's log:\n{self.log[-4000:]}"
            time.sleep(0.05)

    def _port(self, pattern: str) -> int:
        found = re.search(pattern, self.log)
        assert found is not None, self.log
        return int(found[1])

    @property
    def ingest_port(self) -> int:
        """The TCP port for devices."""
        return self._port(r"serving: .*ingest [\d.]+:(\d+)")

    @property
    def http(self) -> str:
        """The API's address."""
        port = self._port(r"serving: .*http://[\d.]+:(\d+)")
        return f"http://127.0.0.1:{port}"

    def children(self) -> list[int]:
        """Process ids of its workers."""
        text = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text(encoding="ascii")
        return [int(pid) for pid in text.split()]

    def kill(self) -> None:
        """`kill -9`."""
        self.process.kill()
        self.process.wait()

    def stop(self, timeout_s: float = 240.0) -> int:
        """SIGTERM, and the exit status."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(timeout_s)


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., Serving]]:
    """Start servers in one folder; whatever still runs at the end is killed, workers too."""
    started: list[Serving] = []

    def start(config: str, *arguments: str, wait: bool = True) -> Serving:
        serving = Serving(tmp_path, config, *arguments)
        started.append(serving)
        return serving.wait_until_serving() if wait else serving

    yield start
    for serving in started:
        if serving.process.poll() is None:
            pids = serving.children()
            serving.kill()
            for pid in pids:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)


@pytest.fixture(scope="session")
def shaken_platform(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Streams of a platform with three antennas and an IMU, and its base: ten seconds of rest, ten of half a Hertz."""
    path = tmp_path_factory.mktemp("platform")
    whole = schedule(rest_s=10.0, minute_s=16.0)
    plan = replace(whole, vibrations=whole.vibrations[:1], duration_s=20.0)
    simulate(Experiment(2, plan, Levels(platform_reflection=0.0, base_reflection=0.0)), path)
    return path


class Device:
    """Sends a recording over TCP as a DTU does: registration first, then packets."""

    def __init__(self, port: int, registration: bytes) -> None:
        self._port = port
        self._registration = registration

    async def __aenter__(self) -> "Device":
        self._reader, self._writer = await asyncio.open_connection("127.0.0.1", self._port)
        self._writer.write(self._registration)
        await self._writer.drain()
        await asyncio.sleep(0.6)  # a registration that nothing else ends is ended by silence
        return self

    async def send(self, data: bytes, packet: int = 1400, pause_s: float = 0.002) -> None:
        """Packets with pauses."""
        for begin in range(0, len(data), packet):
            self._writer.write(data[begin : begin + packet])
            await self._writer.drain()
            await asyncio.sleep(pause_s)

    async def __aexit__(self, *exception: object) -> None:
        self._writer.close()
        with contextlib.suppress(OSError):
            await self._writer.wait_closed()


@pytest.fixture
def device() -> type[Device]:
    """The class of simulated devices."""
    return Device
