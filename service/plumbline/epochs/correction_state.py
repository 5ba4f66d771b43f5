"""What the corrections of one satellite system say after a number of messages: arrays by satellite, folded one by one.

Orbits and clocks are kept twice, the current and the one before, because they are sent apart: between an orbit with a
new issue and its clock, the old pair is the one to use. Folding copies what it changes, so that states can be kept.
"""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plumbline.gnss.ssr_orbits import reference_time_ns
from plumbline.gps_time import NS_PER_S
from plumbline.records import (
    Floats,
    Ints,
    SsrClock,
    SsrCodeBias,
    SsrCorrection,
    SsrHeader,
    SsrOrbit,
    SsrPhaseBias,
    SsrUra,
    SsrVtec,
)
from plumbline.signals import SATELLITES_PER_SYSTEM, SIGNALS_PER_SYSTEM

#: How long the provider in use must be silent before another one is listened to.
PROVIDER_SILENCE_NS: Final = 60 * NS_PER_S
_OLDER_IGNORED_NS: Final = 60 * NS_PER_S  # a message that much older than the last is late; beyond, a restart
NEVER_NS: Final = -(1 << 62)

# Columns of `orbit_ints` and `clock_ints`; an entry that is not there has T = NEVER_NS.
T: Final = 0  # the message's epoch
REFERENCE: Final = 1  # what rates count from
IOD_SSR: Final = 2
ISSUE: Final = 3  # orbits only
SINCE: Final = 4  # orbits only: epoch of the first message with this issue and IOD SSR
CURRENT: Final = 0
PREVIOUS: Final = 1

Provider = tuple[str, int, int]  # stream, provider, solution


def _none_ints(*shape: int) -> Ints:
    return np.full(shape, NEVER_NS, dtype=np.int64)


def _none(*shape: int) -> Floats:
    return np.full(shape, np.nan)


@dataclass(frozen=True, slots=True)
class OrbitsAndClocks:
    """Orbits and clocks by slot (CURRENT, PREVIOUS) and satellite."""

    orbit_ints: Ints = field(default_factory=lambda: _none_ints(2, SATELLITES_PER_SYSTEM, 5))
    orbit: Floats = field(default_factory=lambda: _none(2, SATELLITES_PER_SYSTEM, 6))  # radial, along, cross; rates
    clock_ints: Ints = field(default_factory=lambda: _none_ints(2, SATELLITES_PER_SYSTEM, 3))
    clock: Floats = field(default_factory=lambda: _none(2, SATELLITES_PER_SYSTEM, 3))
    high_rate_ints: Ints = field(default_factory=lambda: _none_ints(SATELLITES_PER_SYSTEM, 3))
    high_rate_m: Floats = field(default_factory=lambda: _none(SATELLITES_PER_SYSTEM))


@dataclass(frozen=True, slots=True)
class Biases:
    """Biases by satellite and signal, each with its epoch; yaw and accuracy by satellite."""

    code_t_ns: Ints = field(default_factory=lambda: _none_ints(SATELLITES_PER_SYSTEM, SIGNALS_PER_SYSTEM))
    code_m: Floats = field(default_factory=lambda: _none(SATELLITES_PER_SYSTEM, SIGNALS_PER_SYSTEM))
    phase_t_ns: Ints = field(default_factory=lambda: _none_ints(SATELLITES_PER_SYSTEM, SIGNALS_PER_SYSTEM))
    phase_m: Floats = field(default_factory=lambda: _none(SATELLITES_PER_SYSTEM, SIGNALS_PER_SYSTEM))
    phase_flags: NDArray[np.int16] = field(  # discontinuity counter, integer, wide-lane group
        default_factory=lambda: np.full((SATELLITES_PER_SYSTEM, SIGNALS_PER_SYSTEM, 3), -1, dtype=np.int16)
    )
    yaw: Floats = field(default_factory=lambda: _none(SATELLITES_PER_SYSTEM, 2))  # rad, rad/s
    ura_m: Floats = field(default_factory=lambda: _none(SATELLITES_PER_SYSTEM))


@dataclass(frozen=True, slots=True)
class CorrectionState:
    """The corrections of one system and who they come from."""

    provider: Provider | None = None  # of orbits and clocks; others' messages are ignored
    bias_provider: Provider | None = None
    last_receive_ns: int = NEVER_NS  # of an orbit or clock of the provider
    last_epoch_ns: int = NEVER_NS
    issue_rule: str = "issue"
    ignored: int = 0
    orbits: OrbitsAndClocks = field(default_factory=OrbitsAndClocks)
    biases: Biases = field(default_factory=Biases)


def fold(state: CorrectionState, correction: SsrCorrection, stream: str) -> CorrectionState:
    """State after a message that holds satellites of this system alone."""
    header = correction.header
    sender = (stream, header.provider, header.solution)
    if isinstance(correction, SsrOrbit | SsrClock):
        state = _listening_to(state, sender, header)
        if state.provider != sender:
            return replace(state, ignored=state.ignored + 1)
        folded = _fold_orbit if isinstance(correction, SsrOrbit) else _fold_clock
        rule = correction.issue_rule if isinstance(correction, SsrOrbit) else state.issue_rule
        return replace(
            state,
            last_receive_ns=header.t_receive_ns,
            last_epoch_ns=max(header.t_gps_ns, state.last_epoch_ns),
            issue_rule=rule,
            orbits=folded(state.orbits, correction),  # type: ignore[arg-type]
        )
    if isinstance(correction, SsrVtec):
        return state
    wanted = state.provider or state.bias_provider or sender
    if sender != wanted:
        return replace(state, ignored=state.ignored + 1)
    return replace(state, bias_provider=sender, biases=_fold_bias(state.biases, correction))


