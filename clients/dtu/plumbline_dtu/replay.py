"""Plays RTCM3 recordings as DTUs would have sent them, at their own pace or faster.

Several recordings are merged by the times in their frames, so that a rover's epochs and the corrections that were sent
before them stay in that order; at equal times the recording given first goes first. Nothing is re-stamped: orbits and
clocks belong to their own time, and a server finds a recording's week by its ephemerides.
"""

import asyncio
import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from plumbline.epochs.recording import Piece, merge, read_recording
from plumbline.gps_time import NS_PER_S, gps_ns_from_unix_ns
from plumbline_dtu.device import Device, DeviceCounters, DeviceOptions

_ALIGNMENT_NS = 60 * NS_PER_S
_NAME = b"{name}"


@dataclass(frozen=True, slots=True)
class Replay:
    """What to play and how. ``speed`` 0: as fast as the connection takes it."""

    files: Sequence[tuple[str, Path]]  # (name of the stream, recording)
    options: DeviceOptions
    speed: float = 1.0
    start_now: bool = True
    inertial_message: int = 4001
    switch_pause_s: float = 0.002  # between two connections' bytes, so that their order survives the server's sockets


async def play(replay: Replay, on_progress: Callable[[int, int], None] | None = None) -> dict[str, DeviceCounters]:
    """Play to the end; returns what each device did. One connection a stream if the registration holds ``{name}``.

    Without ``start_now`` at speed 1, playing begins when the second of the minute is the recording's, so that epochs
    come on the seconds they came on.
    """
    pieces = _load(replay)
    names = list(dict.fromkeys(name for name, _ in replay.files))
    shared = _NAME not in replay.options.registration
    devices = {name: _device(replay.options, name, k) for k, name in enumerate(names[:1] if shared else names)}
    runs = [asyncio.create_task(device.run()) for device in devices.values()]
    try:
        await _wait_for_alignment(replay, pieces)
        sending = asyncio.create_task(
            _send(replay, pieces, lambda name: devices[names[0] if shared else name], on_progress)
        )
        await asyncio.wait({sending, *runs}, return_when=asyncio.FIRST_COMPLETED)
        for run in runs:
            if run.done():  # it gave up
                sending.cancel()
                run.result()
        await sending
        for device in devices.values():
            device.close()
        await asyncio.gather(*runs)
    finally:
        for run in runs:
            run.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.gather(*runs, return_exceptions=True)
    return {name: device.counters for name, device in devices.items()}


def _load(replay: Replay) -> list[Piece]:
    recordings: list[list[Piece]] = []
    for name, path in replay.files:
        near = recordings[0][0].t_ns if recordings and recordings[0] else None
        recordings.append(read_recording(path, name, replay.inertial_message, near))
    return merge(recordings)


def _device(options: DeviceOptions, name: str, seed: int) -> Device:
    return Device(replace(options, registration=options.registration.replace(_NAME, name.encode())), seed)


async def _wait_for_alignment(replay: Replay, pieces: list[Piece]) -> None:
    if replay.start_now or replay.speed != 1.0 or not pieces:
        return
    now_ns = gps_ns_from_unix_ns(time.time_ns())
    await asyncio.sleep((pieces[0].t_ns - now_ns) % _ALIGNMENT_NS / NS_PER_S)


async def _send(
    replay: Replay,
    pieces: list[Piece],
    device_of: Callable[[str], Device],
    on_progress: Callable[[int, int], None] | None,
) -> None:
    started = time.monotonic()
    last: Device | None = None
    for k, piece in enumerate(pieces):
        if replay.speed > 0:
            due = started + (piece.t_ns - pieces[0].t_ns) / NS_PER_S / replay.speed
            if (wait := due - time.monotonic()) > 0:
                await asyncio.sleep(wait)
        device = device_of(piece.stream)
        if last is not None and device is not last:
            await last.drained()
            await asyncio.sleep(replay.switch_pause_s)
        device.send(piece.data)
        last = device
        if replay.speed != 1.0:  # faster than a modem: nothing may be lost for want of a buffer
            await device.drained()
        if on_progress:
            on_progress(k + 1, len(pieces))
