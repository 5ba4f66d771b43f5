"""Schemes of the shaking table's experiment without files: the same filters, fed with what is measured directly."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from plumbline import offline
from plumbline.config import AntennaMotion, InertialSettings, Mode, StationSettings
from plumbline.epochs.stream import Books
from plumbline.fusion.tight_platform import (
    Platform,
    PlatformResult,
    PlatformState,
    initial_platform_state,
    receive_platform_epochs,
    receive_platform_inertial,
)
from plumbline.offline_imu_options import SHEETS
from plumbline.positioning import rtk
from plumbline.positioning.broadcast_source import BroadcastSource
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.rtk_state import BaseView, RtkState
from plumbline.records import Epoch, Floats, Status
from plumbline_dtu.encoding import as_received
from plumbline_dtu.shake_table import imu, receiver
from plumbline_dtu.shake_table.experiment import (
    HEADING_DEG,
    START_GPS_NS,
    Experiment,
    lever_arms_body_m,
    table_motion,
)
from plumbline_dtu.shake_table.sky import constellation


@dataclass
class Run:
    """A scheme under way and what it gave: (time s, error ENU m, fixed, rotation ENU from body) each."""

    antennas: tuple[int, ...]
    settings: StationSettings
    platform: Platform | None
    single: RtkState = field(default_factory=rtk.initial_state)
    state: PlatformState = field(default_factory=lambda: initial_platform_state("P"))
    rows: list[tuple[float, Floats, bool, Floats]] = field(default_factory=list)

    @property
    def errors_m(self) -> Floats:
        """Errors (n, 3) of the rows whose integers are held."""
        return np.array([error for _, error, fixed, _ in self.rows if fixed]).reshape(-1, 3)

    @property
    def fixed_after_s(self) -> float:
        """When integers were first held; infinite if never."""
        return next((t for t, _, fixed, _ in self.rows if fixed), np.inf)


def run(experiment: Experiment, schemes: Sequence[str], every: int, phase_sigma_m: float = 0.003) -> dict[str, Run]:
    """Run schemes over an experiment, with each ``every``-th epoch of 20 Hz."""
    books = Books()
    for ephemeris in constellation().broadcast(START_GPS_NS).values():
        received = as_received(ephemeris)
        if received is not None:
            books.ephemerides.add(received)
    settings = offline.settings_of(
        Mode.RTK, None, 0.0, "GC", 10.0, AntennaMotion.KINEMATIC, "off",
        rtk={"base_stream": "base", "frequencies": 1, "phase_sigma_m": phase_sigma_m},
    )  # fmt: skip
    source = BroadcastSource(books.ephemerides, books.corrections, settings.positioning)
    runs = {scheme: _begin(scheme, settings, source) for scheme in schemes}
    needed = sorted({antenna for one in runs.values() for antenna in one.antennas})
    streams = [receiver.observe(experiment, station) for station in (0, *needed)]
    blocks = imu.measure(experiment)
    block = next(blocks, None)
    for k, (base, *epochs) in enumerate(zip(*streams, strict=True)):
        while block is not None and block.t_receive_ns < base.t_gps_ns:
            for one in runs.values():
                if one.platform is not None:
                    _keep(one, receive_platform_inertial(one.state, block, one.platform), experiment)
            block = next(blocks, None)
        if k % every == 0:
            view = BaseView("base", base, experiment.base_ecef_m)
            for one in runs.values():
                _receive(one, dict(zip(needed, epochs, strict=True)), view, source, experiment)
    return runs


def _begin(scheme: str, settings: StationSettings, source: BroadcastSource) -> Run:
    antennas = tuple(int(digit) for digit in scheme.strip("GI"))
    if "I" not in scheme:
        return Run(antennas, settings, None)
    values: dict[str, object] = dict(SHEETS["atlans-c"])
    values["lever_arms_body_m"] = tuple(tuple(lever_arms_body_m()[k - 1]) for k in antennas)
    if len(antennas) == 1:
        values |= {"heading_deg": HEADING_DEG, "heading_sigma_deg": 0.1}
    inertial = InertialSettings.model_validate(values)
    return Run(antennas, settings, Platform(settings, inertial, StationFacts("P"), source))


def _receive(
    one: Run, epochs: dict[int, Epoch], base: BaseView, source: BroadcastSource, experiment: Experiment
) -> None:
    chosen = [epochs[k] for k in one.antennas]
    if one.platform is not None:
        _keep(one, receive_platform_epochs(one.state, chosen, base, one.platform), experiment)
        return
    one.single, solution, _ = rtk.step(one.single, chosen[0], base, source, one.settings, StationFacts("P"))
    if solution.position_ecef_m is not None:
        true = receiver.antenna_ecef_m(experiment, one.antennas[0])
        fixed = solution.status is Status.RTK_FIXED
        one.rows.append(_row(solution.t_gps_ns, solution.position_ecef_m - true, fixed, np.eye(3), experiment))


def _keep(one: Run, done: PlatformResult, experiment: Experiment) -> None:
    one.state = done.state
    for node in done.updated:
        error = node.nav[:3] - experiment.platform_ecef_m
        rotation = experiment.enu @ node.nav[6:15].reshape(3, 3)
        fixed = node.extra.status is Status.RTK_FIXED
        one.rows.append(_row(node.t_gps_ns, error, fixed, rotation, experiment))


def _row(
    t_ns: int, offset_m: Floats, fixed: bool, rotation: Floats, experiment: Experiment
) -> tuple[float, Floats, bool, Floats]:
    moved = table_motion(experiment.schedule, np.array([t_ns])).displacement_m[0]
    return (t_ns - START_GPS_NS) * 1e-9, experiment.enu @ offset_m - moved, fixed, rotation
