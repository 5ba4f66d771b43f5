"""Positioning against several bases at once: redundant baselines, adjusted and tested against each other.

Each base has a filter of its own, so that one that fails takes nothing along. The baselines of one epoch share the
rover's noise: between any two, half of a baseline's covariance is common (equal receivers). They are adjusted by least
squares with that correlation; a base that contradicts the others (its coordinates are wrong, its antenna was moved, its
integers are) is found by detection, identification and adaptation: three-dimensional tests of each base, taken in and
taken back, then the adjustment without it (Teunissen 2006, *Testing theory*, chs 3-4). Of two bases that disagree the
adjustment cannot tell which is wrong; the one whose position has jumped alone since both agreed is named.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from plumbline.config import PositioningSettings, StationSettings
from plumbline.estimation.dia import identify
from plumbline.positioning import rtk
from plumbline.positioning.facts import StationFacts, Vector3
from plumbline.positioning.rtk_control import limits_of
from plumbline.positioning.rtk_solution import RtkDiagnostics
from plumbline.positioning.rtk_state import BaseView, RtkState
from plumbline.positioning.satellites import SatelliteSource
from plumbline.positioning.solutions import displacement_enu_m, rotation_at
from plumbline.records import Epoch, Floats, Solution, Status

_COMMON: Final = 0.5  # share of a baseline's covariance that is the rover's own noise
_AGREED_MEMORY: Final = 30  # epochs of the positions while bases agree
DEFAULT_CRITICAL: Final = limits_of(PositioningSettings()).motion
_BASE_SIGMA_M: Final = 0.002  # of the bases' coordinates among each other


@dataclass(frozen=True, slots=True)
class NetworkState:
    """One filter a base, by its stream. Picklable."""

    filters: Mapping[str, RtkState] = field(default_factory=dict)
    reference_position_ecef_m: Vector3 | None = None  # adopted where settings give none
    agreed: Mapping[str, Floats] = field(default_factory=dict)  # mean position (3,) by base, while they agreed


@dataclass(frozen=True, slots=True)
class Seen:
    """The filter that the solution rests on first, and what it saw."""

    state: RtkState
    diagnostics: RtkDiagnostics


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


def _tableau(values: Floats, weight: Floats) -> Floats:
    """Tableau of an error of each base, three columns each, position eliminated (:mod:`plumbline.estimation.dia`)."""
    design = np.kron(np.ones((len(values) // 3, 1)), np.eye(3))
    projected = weight @ design
    information = weight - projected @ np.linalg.solve(design.T @ projected, projected.T)
    along = information @ values
    table: Floats = np.block([[information, along[:, None]], [along[None, :], np.array([[values @ along]])]])
    return np.ascontiguousarray(table)


def adjust(
    positions_ecef_m: Floats, covariances_ecef_m2: Sequence[Floats], critical: float = DEFAULT_CRITICAL
) -> Adjustment:  # fmt: skip
    """Adjust positions (k, 3) of one antenna from k bases; those that contradict the others are left out.

    ``critical`` χ² value of a base's three-dimensional test. With two that differ nobody can tell which is wrong: both
    stay, and the statistic says so.
    """
    k = len(positions_ecef_m)
    start = positions_ecef_m[0]
    weight = np.asarray(np.linalg.inv(_joint_covariance(covariances_ecef_m2)), np.float64)
    table = _tableau((positions_ecef_m - start).ravel(), weight)
    found = identify(table, 3 * np.arange(k + 1), np.full(k, k > 2), np.full(k, critical), 3 * max(k - 2, 0))
    use = [int(i) for i in np.flatnonzero(~found.adopted)]
    joint = np.linalg.inv(_joint_covariance([covariances_ecef_m2[i] for i in use]))
    design = np.kron(np.ones((len(use), 1)), np.eye(3))
    q = np.linalg.inv(design.T @ joint @ design)
    position = start + q @ design.T @ joint @ (positions_ecef_m[use] - start).ravel()
    out = tuple(int(i) for i in found.order)
    return Adjustment(
        position, q, tuple(use), out, float(found.statistic_after), 3 * (len(use) - 1)
    )  # fmt: skip


def mover(
    positions_ecef_m: Floats, covariances_ecef_m2: Sequence[Floats], agreed_ecef_m: Sequence[Floats | None],
    critical: float,
) -> int | None:  # fmt: skip
    """Which of two bases that disagree has moved since they agreed: the one whose position jumped alone.

    A motion of the rover shows in both. None where that does not tell.
    """
    jumped = []
    for position, covariance, agreed in zip(positions_ecef_m, covariances_ecef_m2, agreed_ecef_m, strict=True):
        if agreed is None:
            return None
        change = position - agreed
        jumped.append(bool(change @ np.linalg.solve(2.0 * covariance, change) > critical))
    return jumped.index(True) if jumped.count(True) == 1 else None


def step(
    state: NetworkState, rover: Epoch, bases: Sequence[BaseView], source: SatelliteSource, settings: StationSettings,
    facts: StationFacts,
) -> tuple[NetworkState, Solution, Seen | None]:  # fmt: skip
    """Process one epoch of the rover against every base that has data for it."""
    filters, solutions, seen = dict(state.filters), list[Solution](), list[RtkDiagnostics | None]()
    facts = replace(facts, reference_position_ecef_m=facts.reference_position_ecef_m or state.reference_position_ecef_m)
    for base in bases:
        before = filters.get(base.station, rtk.initial_state())
        filters[base.station], solution, one = rtk.step(before, rover, base, source, settings, facts)
        solutions.append(solution)
        seen.append(one)
    fixed = [i for i, s in enumerate(solutions) if s.status is Status.RTK_FIXED]
    first, agreed = _best_of(solutions), state.agreed
    solution = solutions[first] if seen[first] is not None else _without(solutions)
    if len(fixed) >= 2:
        names = [bases[i].station for i in fixed]
        limit = limits_of(settings.positioning).motion
        solution, used, agreed = _combined([solutions[i] for i in fixed], names, solutions, facts, agreed, limit)
        first = fixed[used]
    reference = facts.reference_position_ecef_m
    if reference is None and solution.status is Status.RTK_FIXED and solution.position_ecef_m is not None:
        x, y, z = solution.position_ecef_m.tolist()
        reference = (x, y, z)
        solution = replace(solution, displacement_enu_m=np.zeros(3))
    diagnostics = seen[first]
    shown = None if diagnostics is None else Seen(filters[bases[first].station], diagnostics)
    return NetworkState(filters, reference, agreed), solution, shown


def _best_of(solutions: Sequence[Solution]) -> int:
    """The fixed one, else the first with a position, else the first."""
    for status in (Status.RTK_FIXED, Status.RTK_FLOAT):
        for i, solution in enumerate(solutions):
            if solution.status is status:
                return i
    return 0


def _without(solutions: Sequence[Solution]) -> Solution:
    """The first, with the reasons of all."""
    return replace(solutions[0], reason="; ".join(dict.fromkeys(s.reason for s in solutions)))


def _combined(
    fixed: Sequence[Solution], names: Sequence[str], everything: Sequence[Solution], facts: StationFacts,
    agreed: Mapping[str, Floats], critical: float,
) -> tuple[Solution, int, Mapping[str, Floats]]:  # fmt: skip
    """The adjusted position in the record of the first base that agrees, which that is, and where bases have agreed."""
    positions = np.array([s.position_ecef_m for s in fixed])
    enu = rotation_at(positions[0])
    covariances = [enu.T @ np.asarray(s.covariance_enu_m2) @ enu for s in fixed]
    found = adjust(positions, covariances, critical)
    reasons = [f"base {names[i]} contradicts the others and is left out" for i in found.left_out]
    if len(found.used) == 2 and found.statistic > critical:
        found, why = _disagreement(found, positions, covariances, names, agreed, critical)
        reasons.append(why)
    else:
        agreed = dict(agreed) | {names[i]: _mean(agreed.get(names[i]), positions[i]) for i in found.used}
    reasons += dict.fromkeys(s.reason for s in everything if s.status is not Status.RTK_FIXED)
    first = fixed[found.used[0]]
    extras = dict(first.extras) | {
        "bases": float(len(found.used)),
        "network_statistic": found.statistic,
        "network_redundancy": float(found.redundancy),
    }
    solution = replace(
        first,
        reason="; ".join(reasons),
        position_ecef_m=found.position_ecef_m,
        displacement_enu_m=displacement_enu_m(found.position_ecef_m, facts.reference_position_ecef_m),
        covariance_enu_m2=enu @ found.covariance_ecef_m2 @ enu.T,
        extras=extras,
    )
    return solution, found.used[0], agreed


def _disagreement(
    found: Adjustment, positions: Floats, covariances: Sequence[Floats], names: Sequence[str],
    agreed: Mapping[str, Floats], critical: float,
) -> tuple[Adjustment, str]:  # fmt: skip
    """Two bases that differ: the adjustment without the one that has moved, where that is known, and the words."""
    a, b = found.used
    pair = [a, b]
    moved = mover(positions[pair], [covariances[i] for i in pair], [agreed.get(names[i]) for i in pair], critical)
    if moved is None:
        apart_mm = float(np.linalg.norm(positions[a] - positions[b])) * 1e3
        return found, f"bases {names[a]} and {names[b]} disagree by {apart_mm:.0f} mm: check their coordinates"
    left, stays = pair[moved], pair[1 - moved]
    alone = replace(
        found, position_ecef_m=positions[stays], covariance_ecef_m2=covariances[stays], used=(stays,),
        left_out=(*found.left_out, left),
    )  # fmt: skip
    return alone, f"base {names[left]} has moved since the bases agreed and is left out"


def _mean(before: Floats | None, now: Floats) -> Floats:
    return now if before is None else before + (now - before) / _AGREED_MEMORY
