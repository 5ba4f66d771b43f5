"""Real-time PPP, one epoch at a time: ``step(state, epoch, source, settings, facts) -> (state, solution)``.

Every epoch gives a solution record: a precise position, a single-point one while the precise one is not possible, or a
status; and a reason wherever something that was asked for is missing. Nothing is remembered outside the state.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from plumbline.config import PositioningSettings
from plumbline.gnss.troposphere import ZENITH_HYDROSTATIC, ZENITH_WET
from plumbline.positioning import ppp_filter
from plumbline.positioning.beidou_codes import correct_beidou_codes
from plumbline.positioning.control import Control, Usual
from plumbline.positioning.cycle_slip import BEGAN_NEW
from plumbline.positioning.epoch_noise import epoch_noise_enu_m2
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.fall_back import enough, fall_back, instead
from plumbline.positioning.gather import Inputs, Site, mask_rad_of, model_of, pairs_of, point_of, site_of
from plumbline.positioning.ppp_model import keep_wind_up
from plumbline.positioning.ppp_noise import tuning_of
from plumbline.positioning.reasons import missing_systems
from plumbline.positioning.satellites import Cause, SatelliteSource
from plumbline.positioning.solutions import letters_of, no_position, precise_solution, rotation_at
from plumbline.positioning.state import GRADIENTS, N_CORE, POSITION, ZENITH_DELAY, PppState, Records, no_arcs
from plumbline.positioning.tracking import Tracked, track
from plumbline.positioning.usual import remember
from plumbline.records import Booleans, Epoch, Floats, Ints, SatelliteIds, Solution, Status, Verdict

_NS: Final = 1_000_000_000
_START_SIGMA_M: Final = 30.0
_ZENITH_WET_SIGMA_M: Final = 0.06
_GRADIENT_SIGMA_M: Final = 0.0005
_WEAK_SIGMA_M: Final = 3.0  # a precise position worse than that is compared with a single point
_STAY_CONVERGED: Final = 2.0  # once converged, a position stays so up to this multiple of the limit
_ACCEPTED: Final = int(Verdict.ACCEPTED)
_REJECTED_LIMIT: Final = 5  # epochs in a row that do not fit, after which the filter begins anew


@dataclass(frozen=True, slots=True)
class EpochQuality:
    """What an update's test saw, for quality control: one row an observation."""

    kind: Ints  # (m,) 2·pair for a code, 2·pair + 1 for a phase
    pairs: Records  # (n,) the pairs meant
    rows: Records  # (n,) their model
    control: Control
    design: Floats  # (m, states)
    innovation_m: Floats  # (m,)
    variance_m2: Floats  # (m,) as the update took them
    slips: tuple[tuple[int, int], ...]  # satellites whose ambiguity began anew, and why (see cycle_slip)
    free: int  # unknowns that nothing but this epoch tells: clock, new ambiguities, a kinematic position
    nis: float  # of the accepted observations as the filter took them: chi-square of as many degrees of freedom

    @property
    def used(self) -> Booleans:
        """Which observations were used (m,)."""
        accepted: Booleans = self.control.verdict == _ACCEPTED
        return accepted

    @property
    def degrees_of_freedom(self) -> int:
        """Redundancy of all observations, used or not."""
        return max(self.kind.size - self.free, 0)


_Result = tuple[PppState, Solution, EpochQuality | None]


def step(
    state: PppState, epoch: Epoch, source: SatelliteSource, settings: PositioningSettings, facts: StationFacts
) -> tuple[PppState, Solution]:
    """Process one epoch. Epochs not newer than the last one processed change nothing and say so."""
    state, solution, _ = step_with_quality(state, epoch, source, settings, facts)
    return state, solution


def step_with_quality(
    state: PppState, epoch: Epoch, source: SatelliteSource, settings: PositioningSettings, facts: StationFacts
) -> tuple[PppState, Solution, EpochQuality | None]:
    """As :func:`step`, with what the test of the observations saw (None where the filter was not updated)."""
    if state.t_last_epoch_ns is not None and epoch.t_gps_ns <= state.t_last_epoch_ns:
        return state, no_position(epoch, facts, Status.REJECTED, "epoch is not newer than the one before"), None
    pairs = pairs_of(epoch, source, state.arcs, precise=True, systems=settings.systems)
    if pairs.size == 0:
        return state, no_position(epoch, facts, Status.NO_OBSERVATIONS, "no codes of the systems wanted"), None
    states = source.precise(epoch.t_gps_ns, epoch.t_receive_ns, pairs["satellite"].copy(), pairs["range_m"].copy())
    missing = missing_systems(settings.systems, pairs, states)
    inputs = Inputs(epoch, pairs, states, settings, facts, tuning_of(settings), missing)
    if not enough(pairs[(states.cause == Cause.USABLE) & (pairs["frequency_2_hz"] > 0.0)]):
        return *fall_back(state, inputs, source), None
    if state.t_gps_ns is None or state.rejected_in_a_row >= _REJECTED_LIMIT:
        return _start(replace(state, t_gps_ns=None), inputs, source)
    return _filter(state, inputs, source)


