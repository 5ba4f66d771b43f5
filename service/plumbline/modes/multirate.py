"""Solutions and accelerometer samples to motion, by the multirate filter."""

from collections.abc import Mapping

from plumbline import fusion
from plumbline.config import StationSettings
from plumbline.positioning.facts import Vector3
from plumbline.records import InertialBlock, Motion, Solution


def receive_solution(
    state: fusion.FusionState | None, solution: Solution, settings: StationSettings, adopted: Vector3 | None
) -> tuple[fusion.FusionState, list[Motion]]:
    """Motion after a solution; ``adopted``: the reference position where the settings give none."""
    result = fusion.receive_solution(begun(state, settings, adopted), solution, settings.fusion)
    return result.state, result.motions


def receive_inertial(
    state: fusion.FusionState | None, block: InertialBlock, settings: StationSettings, adopted: Vector3 | None
) -> tuple[fusion.FusionState, list[Motion]]:
    """Motion after a block of samples."""
    result = fusion.receive_inertial(begun(state, settings, adopted), block, settings.fusion)
    return result.state, result.motions


def begun(state: fusion.FusionState | None, settings: StationSettings, adopted: Vector3 | None) -> fusion.FusionState:
    """The state, or that before any input."""
    if state is not None:
        return state
    return fusion.initial_state(settings.station, settings.reference_position_ecef_m or adopted)


def counters_of(state: fusion.FusionState | None) -> Mapping[str, int]:
    """What the filter has not used, by reason."""
    return {} if state is None else state.counters
