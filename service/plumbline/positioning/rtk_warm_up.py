"""Compiles every kernel of relative positioning that runs live, on made-up epochs."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from plumbline.config import PositioningSettings, RtkSettings, StationSettings
from plumbline.positioning.attitude_baselines import attitude
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.rtk import step
from plumbline.positioning.rtk_solution import RtkDiagnostics
from plumbline.positioning.rtk_state import BaseView, RtkState, initial_state
from plumbline.positioning.satellites import SatelliteSource
from plumbline.records import Epoch, Floats, Solution


class Relative(NamedTuple):
    """An epoch against a base, as :func:`plumbline.positioning.rtk.step` leaves it."""

    solution: Solution
    state: RtkState
    diagnostics: RtkDiagnostics
    settings: StationSettings


def warm_up_relative(source: SatelliteSource, epochs: Sequence[Epoch], position_ecef_m: Floats) -> Relative:
    """Position an antenna against itself, kinematic and static, and turn a platform of no size; the last epoch."""
    for noise in (None, 0.001):
        rtk = RtkSettings(position_noise_m_sqrt_s=noise)
        settings = StationSettings(station="warm-up", positioning=PositioningSettings(systems="G"), rtk=rtk)
        state = initial_state()
        for epoch in epochs:
            base = BaseView("warm-up", epoch, position_ecef_m)
            state, solution, seen = step(state, epoch, base, source, settings, StationFacts("warm-up"))
    attitude(epochs[0], epochs[:1], np.array([[0.0, 1e-3, 0.0]]), position_ecef_m, source, settings)
    assert seen is not None
    return Relative(solution, state, seen, settings)
