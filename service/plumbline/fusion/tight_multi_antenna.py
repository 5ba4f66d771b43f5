"""Tightly coupled GNSS/IMU with one to N antennas on one platform (Dai 2024, eqs 1-17).

State errors: position, velocity, attitude, accelerometer and gyroscope bias in the Earth-fixed frame, and the
ambiguities that are not resolved yet. Phases and range rates of every antenna, each moved to the IMU's centre by its
lever arm, are differenced to a base and between satellites (:mod:`plumbline.fusion.tight_kernels`); integers come from
:mod:`plumbline.estimation.ambiguity`; feedback is closed. Any subset of antennas serves: the paper's GI1 … GI123.

Errata of the paper that this module does not follow: eq. 5 has the Earth-rate term with the wrong sign (the lever
arm's velocity relative to the Earth is ``C (ω × l) − ω_ie × C l``), so eqs 8 and 11 vary it wrongly; eq. 12 prints
``l_i`` twice, eq. 15 ``F_ba`` twice; eqs 7-11 go with a ψ of the opposite sign.

Samples and epochs may come in any order within ``late_limit_s``: an epoch late goes back to the state of its time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from plumbline.config import InertialSettings, RtkSettings
from plumbline.fusion.noise import noise_row, samples_of
from plumbline.fusion.tight_arcs import TightExtra
from plumbline.fusion.tight_observations import TightEpoch, of_antennas, tight_epoch
from plumbline.fusion.tight_start import first_tight_node
from plumbline.fusion.tight_update import TightNode, update_epoch
from plumbline.fusion.timeline import (
    Rows,
    Timeline,
    add_measurement,
    add_samples,
    counted,
    empty_timeline,
    no_rows,
    run,
)
from plumbline.fusion.zupt import Standstill
from plumbline.records import Floats, InertialBlock, Ints

__all__ = [
    "TightEpoch",
    "TightResult",
    "TightState",
    "first_tight_node",
    "initial_tight_state",
    "of_antennas",
    "receive_epoch",
    "receive_inertial",
    "receive_samples",
    "start_tight",
    "tight_epoch",
]

TightTimeline = Timeline[TightEpoch | Standstill, TightExtra]


@dataclass(frozen=True, slots=True)
class TightState:
    """A platform's filter. Frozen: every function answers with a new one."""

    station: str
    timeline: TightTimeline = field(default_factory=empty_timeline)


@dataclass(frozen=True, slots=True)
class TightResult:
    """The new state, the samples' rows (again, after something late) and the states after each epoch applied."""

    state: TightState
    rows: Rows
    updated: tuple[TightNode, ...] = ()


def initial_tight_state(station: str) -> TightState:
    """Before the first input."""
    return TightState(station)


def start_tight(state: TightState, node: TightNode) -> TightState:
    """Begin to run from a node (:func:`first_tight_node`); what lies before it is dropped."""
    measurements = tuple(m for m in state.timeline.measurements if m.t_gps_ns > node.t_gps_ns)
    return replace(state, timeline=replace(state.timeline, nodes=(node,), measurements=measurements))


def receive_samples(
    state: TightState, t_gps_ns: Ints, samples: Floats, settings: InertialSettings, rtk: RtkSettings
) -> TightResult:
    """Apply samples (n, 6) of body axes at times (n,)."""
    return _run(replace(state, timeline=add_samples(state.timeline, t_gps_ns, samples)), settings, rtk)


def receive_inertial(
    state: TightState, block: InertialBlock, settings: InertialSettings, rtk: RtkSettings
) -> TightResult:
    """Apply a block of samples as it comes."""
    if block.angular_rate_rad_s is None:
        return TightResult(replace(state, timeline=counted(state.timeline, "inertial_without_rates")), no_rows())
    t_gps_ns, samples = samples_of(block, settings)
    return receive_samples(state, t_gps_ns, samples, settings, rtk)


def receive_epoch(state: TightState, epoch: TightEpoch, settings: InertialSettings, rtk: RtkSettings) -> TightResult:
    """Apply an epoch of the antennas at its own time; ahead of the samples, it waits for them."""
    return _run(replace(state, timeline=add_measurement(state.timeline, epoch)), settings, rtk)


def _run(state: TightState, settings: InertialSettings, rtk: RtkSettings) -> TightResult:
    def update(node: TightNode, measurement: TightEpoch | Standstill, sample: Floats) -> TightNode:
        if isinstance(measurement, Standstill):
            return node
        return update_epoch(node, measurement, sample[3:6], settings, rtk)

    ran = run(state.timeline, noise_row(settings), False, update, settings.late_limit_s)
    return TightResult(replace(state, timeline=ran.timeline), ran.rows, ran.updated)


def displacements_enu_m(
    values: Floats,
    reference_ecef_m: Floats,
    rotation_enu_from_ecef: Floats,
    arm_body_m: Sequence[float] = (0.0, 0.0, 0.0),
) -> Floats:
    """Displacement (n, 3), m, of a point of the platform from a reference position, of rows (n, 51)."""
    rotation = values[:, 6:15].reshape(-1, 3, 3)
    points = values[:, 0:3] + rotation @ np.asarray(arm_body_m, float)
    moved: Floats = (points - reference_ecef_m) @ rotation_enu_from_ecef.T
    return moved
