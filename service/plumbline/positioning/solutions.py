"""Solution records out of filter states and point solutions."""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.gnss.earth_frames import geodetic_from_ecef, rotation_enu_from_ecef
from plumbline.positioning.facts import StationFacts, Vector3
from plumbline.positioning.spp import PointSolution
from plumbline.positioning.state import CLOCKS, POSITION, ZENITH_DELAY, PppState
from plumbline.records import Epoch, Floats, Solution, Status
from plumbline.signals import SYSTEM_LETTERS, System

_CLOCK_PREFERENCE = (System.GPS, System.GALILEO, System.BEIDOU, System.QZSS, System.GLONASS, System.SBAS, System.NAVIC)


def rotation_at(position_ecef_m: Floats) -> Floats:
    """East, north, up from Earth-fixed at a position, (3, 3)."""
    place = geodetic_from_ecef(position_ecef_m)
    rotation: Floats = rotation_enu_from_ecef(place[0], place[1])
    return rotation


def covariance_enu_m2(position_ecef_m: Floats, covariance_ecef_m2: Floats) -> Floats:
    """A position's covariance in east, north, up (3, 3)."""
    rotation = rotation_at(position_ecef_m)
    return rotation @ covariance_ecef_m2 @ rotation.T


@lru_cache(maxsize=1024)
def _rotation_of(reference: Vector3) -> Floats:
    return rotation_at(np.array(reference))


def displacement_enu_m(position_ecef_m: Floats, reference: Vector3 | None) -> Floats | None:
    """East, north, up from the reference position; None without one."""
    if reference is None:
        return None
    start = np.array(reference)
    displacement: Floats = _rotation_of(reference) @ (position_ecef_m - start)
    return displacement


def letters_of(systems: Floats) -> str:
    """RINEX letters of the systems that occur in an array of system numbers."""
    present = set(systems.tolist())
    return "".join(letter for system, letter in enumerate(SYSTEM_LETTERS) if system in present)


def no_position(epoch: Epoch, facts: StationFacts, status: Status, reason: str, n_satellites: int = 0) -> Solution:
    """A solution record that says why there is none."""
    return Solution(facts.station, epoch.t_gps_ns, epoch.t_receive_ns, status, reason, n_satellites)


def point_solution(
    epoch: Epoch, facts: StationFacts, reference: Vector3 | None, point: PointSolution, systems: str, reason: str
) -> Solution:
    """A single-point position, reduced to the marker."""
    position = point.position_ecef_m
    position = position - rotation_at(position).T @ np.array(facts.antenna_offset_enu_m)
    clocks = point.clock_m[np.isfinite(point.clock_m)]
    return Solution(
        facts.station, epoch.t_gps_ns, epoch.t_receive_ns, Status.SINGLE_POINT, reason, int(point.used.sum()),
        position_ecef_m=position,
        displacement_enu_m=displacement_enu_m(position, reference),
        covariance_enu_m2=covariance_enu_m2(position, point.covariance_ecef_m2),
        systems=systems,
        receiver_clock_s=float(clocks[0]) / SPEED_OF_LIGHT_M_S if clocks.size else None,
        pdop=point.pdop,
        extras={
            "test_statistic": point.statistic,
            "degrees_of_freedom": float(point.degrees_of_freedom),
            "rejected_observations": float(np.count_nonzero(~point.used & (point.w != 0.0))),
        },
    )  # fmt: skip


def receiver_clock_s(state: PppState) -> float | None:
    """Receiver clock against the first system in use, s."""
    for system in _CLOCK_PREFERENCE:
        k = CLOCKS.start + system
        if state.p[k, k] > 0.0:
            return float(state.x[k]) / SPEED_OF_LIGHT_M_S
    return None


def precise_solution(
    epoch: Epoch, facts: StationFacts, state: PppState, status: Status, reason: str, n_satellites: int, systems: str,
    covariance_m2: Floats, noise_m2: Floats | None, zenith_hydrostatic_m: float, *, age_s: float | None,
    pdop: float | None, extras: Mapping[str, float],
) -> Solution:  # fmt: skip
    """The filter's position after an update; covariance and its new part (3, 3) in east, north, up."""
    position = state.x[POSITION].copy()
    reference = facts.reference_position_ecef_m or state.reference_position_ecef_m
    return Solution(
        facts.station, epoch.t_gps_ns, epoch.t_receive_ns, status, reason, n_satellites,
        position_ecef_m=position,
        displacement_enu_m=displacement_enu_m(position, reference),
        covariance_enu_m2=covariance_m2,
        noise_enu_m2=noise_m2,
        systems=systems,
        zenith_delay_m=zenith_hydrostatic_m + float(state.x[ZENITH_DELAY]),
        receiver_clock_s=receiver_clock_s(state),
        correction_age_s=age_s,
        pdop=pdop,
        extras=extras,
    )  # fmt: skip
