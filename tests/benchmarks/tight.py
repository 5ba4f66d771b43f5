"""Platforms that one core keeps up with: three antennas at 20 Hz, an IMU at 200 Hz, through the tight filter.

Input are the shaking table's own epochs and samples, decoded beforehand; measured is processor time for everything
from epochs to the filter's state: satellites, differences, samples, updates.
"""

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from tests.benchmarks.table import Row

from plumbline import offline, offline_imu
from plumbline.config import AntennaMotion, InertialSettings, Mode
from plumbline.epochs.stream import Books
from plumbline.evaluation import shake_table_files as files
from plumbline.fusion.inertial_warm_up import warm_up
from plumbline.fusion.tight_platform import (
    Platform,
    initial_platform_state,
    receive_platform_epochs,
    receive_platform_inertial,
)
from plumbline.offline_imu_options import SHEETS
from plumbline.positioning.broadcast_source import BroadcastSource
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.rtk_state import BaseView
from plumbline.records import Epoch, InertialBlock
from plumbline_dtu.shake_table.experiment import START_GPS_NS, Experiment, schedule
from plumbline_dtu.shake_table.write import simulate

LENGTH_S, SKIP_S, ASKED = 30.0, 10.0, 20


def _arrivals(folder: Path) -> tuple[list[object], Platform, np.ndarray]:
    """Blocks and instants of all antennas with the base's epoch, in order, and the platform."""
    description = files.read_description(folder)
    settings = offline.settings_of(
        Mode.RTK, None, 0.0, "GC", 10.0, AntennaMotion.KINEMATIC, "off",
        rtk={"base_stream": "base", "frequencies": 1, "phase_sigma_m": 0.003},
    )  # fmt: skip
    inertial = InertialSettings.model_validate(
        dict(SHEETS["atlans-c"]) | {"lever_arms_body_m": tuple(map(tuple, description["lever_arms_body_m"]))}
    )
    request = offline_imu.ImuRequest(
        settings, inertial, folder / "imu.rtcm3", "auto", folder / "out.csv",
        tuple(folder / f"antenna{k}.rtcm3" for k in (1, 2, 3)), folder / "base.rtcm3", t_near_gps_ns=START_GPS_NS,
    )  # fmt: skip
    books = Books()
    platform = Platform(
        settings, inertial, StationFacts("bench"),
        BroadcastSource(books.ephemerides, books.corrections, settings.positioning),
    )  # fmt: skip
    instants: dict[int, list[Epoch | None]] = {}
    order: list[object] = []
    for arrival in offline_imu.arrivals(request, books):
        if isinstance(arrival.what, InertialBlock):
            order.append(arrival.what)
            continue
        instant = instants.setdefault(arrival.what.t_gps_ns, [None] * 3)
        instant[arrival.stream] = arrival.what
        if None not in instant:
            order.append((instant, books.bases["base"].at(arrival.what.t_gps_ns, arrival.t_receive_ns)))
    return order, platform, np.array(description["base_ecef_m"])


def _processor_s(order: list[object], platform: Platform, base_ecef_m: np.ndarray) -> float:
    state, spent = initial_platform_state("bench"), 0.0
    for what in order:
        begin = time.process_time()
        if isinstance(what, InertialBlock):
            state, t_ns = receive_platform_inertial(state, what, platform).state, what.t_first_gps_ns
        else:
            epochs, base = what  # type: ignore[misc]
            state = receive_platform_epochs(state, epochs, BaseView("base", base, base_ecef_m), platform).state
            t_ns = epochs[0].t_gps_ns
        if t_ns >= START_GPS_NS + SKIP_S * 1e9:
            spent += time.process_time() - begin
    assert state.aligned
    return spent


def run() -> list[Row]:
    """One row: platforms in real time on one core, against the twenty asked for."""
    warm_up()
    whole = schedule(rest_s=10.0, minute_s=20.0)
    plan = replace(whole, vibrations=whole.vibrations[:1], duration_s=LENGTH_S)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        simulate(Experiment(1, plan), folder)
        order, platform, base_ecef_m = _arrivals(folder)
        spent = min(_processor_s(order, platform, base_ecef_m) for _ in range(2))
    platforms = (LENGTH_S - SKIP_S) / spent
    job = "tight filter, 3 antennas at 20 Hz + IMU at 200 Hz"
    return [Row(job, "platforms asked for", platforms, ASKED, "platforms on a core", platforms / ASKED, 1.0)]


if __name__ == "__main__":
    for row in run():
        print(row)
