"""Simulated stations on the wire or in files: many stations and a correction stream in one process."""

import asyncio
import contextlib
import heapq
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from plumbline.gps_time import NS_PER_S, gps_ns_from_unix_ns
from plumbline_dtu.device import Device, DeviceCounters, DeviceOptions
from plumbline_dtu.simulation.constellation import Constellation, simulate_corrections
from plumbline_dtu.simulation.station import StationPlan, simulate_station

_NAME = b"{name}"
_LEAD_NS = NS_PER_S  # the first epoch is at the next whole second but one
Sent = tuple[int, int, bytes]  # time, index of the stream, bytes


@dataclass(frozen=True, slots=True)
class Scenario:
    """Stations, and the correction stream that serves them (``corrections`` None: there is none)."""

    plans: Sequence[StationPlan]
    constellation: Constellation
    corrections: str | None = "corrections"
    correction_interval_s: int = 5

    @property
    def names(self) -> list[str]:
        """Names of the streams; the corrections come first, so that at equal times they are sent first."""
        return ([self.corrections] if self.corrections else []) + [plan.name for plan in self.plans]

    def sent(self, t_first_gps_ns: int, t_last_gps_ns: int) -> Iterator[Sent]:
        """Everything that is sent, in time order."""
        streams = [simulate_station(plan, self.constellation, t_first_gps_ns, t_last_gps_ns) for plan in self.plans]
        if self.corrections:
            before_ns = t_first_gps_ns - self.correction_interval_s * NS_PER_S
            corrections = simulate_corrections(self.constellation, before_ns, t_last_gps_ns, self.correction_interval_s)
            streams.insert(0, corrections)
        return heapq.merge(*(_indexed(k, stream) for k, stream in enumerate(streams)), key=lambda item: item[:2])


def _indexed(index: int, stream: Iterator[tuple[int, bytes]]) -> Iterator[Sent]:
    for t_ns, data in stream:
        yield t_ns, index, data


async def run_live(
    scenario: Scenario, options: DeviceOptions, duration_s: float | None = None, speed: float = 1.0
) -> dict[str, DeviceCounters]:
    """Send now: GPS time of the wall clock at speed 1; faster, simulated time runs ahead of it.

    ``{name}`` in the registration stands for the stream's name. Each stream has its own connection.
    """
    devices = [
        Device(replace(options, registration=options.registration.replace(_NAME, name.encode())), seed)
        for seed, name in enumerate(scenario.names)
    ]
    runs = [asyncio.create_task(device.run()) for device in devices]
    start_ns = gps_ns_from_unix_ns(time.time_ns())
    started = time.monotonic()
    last_ns = start_ns + round((duration_s if duration_s is not None else 10 * 365 * 86_400) * NS_PER_S)
    try:
        for t_ns, index, data in scenario.sent(start_ns + _LEAD_NS, last_ns):
            wait = (t_ns - start_ns) / NS_PER_S / speed - (time.monotonic() - started)
            if wait > 0:
                await asyncio.sleep(wait)
            devices[index].send(data)
        for device in devices:
            device.close()
        await asyncio.gather(*runs)
    finally:
        for run in runs:
            run.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.gather(*runs, return_exceptions=True)
    return {name: device.counters for name, device in zip(scenario.names, devices, strict=True)}


def write_files(scenario: Scenario, out: Path, t_first_gps_ns: int, duration_s: float) -> None:
    """Write each stream to ``NAME.rtcm3`` and each station's true displacement at its epochs to ``NAME.truth.csv``."""
    out.mkdir(parents=True, exist_ok=True)
    t_last_gps_ns = t_first_gps_ns + round(duration_s * NS_PER_S)
    with contextlib.ExitStack() as stack:
        files = [stack.enter_context((out / f"{name}.rtcm3").open("wb")) for name in scenario.names]
        for _, index, data in scenario.sent(t_first_gps_ns, t_last_gps_ns):
            files[index].write(data)
    for plan in scenario.plans:
        _write_truth(plan, out / f"{plan.name}.truth.csv", t_first_gps_ns, t_last_gps_ns)


def _write_truth(plan: StationPlan, path: Path, t_first_gps_ns: int, t_last_gps_ns: int) -> None:
    step_ns = NS_PER_S // plan.epoch_rate_hz
    first_ns = -(-t_first_gps_ns // NS_PER_S) * NS_PER_S
    times = np.arange(first_ns, t_last_gps_ns + 1, step_ns, dtype=np.int64)
    displacement = plan.motion(times).displacement_m
    with path.open("w", encoding="ascii") as file:
        file.write("t_gps_s,e_m,n_m,u_m\n")
        for t_ns, (east, north, up) in zip(times.tolist(), displacement.tolist(), strict=True):
            seconds, rest = divmod(t_ns, NS_PER_S)
            file.write(f"{seconds}.{rest:09d},{east:.6f},{north:.6f},{up:.6f}\n")
