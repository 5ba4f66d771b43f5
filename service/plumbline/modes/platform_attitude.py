"""A platform's attitude from its own antennas, put into the solution of its first antenna."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from plumbline.config import StationSettings
from plumbline.positioning.attitude_baselines import attitude
from plumbline.positioning.rtk import single_point_of
from plumbline.positioning.satellites import SatelliteSource
from plumbline.records import Epoch, Solution


def with_attitude(
    solution: Solution, epochs: Sequence[Epoch | None], source: SatelliteSource, settings: StationSettings
) -> Solution:
    """The solution with roll, pitch and heading, or with the reason why they are not known.

    ``epochs``: of one instant, by antenna; the first is the primary's. Antennas without an epoch are done without.
    """
    primary, others = epochs[0], [k for k in range(1, len(epochs)) if epochs[k] is not None]
    if primary is None or not others:
        return _without(solution, "no observations of a second antenna")
    position = solution.position_ecef_m if solution.position_ecef_m is not None else single_point_of(primary, source)
    if position is None:
        return _without(solution, "no approximate position")
    arms = np.array(settings.inertial.lever_arms_body_m)
    auxiliaries = [epoch for k in others if (epoch := epochs[k]) is not None]
    found = attitude(primary, auxiliaries, arms[others] - arms[0], position, source, settings)
    if not found.fixed or found.covariance_rad2 is None:
        return _without(solution, found.reason)
    angles = np.array([found.roll_rad, found.pitch_rad, found.heading_rad])
    return replace(
        solution, attitude_rad=angles, sigma_attitude_rad=np.sqrt(np.diag(found.covariance_rad2))[::-1].copy()
    )


def _without(solution: Solution, why: str) -> Solution:
    return replace(solution, reason="; ".join(filter(None, (solution.reason, f"no attitude: {why}"))))
