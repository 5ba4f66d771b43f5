"""Positioning against a base station, one epoch at a time: code and phase differences, integers by LAMBDA.

``step(state, rover, base, source, settings, facts) -> (state, solution, diagnostics)``. Every epoch gives a solution: a
fixed or float position, or a status without one (a metre-level position would pass for motion); and a reason wherever
something lacks. Nothing is remembered outside the state.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from plumbline.config import RtkSettings, StationSettings
from plumbline.estimation.dia_window import add_epoch
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.gather import mask_rad_of, pairs_of, point_of, select_rows
from plumbline.positioning.reasons import cause_text
from plumbline.positioning.rtk_arcs import REFUSED_LIMIT, Tracked, keep_residuals, update_arcs
from plumbline.positioning.rtk_changes import ChangeTest
from plumbline.positioning.rtk_control import Adjusted, Limits, limits_of, snoop
from plumbline.positioning.rtk_filter import accumulate, carry_over, move_position
from plumbline.positioning.rtk_fix import Fix, fix
from plumbline.positioning.rtk_judged import Judged
from plumbline.positioning.rtk_lasting import with_honest_codes
from plumbline.positioning.rtk_model import fill_model, place_of, satellites_of
from plumbline.positioning.rtk_observations import satellites_in, single_difference_rows
from plumbline.positioning.rtk_solution import RtkDiagnostics, relative_solution
from plumbline.positioning.rtk_state import BaseView, RtkState
from plumbline.positioning.rtk_state import initial_state as initial_state  # noqa: PLC0414
from plumbline.positioning.satellites import Cause, SatelliteSource
from plumbline.positioning.solutions import no_position
from plumbline.positioning.state import Records, no_arcs
from plumbline.records import Epoch, Floats, Solution, Status

__all__ = ["RtkDiagnostics", "initial_state", "single_point_of", "step"]

_NS: Final = 1_000_000_000
_MIN_SATELLITES: Final = 4
_FAR_M: Final = 100.0  # a position further from the approximate one is computed again from there
_RESTART_GAP_S: Final = 30.0  # a kinematic antenna may be anywhere after this
_ADOPT_AFTER_NS: Final = 5 * _NS  # a base that has not told its position by then gets a single-point one …
_TRUST_AFTER_NS: Final = 65 * _NS  # … which is its position from then on: 1005/1006 come once a minute at least
_DOUBTS_LIMIT: Final = 3  # epochs in a row that speak against the integers held, and they are let go
_VERIFY_EVERY_NS: Final = 10 * _NS
_YOUNG_EPOCHS: Final = 10  # newly held integers are compared with a free search at every one of these
_SIZE_MEMORY: Final = 20  # epochs of how large changes usually are
_VARIANCE_MEMORY: Final = 500  # epochs of the variance factor …
_VARIANCE_PRIOR: Final = 10  # … and those that the nominal one counts for
_LARGEST_RATIO: Final = 4.0  # what an epoch's variance factor counts for at most, in usual ones
_WINDOW_MEMORY: Final = 0.95  # the window's: 20 epochs
_STANDS_M: Final = 1e-6  # an approximate position no further from the last one is the last one

_Result = tuple[RtkState, Solution, RtkDiagnostics | None]


@dataclass(frozen=True, slots=True)
class _Inputs:
    """An epoch that rover and base both have, and everything else that a step knows."""

    rover: Epoch
    base: Epoch
    base_name: str
    base_position_ecef_m: Floats
    source: SatelliteSource
    settings: StationSettings
    facts: StationFacts

    @property
    def age_s(self) -> float:
        """Age of the base's data at the rover's epoch."""
        return (self.rover.t_gps_ns - self.base.t_gps_ns) / _NS

    @property
    def rtk(self) -> RtkSettings:
        """Settings of relative positioning."""
        return self.settings.rtk

    @property
    def limits(self) -> Limits:
        """Critical values of the tests."""
        return limits_of(self.settings.positioning)

    @property
    def max_gap_ns(self) -> int:
        """Longest interruption that an ambiguity may survive."""
        if self.rtk.integers == "instantaneous":
            return 0
        return round(self.settings.positioning.max_gap_s * _NS)


def step(
    state: RtkState, rover: Epoch, base: BaseView, source: SatelliteSource, settings: StationSettings,
    facts: StationFacts,
) -> tuple[RtkState, Solution, RtkDiagnostics | None]:  # fmt: skip
    """Process one epoch of the rover. Epochs not newer than the last one processed change nothing and say so.

    ``base`` is what is known of the base at that instant; diagnostics are None where nothing could be computed.
    """
    if state.t_last_epoch_ns is not None and rover.t_gps_ns <= state.t_last_epoch_ns:
        return state, no_position(rover, facts, Status.REJECTED, "epoch is not newer than the one before"), None
    state = replace(state, t_last_epoch_ns=rover.t_gps_ns)
    rover = select_rows(rover, settings.positioning.systems)
    if rover.satellite.size == 0:
        return state, no_position(rover, facts, Status.NO_OBSERVATIONS, "no observations of the systems wanted"), None
    state, base_position, why = _base_position(state, rover, base, source, settings)
    if base.epoch is None or base_position is None:
        return state, no_position(rover, facts, Status.NO_BASE, why), None
    rows = single_difference_rows(rover, base.epoch, settings.rtk.frequencies)
    n = satellites_in(rows, False, False)[0].size
    if n < _MIN_SATELLITES:
        reason = f"rover and base {base.station} have {n} satellites in common, {_MIN_SATELLITES} needed"
        return state, no_position(rover, facts, Status.TOO_FEW_SATELLITES, reason, n), None
    inputs = _Inputs(rover, base.epoch, base.station, base_position, source, settings, facts)
    if not _is_provisional(state, base, settings):
        return _relative(state, inputs, rows)
    reference = state.reference_position_ecef_m
    state, solution, diagnostics = _relative(state, inputs, rows)
    why = f"no displacement yet: base {base.station} has not told its position (1005/1006 or a setting)"
    solution = replace(solution, displacement_enu_m=None, reason="; ".join(filter(None, (solution.reason, why))))
    return replace(state, reference_position_ecef_m=reference), solution, diagnostics


def _is_provisional(state: RtkState, base: BaseView, settings: StationSettings) -> bool:
    """Whether the base's position may still be corrected by metres, which must not pass for a motion."""
    told = base.position_ecef_m is not None or settings.rtk.moving_base
    return not told and not _is_adopted_for_good(state, base)


