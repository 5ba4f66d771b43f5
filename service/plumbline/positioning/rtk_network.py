"""Positioning against several bases at once: redundant baselines, adjusted and tested against each other.

Each base has a filter of its own, so that one that fails takes nothing along. The baselines of one epoch share the
rover's noise: between any two, half of a baseline's covariance is common (equal receivers). They are adjusted by least
squares with that correlation; a base that contradicts the others (its coordinates are wrong, its antenna was moved, its
integers are) is found by detection, identification and adaptation: an overall model test, then a three-dimensional test
of each base in turn, then the adjustment without it (Teunissen 2006, *Testing theory*, chs 3-4).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from scipy.stats import chi2

from plumbline.config import StationSettings
from plumbline.positioning import rtk
from plumbline.positioning.facts import StationFacts, Vector3
from plumbline.positioning.rtk_state import BaseView, RtkState
from plumbline.positioning.satellites import SatelliteSource
from plumbline.positioning.solutions import displacement_enu_m, rotation_at
from plumbline.records import Epoch, Floats, Solution, Status

_COMMON: Final = 0.5  # share of a baseline's covariance that is the rover's own noise
_SIGNIFICANCE: Final = 0.001
_BASE_SIGMA_M: Final = 0.002  # of the bases' coordinates among each other


@dataclass(frozen=True, slots=True)
class NetworkState:
    """One filter a base, by its stream. Picklable."""

    filters: Mapping[str, RtkState] = field(default_factory=dict)
    reference_position_ecef_m: Vector3 | None = None  # adopted where settings give none


@dataclass(frozen=True, slots=True)
class Adjustment:
    """Baselines of one epoch made one position."""

    position_ecef_m: Floats  # (3,)
    covariance_ecef_m2: Floats  # (3, 3)
    used: tuple[int, ...]  # which of the baselines given
    left_out: tuple[int, ...]  # which contradict the others
    statistic: float  # weighted sum of squares of the residuals
    redundancy: int


def _joint_covariance(covariances: Sequence[Floats]) -> Floats:
    """Covariance (3k, 3k) of k positions that share the rover's noise."""
    k = len(covariances)
    common = _COMMON * np.min([np.trace(c) for c in covariances]) / np.trace(covariances[0]) * covariances[0]
    joint = np.kron(np.ones((k, k)), common)
    for i, c in enumerate(covariances):
        rest = c - common
        lift = max(0.0, 1e-8 - float(np.linalg.eigvalsh(rest)[0]))
        joint[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += rest + (lift + _BASE_SIGMA_M**2) * np.eye(3)
    return joint


def _adjusted(positions: Floats, covariances: Sequence[Floats], use: Sequence[int]) -> tuple[Floats, Floats, float]:
    """Weighted mean of some of the positions, its covariance, and the weighted sum of squares of the residuals."""
    weight = np.linalg.inv(_joint_covariance([covariances[i] for i in use]))
    design = np.kron(np.ones((len(use), 1)), np.eye(3))
    values = positions[list(use)].ravel()
    q = np.linalg.inv(design.T @ weight @ design)
    start = np.tile(positions[use[0]], len(use))
    mean = positions[use[0]] + q @ design.T @ weight @ (values - start)
    rest = values - np.tile(mean, len(use))
    return mean, q, float(rest @ weight @ rest)


def adjust(positions_ecef_m: Floats, covariances_ecef_m2: Sequence[Floats]) -> Adjustment:
    """Adjust positions (k, 3) of one antenna from k bases; those that contradict the others are left out, one by one.

    With two that differ nobody can tell which is wrong: both are left out of nothing, and the statistic says so.
    """
    use, out = list(range(len(positions_ecef_m))), list[int]()
    while True:
        position, q, statistic = _adjusted(positions_ecef_m, covariances_ecef_m2, use)
        redundancy = 3 * (len(use) - 1)
        if len(use) < 3 or statistic <= chi2.ppf(1.0 - _SIGNIFICANCE, redundancy):
            return Adjustment(position, q, tuple(use), tuple(out), statistic, redundancy)
        without = [
            _adjusted(positions_ecef_m, covariances_ecef_m2, [j for j in use if j != i])[2] for i in use
        ]  # the test of base i is the drop of the statistic without it
        worst = use[int(np.argmin(without))]
        use.remove(worst)
        out.append(worst)


def step(
    state: NetworkState, rover: Epoch, bases: Sequence[BaseView], source: SatelliteSource, settings: StationSettings,
    facts: StationFacts,
) -> tuple[NetworkState, Solution]:  # fmt: skip
    """Process one epoch of the rover against every base that has data for it."""
    filters, solutions = dict(state.filters), list[Solution]()
    facts = replace(facts, reference_position_ecef_m=facts.reference_position_ecef_m or state.reference_position_ecef_m)
    for base in bases:
        before = filters.get(base.station, rtk.initial_state())
        filters[base.station], solution, _ = rtk.step(before, rover, base, source, settings, facts)
        solutions.append(solution)
    fixed = [i for i, s in enumerate(solutions) if s.status is Status.RTK_FIXED]
    solution = _best_of(solutions)
    if len(fixed) >= 2:
        solution = _combined([solutions[i] for i in fixed], [bases[i].station for i in fixed], solutions, facts)
    reference = facts.reference_position_ecef_m
    if reference is None and solution.status is Status.RTK_FIXED and solution.position_ecef_m is not None:
        x, y, z = solution.position_ecef_m.tolist()
        reference = (x, y, z)
        solution = replace(solution, displacement_enu_m=np.zeros(3))
    return NetworkState(filters, reference), solution


def _best_of(solutions: Sequence[Solution]) -> Solution:
    """The fixed one, else the first with a position, else the first with all reasons."""
    order = (Status.RTK_FIXED, Status.RTK_FLOAT)
    for status in order:
        for solution in solutions:
            if solution.status is status:
                return solution
    return replace(solutions[0], reason="; ".join(dict.fromkeys(s.reason for s in solutions)))


def _combined(
    fixed: Sequence[Solution], names: Sequence[str], everything: Sequence[Solution], facts: StationFacts
) -> Solution:
    """The adjusted position in the record of the first base that agrees."""
    positions = np.array([s.position_ecef_m for s in fixed])
    enu = rotation_at(positions[0])
    covariances = [enu.T @ np.asarray(s.covariance_enu_m2) @ enu for s in fixed]
    found = adjust(positions, covariances)
    first = fixed[found.used[0]]
    reasons = [f"base {names[i]} contradicts the others and is left out" for i in found.left_out]
    if len(found.used) == 2 and found.statistic > chi2.ppf(1.0 - _SIGNIFICANCE, found.redundancy):
        apart_m = float(np.linalg.norm(positions[found.used[0]] - positions[found.used[1]]))
        reasons.append(
            f"bases {names[found.used[0]]} and {names[found.used[1]]} disagree by {apart_m * 1e3:.0f} mm: "
            "check their coordinates"
        )
    reasons += dict.fromkeys(s.reason for s in everything if s.status is not Status.RTK_FIXED)
    extras = dict(first.extras) | {
        "bases": float(len(found.used)),
        "network_statistic": found.statistic,
        "network_redundancy": float(found.redundancy),
    }
    return replace(
        first,
        reason="; ".join(reasons),
        position_ecef_m=found.position_ecef_m,
        displacement_enu_m=displacement_enu_m(found.position_ecef_m, facts.reference_position_ecef_m),
        covariance_enu_m2=enu @ found.covariance_ecef_m2 @ enu.T,
        extras=extras,
    )
