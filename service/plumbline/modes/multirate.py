"""Solutions and accelerometer samples to motion, by the multirate filter."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from plumbline import fusion
from plumbline.config import StationSettings
from plumbline.estimation.dia_window import equivalent
from plumbline.gps_time import NS_PER_S
from plumbline.modes.context import Felt
from plumbline.positioning.facts import Vector3
from plumbline.records import InertialBlock, Motion, QualityReport, Solution

_AXES: Final = ("east", "north", "up")


def receive_solution(
    state: fusion.FusionState | None, solution: Solution, settings: StationSettings, adopted: Vector3 | None
) -> tuple[fusion.FusionState, list[Motion | Felt]]:
    """Motion after a solution; ``adopted``: the reference position where the settings give none."""
    result = fusion.receive_solution(begun(state, settings, adopted), solution, settings.fusion)
    return result.state, [*result.motions, *_felt(result, solution.t_receive_ns)]


def receive_inertial(
    state: fusion.FusionState | None, block: InertialBlock, settings: StationSettings, adopted: Vector3 | None
) -> tuple[fusion.FusionState, list[Motion | Felt]]:
    """Motion after a block of samples."""
    result = fusion.receive_inertial(begun(state, settings, adopted), block, settings.fusion)
    return result.state, [*result.motions, *_felt(result, block.t_receive_ns)]


def _felt(result: fusion.FusionResult, t_receive_ns: int) -> list[Felt]:
    """The innovations of solutions up to whose time samples carried the motion."""
    return [Felt(i, t_receive_ns) for i in result.innovations if _has_samples(result.state, i.t_gps_ns)]


def _has_samples(state: fusion.FusionState, t_gps_ns: int) -> bool:
    second = next((s for s in state.seconds if s.second == t_gps_ns // NS_PER_S), None)
    if second is None or second.rate == 0:
        return False
    at = min(t_gps_ns % NS_PER_S * second.rate // NS_PER_S, second.filled - 1)
    return at >= 0 and bool(np.isfinite(second.acceleration_m_s2[max(at - 1, 0) : at + 1]).all())


def begun(state: fusion.FusionState | None, settings: StationSettings, adopted: Vector3 | None) -> fusion.FusionState:
    """The state, or that before any input."""
    if state is not None:
        return state
    return fusion.initial_state(settings.station, settings.reference_position_ecef_m or adopted)


def with_tests(report: QualityReport, state: fusion.FusionState | None) -> QualityReport:
    """The report with the tests of the last solution that met its prediction (that may be one before this)."""
    last = None if state is None else state.last_innovation
    if last is None:
        return report
    statistic, freedom = equivalent(last.window)
    tests = {
        "motion_t_gps_s": last.t_gps_ns / NS_PER_S,
        "motion_statistic": last.nis,
        "motion_degrees_of_freedom": float(last.whitened.size),
        "motion_applied": float(last.applied),
        "motion_window_statistic": statistic,
        "motion_window_degrees_of_freedom": freedom,
        **{f"motion_mdb_{axis}_m": float(mdb) for axis, mdb in zip(_AXES, last.mdb_enu_m, strict=True)},
    }
    return replace(report, tests={**report.tests, **tests})


def counters_of(state: fusion.FusionState | None) -> Mapping[str, int]:
    """What the filter has not used, by reason."""
    return {} if state is None else state.counters
