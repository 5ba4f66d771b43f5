"""A platform from its first byte: alignment, then the tight filter, over epochs of its antennas as they come.

Until it runs, the first antenna is positioned by itself (:mod:`plumbline.positioning.rtk`), to metres. Once there are a
few seconds of samples, the attitude is found: levelled, with the heading of the antennas where there are several, else
given or gyro-compassed. An attitude with which no integers are found is looked for again. Samples and epochs then go to
the filter. State in, state out.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from plumbline.config import InertialSettings, StationSettings
from plumbline.fusion.alignment import Alignment, describe
from plumbline.fusion.noise import samples_of
from plumbline.fusion.tight_multi_antenna import (
    TightState,
    initial_tight_state,
    receive_epoch,
    receive_samples,
    start_tight,
)
from plumbline.fusion.tight_observations import RowsOfAntenna, antenna_rows, tight_epoch
from plumbline.fusion.tight_start import align_at_rest, align_by_antennas, first_tight_node
from plumbline.fusion.tight_update import TightNode
from plumbline.fusion.timeline import Rows, no_rows
from plumbline.gnss.earth_frames import geodetic_from_ecef
from plumbline.gps_time import NS_PER_S
from plumbline.positioning import rtk
from plumbline.positioning.attitude_baselines import Upright, attitude
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.rtk_state import BaseView, RtkState
from plumbline.positioning.satellites import SatelliteSource
from plumbline.records import Epoch, Floats, InertialBlock, Ints

_ALIGN_S: Final = 5.0  # of samples that the levelling wants
_LEAST_SATELLITES: Final = 6
_KEEP_S: Final = 60.0
_COMPASS_SIGMA_RAD: Final = math.radians(10.0)  # a compass worse than this is none
_UPRIGHT_SIGMA_RAD: Final = math.radians(1.0)  # of levelling on a structure in motion: 0.17 m/s² over the samples' span
_START_SIGMA_M: Final = 3.0  # of the position to begin with: the filter, which knows more, finds its own integers
_TRY_NS: Final = NS_PER_S  # between two attempts to find an attitude
_NEVER_FIXED_NS: Final = 120 * NS_PER_S  # several antennas that find no integers for so long: their attitude is another


@dataclass(frozen=True, slots=True)
class PlatformState:
    """What is kept of a platform. Frozen."""

    tight: TightState
    single: RtkState = field(default_factory=rtk.initial_state)  # of the first antenna, while there is no attitude
    aligned: str = ""  # how, in words; empty while not
    reason: str = ""  # why it does not run, or what it lacks
    t_tried_gps_ns: int = 0  # when an attitude was last looked for


@dataclass(frozen=True, slots=True)
class PlatformResult:
    """The new state, rows of the samples passed, and the states after each epoch applied."""

    state: PlatformState
    rows: Rows
    updated: tuple[TightNode, ...] = ()


@dataclass(frozen=True, slots=True)
class Platform:
    """Everything about a platform that does not change."""

    settings: StationSettings
    inertial: InertialSettings
    facts: StationFacts
    source: SatelliteSource
    rows_of: RowsOfAntenna = antenna_rows  # models an antenna's single differences


def initial_platform_state(station: str) -> PlatformState:
    """Before the first input."""
    return PlatformState(initial_tight_state(station))


def receive_platform_inertial(state: PlatformState, block: InertialBlock, platform: Platform) -> PlatformResult:
    """Apply a block of samples as it comes."""
    if block.angular_rate_rad_s is None:
        return PlatformResult(replace(state, reason="the inertial samples have no angular rates"), no_rows())
    t_gps_ns, samples = samples_of(block, platform.inertial)
    return receive_platform_samples(state, t_gps_ns, samples, platform)


def receive_platform_samples(
    state: PlatformState, t_gps_ns: Ints, samples: Floats, platform: Platform
) -> PlatformResult:
    """Apply samples (n, 6) of body axes at times (n,)."""
    result = receive_samples(state.tight, t_gps_ns, samples, platform.inertial, platform.settings.rtk)
    tight = result.state
    if not tight.timeline.nodes and tight.timeline.t_gps_ns.size:
        first = int(np.searchsorted(tight.timeline.t_gps_ns, tight.timeline.t_gps_ns[-1] - round(_KEEP_S * NS_PER_S)))
        kept = replace(tight.timeline, t_gps_ns=tight.timeline.t_gps_ns[first:], samples=tight.timeline.samples[first:])
        tight = replace(tight, timeline=kept)
    return PlatformResult(replace(state, tight=tight), result.rows, result.updated)


def receive_platform_epochs(
    state: PlatformState, epochs: Sequence[Epoch | None], base: BaseView, platform: Platform
) -> PlatformResult:
    """Apply the epochs of one instant, one an antenna (None: nothing), against what is known of the base then."""
    state = _without_false_start(state, epochs)
    if not state.tight.timeline.nodes:
        return PlatformResult(_aligned(state, epochs, base, platform), no_rows())
    if base.epoch is None or base.position_ecef_m is None:
        return PlatformResult(replace(state, reason=base.reason or "no observations of the base"), no_rows())
    node = state.tight.timeline.nodes[-1]
    origin = np.round(antenna_places(node.nav, platform.inertial))  # to the metre: the same for all filters of a place
    rows = tight_epoch(
        epochs, base.epoch, base.position_ecef_m, origin, platform.source, platform.settings, platform.rows_of
    )
    if rows is None:
        return PlatformResult(replace(state, reason="no satellites in common with the base"), no_rows())
    result = receive_epoch(state.tight, rows, platform.inertial, platform.settings.rtk)
    return PlatformResult(replace(state, tight=result.state, reason=""), result.rows, result.updated)


def antenna_places(nav: Floats, settings: InertialSettings) -> Floats:
    """Antennas (n, 3), Earth-fixed, of a navigation state."""
    places: Floats = nav[0:3] + np.array(settings.lever_arms_body_m) @ nav[6:15].reshape(3, 3).T
    return places


# ------------------------------------------------------------------------------------------- alignment


def _without_false_start(state: PlatformState, epochs: Sequence[Epoch | None]) -> PlatformState:
    """The state, stopped where several antennas have found no integers for long: their attitude must be another."""
    if not state.tight.timeline.nodes or len(epochs) == 1:
        return state
    node = state.tight.timeline.nodes[-1]
    since_ns = node.extra.t_fixed_gps_ns or state.t_tried_gps_ns
    seen = node.extra.t_gnss_gps_ns is not None and node.extra.n_satellites >= _LEAST_SATELLITES
    if not seen or node.t_gps_ns - since_ns < _NEVER_FIXED_NS:
        return state
    timeline = replace(state.tight.timeline, nodes=(), measurements=())
    return replace(state, tight=replace(state.tight, timeline=timeline), aligned="", single=rtk.initial_state())


def _aligned(state: PlatformState, epochs: Sequence[Epoch | None], base: BaseView, platform: Platform) -> PlatformState:
    """The state, running if this epoch allows it; else with the reason why not."""
    first = epochs[0]
    if first is None:
        return replace(state, reason="no observations of the first antenna")
    single, solution, _ = rtk.step(state.single, first, base, platform.source, platform.settings, platform.facts)
    state = replace(state, single=single)
    if solution.position_ecef_m is None:
        return replace(state, reason=solution.reason or f"the first antenna is {solution.status.value}")
    rest = _mean_samples(state.tight, first.t_gps_ns)
    if rest is None:
        return replace(state, reason=f"{_ALIGN_S:.0f} s of inertial samples are wanted first")
    position = np.asarray(solution.position_ecef_m, float)
    if first.t_gps_ns - state.t_tried_gps_ns < _TRY_NS:
        return state
    state = replace(state, t_tried_gps_ns=first.t_gps_ns)
    alignment, reason = _alignment(epochs, position, rest, platform)
    if alignment is None:
        return replace(state, reason=reason)
    node = first_tight_node(first.t_gps_ns, position, _START_SIGMA_M, alignment, platform.inertial)
    return replace(state, tight=start_tight(state.tight, node), aligned=describe(alignment), reason="")


def _mean_samples(tight: TightState, t_gps_ns: int) -> tuple[Floats, float] | None:
    """Mean sample (6,) of the time before an instant, and its span, s; None where there are too few."""
    t, samples = tight.timeline.t_gps_ns, tight.timeline.samples
    before = t <= t_gps_ns
    if not before.any():
        return None
    span_s = float(t[before][-1] - t[before][0]) / NS_PER_S
    return (samples[before].mean(axis=0), span_s) if span_s >= _ALIGN_S else None


def _alignment(
    epochs: Sequence[Epoch | None], position_ecef_m: Floats, rest: tuple[Floats, float], platform: Platform
) -> tuple[Alignment | None, str]:
    """An attitude, or why there is none: levelled, with the heading given, or of the antennas, or compassed."""
    mean, span_s = rest
    inertial, arms = platform.inertial, np.array(platform.inertial.lever_arms_body_m)
    latitude = float(geodetic_from_ecef(position_ecef_m)[0])
    others = [k for k in range(1, len(epochs)) if epochs[k] is not None]
    primary = epochs[0]
    if not others or primary is None or inertial.heading_deg is not None:
        level = align_at_rest(mean[:3], mean[3:], span_s, latitude, inertial)
        if level.sigma_enu_rad[2] > _COMPASS_SIGMA_RAD:
            return None, "heading unknown: give it, or a second antenna (the gyroscope is too coarse for a compass)"
        return level, ""
    auxiliaries = [epoch for k in others if (epoch := epochs[k]) is not None]
    upright = Upright(mean[:3] / np.linalg.norm(mean[:3]), _UPRIGHT_SIGMA_RAD)
    found = attitude(
        primary, auxiliaries, arms[others] - arms[0], position_ecef_m, platform.source, platform.settings, upright
    )
    if not found.fixed or found.baselines_enu_m is None:
        return None, f"attitude: {found.reason}"
    return align_by_antennas(found.baselines_enu_m, arms[others] - arms[0], mean[:3], span_s, inertial), ""