def _is_adopted_for_good(state: RtkState, base: BaseView) -> bool:
    """A single-point position that the series rests on; what the base tells later would be a jump."""
    if state.base_position_ecef_m is None or state.t_base_first_ns is None or base.epoch is None:
        return False
    return base.epoch.t_gps_ns - state.t_base_first_ns >= _TRUST_AFTER_NS


def _base_position(
    state: RtkState, rover: Epoch, base: BaseView, source: SatelliteSource, settings: StationSettings
) -> tuple[RtkState, Floats | None, str]:
    """Where the base is, or why it cannot be used. One that never says it gets a single-point position, once."""
    if base.epoch is None:
        return state, None, base.reason or f"no observations of base {base.station}"
    age_s = (rover.t_gps_ns - base.epoch.t_gps_ns) / _NS
    if abs(age_s) > settings.rtk.max_base_age_s:
        limit = f"limit {settings.rtk.max_base_age_s:.0f} s"
        return state, None, f"last data of base {base.station} {age_s:.0f} s ago, {limit}"
    if settings.rtk.moving_base:
        position = single_point_of(base.epoch, source)
        return state, position, "" if position is not None else f"no single-point position of base {base.station}"
    set_by_hand = settings.rtk.base_position_ecef_m is not None
    if base.position_ecef_m is not None and (set_by_hand or not _is_adopted_for_good(state, base)):
        return replace(state, base_position_ecef_m=None, t_base_first_ns=None), base.position_ecef_m, ""
    first_ns = state.t_base_first_ns if state.t_base_first_ns is not None else base.epoch.t_gps_ns
    state = replace(state, t_base_first_ns=first_ns)
    adopted = state.base_position_ecef_m
    waited = base.epoch.t_gps_ns - first_ns >= _ADOPT_AFTER_NS
    if adopted is None and waited and (position := single_point_of(base.epoch, source)) is not None:
        x, y, z = position.tolist()
        adopted = (x, y, z)
        state = replace(state, base_position_ecef_m=adopted)
    why = f"position of base {base.station} not known yet: neither 1005/1006 nor a setting"
    return state, None if adopted is None else np.array(adopted), "" if adopted else why


def single_point_of(epoch: Epoch, source: SatelliteSource) -> Floats | None:
    """Single-point position of an epoch's antenna, ECEF, m; None where it is impossible."""
    pairs = pairs_of(epoch, source, no_arcs(), precise=False)
    states = source.broadcast(epoch.t_gps_ns, epoch.t_receive_ns, pairs["satellite"], pairs["range_m"])
    point = point_of(pairs, states, None)
    return None if point is None else point.position_ecef_m


def _approximate(state: RtkState, inputs: _Inputs) -> Floats | None:
    """Where the rover is to some ten metres: the last position, or a new single-point one."""
    if state.t_gps_ns is not None and inputs.rover.t_gps_ns - state.t_gps_ns < _RESTART_GAP_S * _NS:
        return state.position_ecef_m
    return single_point_of(inputs.rover, inputs.source)


