"""The SSR corrections that have been received, asked for *as of* a receive time.

The book is a log of messages and the states that folding them gives. The last minutes' messages are kept, so that a
question about a moment ago gets the answer of that moment: a replay, which asks at other times than the live run did,
finds the same numbers.
"""

from bisect import bisect_right
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plumbline.config import PositioningSettings
from plumbline.epochs.correction_state import NEVER_NS, CorrectionState, fold
from plumbline.gps_time import NS_PER_S
from plumbline.records import Booleans, Floats, Ints, SatelliteIds, SignalIds, SsrCorrection, SsrVtec
from plumbline.signals import SATELLITES_PER_SYSTEM, SIGNALS_PER_SYSTEM, System, system_of

_RECENT_STATES: Final = 4
_LADDER_STEP: Final = 128  # every so many messages a state is kept, so that a question about the past costs little

States = dict[System, CorrectionState]


@dataclass(frozen=True, slots=True)
class AgeLimits:
    """How old corrections may be, s, counted from their epoch."""

    clock_s: float = 30.0
    orbit_s: float = 120.0
    bias_s: float = 7200.0
    high_rate_s: float = 10.0

    @classmethod
    def of(cls, settings: PositioningSettings) -> "AgeLimits":
        """The limits of a station's settings."""
        return cls(settings.max_correction_age_s, settings.max_orbit_correction_age_s, settings.max_bias_age_s)


class CodeBiases(NamedTuple):
    """Code biases of (satellite, signal) rows (n,), metres, *added* to the measured code; NaN where not known."""

    bias_m: Floats


class PhaseBiases(NamedTuple):
    """Phase biases of (satellite, signal) rows, all (n,); NaN and −1 where not known."""

    bias_m: Floats  # *added* to the measured phase
    discontinuity: NDArray[np.int16]
    integer: Booleans
    wide_lane_integer: NDArray[np.int16]


@dataclass(frozen=True, slots=True)
class _Logged:
    t_receive_ns: int
    stream: str
    system: System
    correction: SsrCorrection