def _begun(position_ecef_m: Floats, facts: StationFacts, zenith_wet_m: float, state: PppState) -> PppState:
    """A filter at a position that is good to some metres, everything else not known yet."""
    x, p = np.zeros(N_CORE), np.zeros((N_CORE, N_CORE))
    x[POSITION] = position_ecef_m - rotation_at(position_ecef_m).T @ np.array(facts.antenna_offset_enu_m)
    x[ZENITH_DELAY] = zenith_wet_m
    np.fill_diagonal(p[POSITION, POSITION], _START_SIGMA_M**2)
    p[ZENITH_DELAY, ZENITH_DELAY] = _ZENITH_WET_SIGMA_M**2
    np.fill_diagonal(p[GRADIENTS, GRADIENTS], _GRADIENT_SIGMA_M**2)
    return replace(
        state, x=x, p=p, errors=p.copy(), arcs=no_arcs(), phase_jump_m=0.0, phase_scale=1.0, code_scale=1.0,
        rejected_in_a_row=0, t_converged_gps_ns=None,
    )  # fmt: skip


def _start(state: PppState, inputs: Inputs, source: SatelliteSource) -> _Result:
    """Begin the filter from a single-point position of the precise satellites."""
    point = point_of(inputs.pairs, inputs.states, None)
    if point is None:
        return *fall_back(replace(state, t_gps_ns=None), inputs, source), None
    site = site_of(point.position_ecef_m, inputs.facts, inputs.epoch.t_gps_ns)
    begun = _begun(point.position_ecef_m, inputs.facts, float(site.troposphere[ZENITH_WET]), state)
    return _filter(begun, inputs, source)


def _filter(state: PppState, inputs: Inputs, source: SatelliteSource) -> _Result:
    """Model and track an epoch, then predict, test and update."""
    epoch, pairs = inputs.epoch, inputs.pairs
    site = site_of(state.x[POSITION], inputs.facts, epoch.t_gps_ns)
    rows = model_of(pairs, inputs.states, site, inputs.facts, state.arcs, mask_rad_of(inputs.settings))
    if not enough(pairs[rows["usable"]]):
        return *fall_back(state, inputs, source), None
    correct_beidou_codes(pairs, rows)
    tracked = track(state, pairs, rows["sine"], epoch.t_gps_ns, inputs.max_gap_ns)
    keep_wind_up(rows, tracked.state.arcs, tracked.arc_of_pair)
    updated, quality = _update(tracked, rows, inputs)
    if quality is None:
        return _start(replace(state, t_gps_ns=None), inputs, source)
    if updated is None:
        rejected = replace(tracked.state, rejected_in_a_row=state.rejected_in_a_row + 1)
        refused = int(np.count_nonzero(~quality.used))
        reason = f"{refused} and more of {quality.kind.size} observations contradict the others"
        n = int(np.count_nonzero(rows["usable"]))
        return rejected, no_position(epoch, inputs.facts, Status.REJECTED, reason, n), quality
    state, solution, quality = _finish(updated, inputs, site, rows, quality, tracked.new_ambiguities)
    if np.trace(state.errors[POSITION, POSITION]) > _WEAK_SIGMA_M**2:
        solution = instead(state, inputs, source, solution)
    return state, solution, quality