def _relative(state: RtkState, inputs: _Inputs, rows: Records) -> _Result:
    """Model and test an epoch's codes, then go on to the filter."""
    rover, facts = inputs.rover, inputs.facts
    approximate = _approximate(state, inputs)
    if approximate is None:
        reason = "no approximate position: " + (_why_no_states(rows, inputs) or "the codes contradict each other")
        return state, no_position(rover, facts, Status.NO_EPHEMERIS, reason), None
    states, base_states, index = satellites_of(rows, rover, inputs.base, inputs.source)
    base_place = place_of(inputs.base_position_ecef_m, rover.t_gps_ns)
    mask_rad = mask_rad_of(inputs.settings.positioning)
    codes, moved, n_usable = None, None, 0
    for _ in range(2):
        place = place_of(approximate, rover.t_gps_ns)
        fill_model(rows, states, base_states, index, place, base_place, mask_rad, inputs.age_s, inputs.rtk)
        codes, moved, n_usable = _test_codes(rows, inputs.limits)
        if moved is None or np.linalg.norm(moved) < _FAR_M:
            break
        approximate = approximate + moved
    if codes is None or n_usable < _MIN_SATELLITES or moved is None:
        reason = f"{n_usable} usable satellites in common with base {inputs.base_name}, {_MIN_SATELLITES} needed"
        why = _why_no_states(rows, inputs)
        reason = f"{reason}; {why}" if why else reason
        return state, no_position(rover, facts, Status.TOO_FEW_SATELLITES, reason, n_usable), None
    return _update(state, inputs, rows, codes, approximate)


def _why_no_states(rows: Records, inputs: _Inputs) -> str:
    """The commonest reason why satellites of the rows cannot be used."""
    satellite, first = np.unique(rows["satellite"], return_index=True)
    ranges = rows["code_m"][first].copy()
    states = inputs.source.broadcast(inputs.rover.t_gps_ns, inputs.rover.t_receive_ns, satellite, ranges)
    bad = states.cause[states.cause != Cause.USABLE]
    if bad.size == 0:
        return ""
    causes, counts = np.unique(bad, return_counts=True)
    return cause_text(Cause(int(causes[np.argmax(counts)])), f"{bad.size} of {satellite.size} satellites")


