"""From one epoch to the next: arcs that carry on, and the filter's state laid out for them."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.positioning.cycle_slip import BEGAN_REFUSED, code_only_clock_jump_m, update_arcs
from plumbline.positioning.ppp_filter import carry_over
from plumbline.positioning.state import PppState, Records
from plumbline.records import Floats, Ints

REFUSED_LIMIT: Final = 3  # epochs in a row after which a refused phase begins a new ambiguity


@dataclass(frozen=True, slots=True)
class Tracked:
    """A state whose arcs have been brought to an epoch; nothing has been predicted or estimated yet."""

    state: PppState
    arc_of_pair: Ints  # (n,) arc of each pair, −1 without phases
    new_ambiguities: int


def track(state: PppState, pairs: Records, sine_elevation: Floats, t_gps_ns: int, max_gap_ns: int) -> Tracked:
    """Bring the arcs to an epoch; ``sine_elevation`` (n,) of the pairs, NaN where not known.

    Ambiguities of arcs that carry on are kept, those of others are dropped. Clock jumps that the receiver applied to
    the codes alone are added to the pairs' phases, in place.
    """
    jump_m = state.phase_jump_m + code_only_clock_jump_m(pairs, state.arcs, state.phase_jump_m)
    pairs["phase_m"] += jump_m
    pairs["wide_lane_cycles"] += jump_m * (pairs["frequency_1_hz"] - pairs["frequency_2_hz"]) / SPEED_OF_LIGHT_M_S
    arcs, previous, arc_of_pair = update_arcs(state.arcs, pairs, sine_elevation, t_gps_ns, max_gap_ns)
    slipped = arcs["refused"] >= REFUSED_LIMIT
    arcs["began"][slipped] = BEGAN_REFUSED
    arcs["t_first_ns"][slipped] = t_gps_ns
    previous[slipped] = -1
    new = previous < 0
    for name in ("estimated", "refused", "doubted", "code_count", "t_residual_ns"):
        arcs[name][new] = 0
    arcs["code_weight_m2"][new] = 0.0
    x, p, q = carry_over(state.x, state.p, state.errors, previous)
    state = replace(state, x=x, p=p, errors=q, arcs=arcs, phase_jump_m=jump_m, t_last_epoch_ns=t_gps_ns)
    return Tracked(state, arc_of_pair, int(np.count_nonzero(new)))


def sines_from(position_ecef_m: Floats, satellite_m: Floats) -> Floats:
    """Sines of the elevations (n,) of satellites (n, 3), NaN where these are, over the geocentric horizon."""
    line = satellite_m - position_ecef_m
    up = position_ecef_m / np.linalg.norm(position_ecef_m)
    sine: Floats = line @ up / np.linalg.norm(line, axis=1)
    return sine
