"""``python -m plumbline.worker``: one worker process, started by ``plumbline serve`` or by hand."""

import argparse
import asyncio
import contextlib
import logging
import os
import signal
import sys
from pathlib import Path

from plumbline.bus import Bus
from plumbline.config import ServerSettings
from plumbline.worker import Worker
from plumbline.worker.processing import Processing


async def work(settings: ServerSettings, parent: int | None = None, processing: Processing | None = None) -> None:
    """Work on the bus that the settings connect to, until SIGTERM or SIGINT, or until the parent process is gone."""
    loop = asyncio.get_running_loop()
    watcher = loop.create_task(_leave_with(parent)) if parent is not None else None
    bus = await Bus.open(connect=settings.bus_connect)
    worker = Worker(settings, bus, processing)
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, worker.stop)
    try:
        await worker.run()
    finally:
        if watcher is not None:
            watcher.cancel()
        await bus.close()


async def _leave_with(parent: int) -> None:
    """End at once when the parent has died: whoever comes next takes over from the checkpoints."""
    while os.getppid() == parent:  # noqa: ASYNC110 - a parent's death has no event
        await asyncio.sleep(0.5)
    os._exit(1)


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line and work."""
    parser = argparse.ArgumentParser(prog="python -m plumbline.worker", description=__doc__)
    parser.add_argument(
        "--settings", type=Path, help="a file of the server's settings as JSON; '-' reads standard input"
    )
    parser.add_argument("--connect", action="append", default=[], help="zenoh endpoint of the bus")
    parser.add_argument("--parent", type=int, help="leave when this process is no longer the parent")
    options = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    text = "{}"
    if options.settings is not None:
        text = sys.stdin.read() if str(options.settings) == "-" else options.settings.read_text(encoding="utf-8")
    settings = ServerSettings.model_validate_json(text)
    if options.connect:
        settings = settings.model_copy(update={"bus_connect": tuple(options.connect)})
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(work(settings, options.parent))
    return 0


if __name__ == "__main__":
    sys.exit(main())