def _test_codes(rows: Records, limits: Limits) -> tuple[Adjusted, Floats | None, int]:
    """The codes by themselves, the position correction that they ask for (None: undetermined), satellites usable."""
    found = snoop(
        rows["line"], rows["code_oc_m"], rows["code_weight"], rows["group"], int(rows["group"].max()) + 1, limits.row,
        max(2, rows.size // 4),
    )  # fmt: skip
    return found, found.b_m if found.regular else None, satellites_in(rows, True, False)[0].size


def _update(state: RtkState, inputs: _Inputs, rows: Records, codes: Adjusted, approximate: Floats) -> _Result:
    """Bring arcs and filter to the epoch, test, resolve, and answer."""
    t_ns, n_groups = inputs.rover.t_gps_ns, int(rows["group"].max()) + 1
    test = _change_test(state, inputs, approximate)
    tracked = update_arcs(state, rows, t_ns, inputs.max_gap_ns, n_groups, test)
    arcs = tracked.arcs
    information, right = _predicted(state, tracked, t_ns, inputs.rtk)
    judged = Judged.of(rows, tracked, codes)
    doubt = judged.test_held(rows, arcs, n_groups, inputs.limits)
    interval_s = 0.0 if state.t_gps_ns is None else (t_ns - state.t_gps_ns) / _NS
    believed = with_honest_codes(rows, judged.use_code, tracked.previous, interval_s)
    static = inputs.rtk.position_noise_m_sqrt_s is not None and state.t_gps_ns is not None
    origin = state.origin_ecef_m if static else approximate
    accumulate(
        information, right, believed, arcs, judged.use_code, judged.use_phase, approximate - origin, n_groups
    )  # fmt: skip
    doubts = state.doubts_in_a_row + 1 if doubt else 0
    let_go = doubts >= _DOUBTS_LIMIT
    if let_go or inputs.rtk.integers != "continuous" or not inputs.rtk.hold:
        arcs["held"] = False
    young = state.fixed_in_a_row < _YOUNG_EPOCHS
    verify = young or t_ns - state.t_verified_ns >= _VERIFY_EVERY_NS
    result, contradicted = fix(information, right, rows, arcs, inputs.rtk, verify)
    if not np.isfinite(result.covariance_m2).all():
        return state, no_position(inputs.rover, inputs.facts, Status.TOO_FEW_SATELLITES, result.reason), None
    arcs = result.arcs
    if let_go:  # whatever led to them is not to be believed either: begin anew with the next epoch
        arcs["refused"] = REFUSED_LIMIT
    position = origin + result.position_m
    keep_residuals(rows, arcs, position - approximate, tracked.codes)
    let_go = let_go or contradicted
    new = replace(
        _with_usual(_sized(state, tracked), judged), t_gps_ns=t_ns, origin_ecef_m=origin, position_ecef_m=position,
        information=information, right=right, arcs=arcs,
        fixed_in_a_row=state.fixed_in_a_row + 1 if result.fixed and not let_go else 0,
        doubts_in_a_row=0 if let_go else doubts, t_verified_ns=t_ns if verify else state.t_verified_ns,
    )  # fmt: skip
    diagnostics = RtkDiagnostics(
        rows, arcs, judged.use_code, judged.use_phase, approximate, inputs.base_position_ecef_m, inputs.age_s,
        result.fixed, origin + result.float_position_m, result.ratio, result.success_rate, result.n_ambiguities,
        result.n_fixed, judged.slips, tracked.motion[0] if tracked.motion else None, let_go, judged,
    )  # fmt: skip
    return _answer(state, new, inputs, result, diagnostics)


def _change_test(state: RtkState, inputs: _Inputs, approximate: Floats) -> ChangeTest:
    """How this epoch's changes are tested; an antenna stands where it is thought to, unless begun again elsewhere."""
    limits, noise, variance = inputs.limits, inputs.rtk.position_noise_m_sqrt_s, 0.0
    if state.t_gps_ns is not None and noise is not None:
        same_place = bool(np.linalg.norm(approximate - state.position_ecef_m) < _STANDS_M)
        variance = noise * noise * (inputs.rover.t_gps_ns - state.t_gps_ns) / _NS if same_place else 0.0
    return ChangeTest(limits.row, limits.motion, state.phase_size, state.code_size, variance)


def _sized(state: RtkState, tracked: Tracked) -> RtkState:
    """The state with what this epoch says of how large changes usually are."""
    if np.isnan(tracked.phases.usual):
        return state
    count = min(state.sizes_count + 1, _SIZE_MEMORY)
    code = state.code_size if np.isnan(tracked.codes.usual) else tracked.codes.usual
    return replace(
        state,
        phase_size=state.phase_size + (tracked.phases.usual - state.phase_size) / count,
        code_size=state.code_size + (code - state.code_size) / count,
        sizes_count=count,
    )


def _answer(old: RtkState, new: RtkState, inputs: _Inputs, result: Fix, diagnostics: RtkDiagnostics) -> _Result:
    """The solution record; the first fixed position becomes the reference where the settings give none."""
    interval_s = None if old.t_gps_ns is None else (inputs.rover.t_gps_ns - old.t_gps_ns) / _NS
    reference = inputs.facts.reference_position_ecef_m or new.reference_position_ecef_m
    solution = relative_solution(
        inputs.rover, inputs.facts, new.position_ecef_m, result, diagnostics, reference, interval_s
    )  # fmt: skip
    if result.fixed and reference is None and solution.position_ecef_m is not None:
        x, y, z = solution.position_ecef_m.tolist()
        new = replace(new, reference_position_ecef_m=(x, y, z))
        solution = replace(solution, displacement_enu_m=np.zeros(3))
    return new, solution, diagnostics


def _with_usual(state: RtkState, judged: Judged) -> RtkState:
    """The state with an epoch's statistics taken in, as in :mod:`plumbline.positioning.usual`."""
    freedom = judged.degrees_of_freedom
    if freedom < 1.0:
        return state
    usual, count = state.variance_factor, min(state.variance_count + 1, _VARIANCE_MEMORY)
    now = min(judged.squares / freedom, _LARGEST_RATIO * usual)
    return replace(
        state,
        window=add_epoch(state.window, judged.squares / usual, round(freedom), _WINDOW_MEMORY),
        variance_factor=usual + (now - usual) / (count + _VARIANCE_PRIOR),
        variance_count=count,
    )


def _predicted(state: RtkState, tracked: Tracked, t_gps_ns: int, rtk: RtkSettings) -> tuple[Floats, Floats]:
    """The filter's information brought to an epoch: ambiguities come and go and fade, the position moves."""
    information, right = carry_over(state.information.copy(), state.right.copy(), tracked.previous)
    dt_s = 0.0 if state.t_gps_ns is None else (t_gps_ns - state.t_gps_ns) / _NS
    noise = rtk.position_noise_m_sqrt_s
    move_position(information, right, np.inf if noise is None or tracked.moved else noise * noise * dt_s)
    fade = np.exp(-dt_s / rtk.ambiguity_memory_s)
    return information * fade, right * fade