def _listening_to(state: CorrectionState, sender: Provider, header: SsrHeader) -> CorrectionState:
    """The state with its provider settled: the first stays until it is silent; another's biases are not mixed in."""
    if state.provider is None:
        keep = state.bias_provider in (None, sender)
        return replace(state, provider=sender, biases=state.biases if keep else Biases())
    silent = header.t_receive_ns - state.last_receive_ns > PROVIDER_SILENCE_NS
    return CorrectionState(provider=sender) if sender != state.provider and silent else state


def _rows(satellite: NDArray[np.int16]) -> NDArray[np.intp]:
    return satellite.astype(np.intp) % SATELLITES_PER_SYSTEM


def _fresh(known_t_ns: Ints, t_ns: int) -> NDArray[np.bool_]:
    """Which of the satellites take a message of an epoch: not one that comes late."""
    return (known_t_ns <= t_ns) | (known_t_ns > t_ns + _OLDER_IGNORED_NS)


def _fold_orbit(now: OrbitsAndClocks, message: SsrOrbit) -> OrbitsAndClocks:
    header, k = message.header, _rows(message.satellite)
    fresh = _fresh(now.orbit_ints[CURRENT, k, T], header.t_gps_ns)
    k, issue = k[fresh], message.issue[fresh]
    ints, values = now.orbit_ints.copy(), now.orbit.copy()
    known = ints[CURRENT, k]
    changed = (known[:, ISSUE] != issue) | (known[:, IOD_SSR] != header.iod_ssr)
    turned = k[changed]
    ints[PREVIOUS, turned], values[PREVIOUS, turned] = ints[CURRENT, turned], values[CURRENT, turned]
    first = turned[ints[PREVIOUS, turned, T] == NEVER_NS]
    ints[CURRENT, turned, SINCE] = header.t_gps_ns
    ints[CURRENT, first, SINCE] = NEVER_NS  # nothing to tell it from: any clock may belong to it
    ints[CURRENT, k, T], ints[CURRENT, k, REFERENCE] = header.t_gps_ns, reference_time_ns(header)
    ints[CURRENT, k, IOD_SSR], ints[CURRENT, k, ISSUE] = header.iod_ssr, issue
    values[CURRENT, k, :3], values[CURRENT, k, 3:] = message.delta_rac_m[fresh], message.delta_rate_rac_m_s[fresh]
    older = turned[now.clock_ints[CURRENT, turned, T] < header.t_gps_ns]
    clock_ints, clock = now.clock_ints, now.clock
    if older.size:
        clock_ints, clock = clock_ints.copy(), clock.copy()
        clock_ints[PREVIOUS, older], clock[PREVIOUS, older] = clock_ints[CURRENT, older], clock[CURRENT, older]
    return replace(now, orbit_ints=ints, orbit=values, clock_ints=clock_ints, clock=clock)


def _fold_clock(now: OrbitsAndClocks, message: SsrClock) -> OrbitsAndClocks:
    header, k = message.header, _rows(message.satellite)
    stamp = (header.t_gps_ns, reference_time_ns(header), header.iod_ssr)
    if message.high_rate:
        fresh = _fresh(now.high_rate_ints[k, T], header.t_gps_ns)
        ints, high_rate_m = now.high_rate_ints.copy(), now.high_rate_m.copy()
        ints[k[fresh]], high_rate_m[k[fresh]] = stamp, message.polynomial_m[fresh, 0]
        return replace(now, high_rate_ints=ints, high_rate_m=high_rate_m)
    fresh = _fresh(now.clock_ints[CURRENT, k, T], header.t_gps_ns)
    k = k[fresh]
    ints, values = now.clock_ints.copy(), now.clock.copy()
    turned = k[ints[CURRENT, k, IOD_SSR] != header.iod_ssr]
    ints[PREVIOUS, turned], values[PREVIOUS, turned] = ints[CURRENT, turned], values[CURRENT, turned]
    ints[CURRENT, k], values[CURRENT, k] = stamp, message.polynomial_m[fresh]
    return replace(now, clock_ints=ints, clock=values)


def _fold_bias(now: Biases, message: SsrCodeBias | SsrPhaseBias | SsrUra) -> Biases:
    k, t_ns = _rows(message.satellite), message.header.t_gps_ns
    if isinstance(message, SsrUra):
        ura_m = now.ura_m.copy()
        ura_m[k] = message.ura_m
        return replace(now, ura_m=ura_m)
    j = message.signal.astype(np.intp) % SIGNALS_PER_SYSTEM
    if isinstance(message, SsrCodeBias):
        code_t_ns, code_m = now.code_t_ns.copy(), now.code_m.copy()
        code_t_ns[k, j], code_m[k, j] = t_ns, message.bias_m
        return replace(now, code_t_ns=code_t_ns, code_m=code_m)
    phase_t_ns, phase_m, flags, yaw = now.phase_t_ns.copy(), now.phase_m.copy(), now.phase_flags.copy(), now.yaw.copy()
    phase_t_ns[k, j], phase_m[k, j] = t_ns, message.bias_m
    flags[k, j, 0], flags[k, j, 1], flags[k, j, 2] = message.discontinuity, message.integer, message.wide_lane_integer
    yaw[k, 0], yaw[k, 1] = message.yaw_angle_rad, message.yaw_rate_rad_s
    return replace(now, phase_t_ns=phase_t_ns, phase_m=phase_m, phase_flags=flags, yaw=yaw)