@dataclass(slots=True)
class CorrectionBook:
    """All corrections. Bounded: messages of the last ``history_s`` of receive time. Picklable."""

    history_s: float = 180.0
    _log: list[_Logged] = field(default_factory=list)
    _dropped: int = 0  # messages that were in the log and are in the base now
    _base: States = field(default_factory=dict)  # before the log's first message
    _known: dict[int, States] = field(default_factory=dict)  # number of messages ever → states after them
    _vtec: SsrVtec | None = None

    def add(self, correction: SsrCorrection, stream: str = "") -> None:
        """Take a correction in; ``stream`` tells providers of equal numbers apart. Records may hold several systems."""
        if isinstance(correction, SsrVtec):
            self._vtec = correction
            return
        systems = np.unique(correction.satellite // SATELLITES_PER_SYSTEM)
        for number in systems:
            system = System(int(number))
            own = correction if len(systems) == 1 else _of_system(correction, system)
            self._insert(_Logged(correction.header.t_receive_ns, stream, system, own))

    def clear(self) -> None:
        """Forget everything: the times of what came so far have turned out wrong."""
        self._log, self._dropped, self._base, self._known, self._vtec = [], 0, {}, {}, None

    def _insert(self, logged: _Logged) -> None:
        place = len(self._log)
        if self._log and logged.t_receive_ns < self._log[-1].t_receive_ns:
            place = self._place(logged.t_receive_ns)
            last_valid = self._dropped + place
            self._known = {count: states for count, states in self._known.items() if count <= last_valid}
        self._log.insert(place, logged)
        self._forget()

    def _place(self, t_receive_ns: int) -> int:
        """How many of the log's messages had come by a receive time."""
        return bisect_right(self._log, t_receive_ns, key=lambda entry: entry.t_receive_ns)

    def _forget(self) -> None:
        """Fold what is older than the history into the base, now and then."""
        horizon_ns = self._log[-1].t_receive_ns - round(self.history_s * NS_PER_S)
        if len(self._log) < _LADDER_STEP or self._log[_LADDER_STEP - 1].t_receive_ns >= horizon_ns:
            return
        count = self._place(horizon_ns)
        self._base = self._folded(count)
        del self._log[:count]
        self._dropped += count
        self._known = {n: states for n, states in self._known.items() if n > self._dropped}

    def _folded(self, count: int) -> States:
        """States after the log's first ``count`` messages, from the nearest states already known."""
        wanted = self._dropped + count
        done = max((n for n in self._known if n <= wanted), default=self._dropped)
        states = self._known.get(done, self._base)
        while done < wanted:
            until = min(wanted, (done // _LADDER_STEP + 1) * _LADDER_STEP)
            states = dict(states)
            for logged in self._log[done - self._dropped : until - self._dropped]:
                before = states.get(logged.system) or CorrectionState()
                states[logged.system] = fold(before, logged.correction, logged.stream)
            self._known[until] = states
            done = until
        recent = [n for n in self._known if n % _LADDER_STEP]
        if len(recent) > _RECENT_STATES:
            del self._known[min(recent)]
        return states

    def __getstate__(self) -> tuple[Any, ...]:
        return self.history_s, self._log, self._dropped, self._base, self._vtec

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.history_s, self._log, self._dropped, self._base, self._vtec = state
        self._known = {}

    def state(self, system: System, as_of_receive_ns: int) -> CorrectionState | None:
        """The corrections of a system as of a receive time; None where none has come."""
        return self.states(as_of_receive_ns).get(system)

    def states(self, as_of_receive_ns: int) -> States:
        """The corrections of all systems as of a receive time; not to be changed."""
        if not self._log or self._log[-1].t_receive_ns <= as_of_receive_ns:
            return self._folded(len(self._log))
        return self._folded(self._place(as_of_receive_ns))

    def last_epoch_ns(self, system: System, as_of_receive_ns: int) -> int | None:
        """Epoch of the latest orbit or clock of a system; None where none has come."""
        state = self.state(system, as_of_receive_ns)
        return None if state is None or state.last_epoch_ns == NEVER_NS else state.last_epoch_ns

    def vtec(self, as_of_receive_ns: int) -> SsrVtec | None:
        """The latest ionosphere, unless it came later than asked."""
        known = self._vtec is not None and self._vtec.header.t_receive_ns <= as_of_receive_ns
        return self._vtec if known else None

    def code_biases(
        self, satellite: SatelliteIds, signal: SignalIds, t_gps_ns: int, as_of_receive_ns: int, limits: AgeLimits
    ) -> CodeBiases:
        """Code biases of (satellite, signal) rows, both (n,), at a time."""
        bias_m = np.full(satellite.shape, np.nan)
        states = self.states(as_of_receive_ns)
        for rows, state, k, j in _by_system(satellite, signal, states):
            young = _young(state.biases.code_t_ns[k, j], t_gps_ns, limits)
            bias_m[rows] = np.where(young, state.biases.code_m[k, j], np.nan)
        return CodeBiases(bias_m)

    def phase_biases(
        self, satellite: SatelliteIds, signal: SignalIds, t_gps_ns: int, as_of_receive_ns: int, limits: AgeLimits
    ) -> PhaseBiases:
        """Phase biases of (satellite, signal) rows, both (n,), at a time."""
        bias_m = np.full(satellite.shape, np.nan)
        flags = np.full((*satellite.shape, 3), -1, dtype=np.int16)
        states = self.states(as_of_receive_ns)
        for rows, state, k, j in _by_system(satellite, signal, states):
            young = _young(state.biases.phase_t_ns[k, j], t_gps_ns, limits)
            bias_m[rows] = np.where(young, state.biases.phase_m[k, j], np.nan)
            flags[rows] = np.where(young[:, None], state.biases.phase_flags[k, j], -1)
        return PhaseBiases(bias_m, flags[:, 0], flags[:, 1] == 1, flags[:, 2])


def _young(t_ns: Ints, t_gps_ns: int, limits: AgeLimits) -> Booleans:
    limit_ns = round(limits.bias_s * NS_PER_S)
    return np.asarray((t_ns > t_gps_ns - limit_ns) & (t_ns < t_gps_ns + limit_ns), dtype=np.bool_)


def _by_system(
    satellite: SatelliteIds, signal: SignalIds, states: States
) -> list[tuple[NDArray[np.intp], CorrectionState, NDArray[np.intp], NDArray[np.intp]]]:
    """(rows, state, satellite indices, signal indices) of each system that has corrections."""
    of_system = satellite // SATELLITES_PER_SYSTEM
    found = []
    for system, state in states.items():
        rows = np.flatnonzero(of_system == system)
        if rows.size:
            k, j = satellite[rows] % SATELLITES_PER_SYSTEM, signal[rows] % SIGNALS_PER_SYSTEM
            found.append((rows, state, k.astype(np.intp), j.astype(np.intp)))
    return found


def _of_system(correction: SsrCorrection, system: System) -> SsrCorrection:
    """A record's rows of one system."""
    assert not isinstance(correction, SsrVtec)
    mask = np.array([system_of(int(s)) is system for s in correction.satellite], dtype=np.bool_)
    arrays = {
        name: getattr(correction, name)[mask]
        for name in correction.__slots__
        if isinstance(getattr(correction, name), np.ndarray)
    }
    return replace(correction, **arrays)
