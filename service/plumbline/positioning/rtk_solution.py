"""Solution records out of relative positions, and what quality control may want to see of them."""

from dataclasses import dataclass

import numpy as np

from plumbline.positioning.facts import StationFacts, Vector3
from plumbline.positioning.rtk_control import snoop
from plumbline.positioning.rtk_fix import Fix
from plumbline.positioning.rtk_judged import Judged
from plumbline.positioning.rtk_observations import satellites_in
from plumbline.positioning.rtk_velocity import velocity_of
from plumbline.positioning.solutions import covariance_enu_m2, displacement_enu_m, letters_of, rotation_at
from plumbline.positioning.state import Records
from plumbline.records import Booleans, Epoch, Floats, Ints, Solution, Status
from plumbline.signals import System


@dataclass(frozen=True, slots=True)
class RtkDiagnostics:
    """What an epoch's processing saw, for quality control and for filters that build upon it."""

    rows: Records  # (n,) ROW_DTYPE: single differences with their model
    arcs: Records  # (k,) RTK_ARC_DTYPE: ambiguities, with the integers held
    use_code: Booleans  # (n,)
    use_phase: Booleans  # (n,)
    approximate_ecef_m: Floats  # (3,) the point that the model belongs to
    base_position_ecef_m: Floats  # (3,)
    base_age_s: float
    fixed: bool
    float_position_ecef_m: Floats  # (3,)
    ratio: float
    success_rate: float
    n_ambiguities: int
    n_fixed: int
    slips: int
    motion_ecef_m: Floats | None  # (3,) since the epoch before, from the phases' changes alone
    let_go: bool  # the integers held were given up
    judged: Judged  # what the tests say of each row


def relative_solution(
    rover: Epoch, facts: StationFacts, antenna_ecef_m: Floats, result: Fix, diagnostics: RtkDiagnostics,
    reference: Vector3 | None, interval_s: float | None,
) -> Solution:  # fmt: skip
    """The solution of an epoch, reduced to the marker; ``interval_s`` since the epoch before, None without one."""
    rotation = rotation_at(antenna_ecef_m)
    marker = antenna_ecef_m - rotation.T @ np.array(facts.antenna_offset_enu_m)
    rows = diagnostics.rows
    first, _ = satellites_in(rows, False, True)
    system = rows["system"][first]
    velocity = velocity_of(rows)
    if velocity is None and diagnostics.motion_ecef_m is not None and interval_s:
        velocity = diagnostics.motion_ecef_m / interval_s
    return Solution(
        facts.station, rover.t_gps_ns, rover.t_receive_ns,
        Status.RTK_FIXED if result.fixed else Status.RTK_FLOAT,
        "" if result.fixed else f"integers not resolved: {result.reason}",
        int(first.size),
        position_ecef_m=marker,
        displacement_enu_m=displacement_enu_m(marker, reference),
        covariance_enu_m2=covariance_enu_m2(antenna_ecef_m, result.covariance_m2),
        velocity_enu_m_s=None if velocity is None else rotation @ velocity,
        systems=letters_of(system),
        correction_age_s=diagnostics.base_age_s,
        pdop=_pdop(rows["line"][first], system),
        extras=_extras(rotation @ (antenna_ecef_m - diagnostics.base_position_ecef_m), diagnostics),
    )  # fmt: skip


def _extras(baseline_enu_m: Floats, diagnostics: RtkDiagnostics) -> dict[str, float]:
    refused = ~diagnostics.use_code & (diagnostics.rows["code_weight"] > 0.0)
    refused_phases = ~diagnostics.use_phase & (diagnostics.rows["arc"] >= 0)
    return {
        "ratio": diagnostics.ratio,
        "success_rate": diagnostics.success_rate,
        "ambiguities": float(diagnostics.n_ambiguities),
        "fixed_ambiguities": float(diagnostics.n_fixed),
        "slips": float(diagnostics.slips),
        "rejected_observations": float(np.count_nonzero(refused) + np.count_nonzero(refused_phases)),
        "baseline_e_m": float(baseline_enu_m[0]),
        "baseline_n_m": float(baseline_enu_m[1]),
        "baseline_u_m": float(baseline_enu_m[2]),
    }


def _pdop(line: Floats, system: Ints) -> float | None:
    """Position dilution of precision of the satellites, one clock a system and equal weights."""
    n = system.size
    found = snoop(line, np.zeros(n), np.ones(n), system, len(System), np.inf, 0)
    return float(np.sqrt(np.trace(found.covariance_m2))) if found.regular else None