def _update(tracked: Tracked, rows: Records, inputs: Inputs) -> tuple[PppState | None, EpochQuality | None]:
    """The state updated by the epoch (None: its observations do not agree) and the test's findings.

    Both are None where the codes show that the position is wrong altogether.
    """
    state = tracked.state
    x, p, errors = state.x.copy(), state.p.copy(), state.errors.copy()
    arcs, levels = state.arcs.copy(), state.levels.copy()
    dt_s = 0.0 if state.t_gps_ns is None else (inputs.epoch.t_gps_ns - state.t_gps_ns) / _NS
    free = tracked.new_ambiguities + (4 if inputs.tuning.position_jump_m > 0.0 else 1)
    stands = inputs.tuning.position_jump_m == 0.0 and state.t_converged_gps_ns is not None
    usual = Usual(state.code_scale, state.phase_scale, stands)
    outcome, h, v, r, kind, found, nis = ppp_filter.advance(
        x, p, errors, arcs, levels, rows, inputs.pairs, tracked.arc_of_pair, inputs.epoch.t_gps_ns, dt_s, usual,
        inputs.tuning,
    )  # fmt: skip
    if outcome == ppp_filter.LOST:
        return None, None
    quality = EpochQuality(
        kind,
        inputs.pairs,
        rows,
        found,
        h,
        v,
        r,
        _slips(state.arcs, inputs.pairs["satellite"][rows["usable"]], inputs.epoch.t_gps_ns),
        free,
        nis,
    )
    if outcome == ppp_filter.DISAGREES:
        return None, quality
    state = remember(state, found, quality.degrees_of_freedom - int(np.count_nonzero(~quality.used)))
    return replace(
        state, t_gps_ns=inputs.epoch.t_gps_ns, x=x, p=p, errors=errors, arcs=arcs, levels=levels, rejected_in_a_row=0
    ), quality


def _slips(arcs: Records, used: SatelliteIds, t_gps_ns: int) -> tuple[tuple[int, int], ...]:
    """Satellites of those used whose ambiguities begin anew though they were tracked before, and why."""
    anew = arcs[(arcs["t_first_ns"] == t_gps_ns) & (arcs["began"] != BEGAN_NEW)]
    if anew.size == 0:
        return ()
    return tuple((int(arc["satellite"]), int(arc["began"])) for arc in anew if arc["satellite"] in used)


def _finish(
    state: PppState, inputs: Inputs, site: Site, rows: Records, quality: EpochQuality, new_ambiguities: int
) -> tuple[PppState, Solution, EpochQuality]:
    """The solution of an updated filter, and what the state remembers of it."""
    used = quality.used
    covariance: Floats = site.rotation_enu @ state.errors[POSITION, POSITION] @ site.rotation_enu.T
    noise = epoch_noise_enu_m2(
        site.rotation_enu, quality.design, quality.variance_m2, quality.kind, used, state.phase_scale,
        state.covariance_enu_m2, covariance,
    )  # fmt: skip
    state, status = _judged(state, inputs, covariance)
    seen = sorted({kind // 2 for kind in quality.kind[used].tolist()})
    systems = inputs.pairs["system"][seen]
    oldest_s = float(np.fmax.reduce(inputs.states.age_s[seen]))
    extras = {
        "nis": quality.nis,
        "degrees_of_freedom": float(np.count_nonzero(used)),
        "rejected_observations": float(used.size - np.count_nonzero(used)),
        "new_ambiguities": float(new_ambiguities),
        "unhealthy_satellites": float(np.count_nonzero(inputs.states.cause == Cause.UNHEALTHY)),
        "eclipsed_satellites": float(np.count_nonzero(rows["eclipsed"] & rows["usable"])),
    }
    solution = precise_solution(
        inputs.epoch, inputs.facts, state, status, inputs.missing, len(seen), letters_of(systems), covariance, noise,
        float(site.troposphere[ZENITH_HYDROSTATIC]), age_s=None if np.isnan(oldest_s) else oldest_s,
        pdop=ppp_filter.dilution(rows[seen], systems), extras=extras,
    )  # fmt: skip
    return state, solution, quality


def _judged(state: PppState, inputs: Inputs, covariance_enu_m2: Floats) -> tuple[PppState, Status]:
    """Whether the position is as accurate as asked for; the first that is becomes the reference if none is given."""
    settings = inputs.settings
    limit_m = settings.converged_sigma_m * (1.0 if state.t_converged_gps_ns is None else _STAY_CONVERGED)
    converged = float(np.trace(covariance_enu_m2)) <= limit_m**2
    t_converged, reference = state.t_converged_gps_ns, state.reference_position_ecef_m
    if converged and t_converged is None:
        x, y, z = state.x[POSITION].tolist()
        t_converged, reference = inputs.epoch.t_gps_ns, reference or (x, y, z)
    state = replace(
        state, covariance_enu_m2=covariance_enu_m2, t_converged_gps_ns=t_converged, reference_position_ecef_m=reference
    )  # fmt: skip
    return state, Status.PPP_FLOAT if converged else Status.CONVERGING
