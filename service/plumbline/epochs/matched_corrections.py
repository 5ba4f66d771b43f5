"""Both books put together: for each satellite the ephemeris and corrections that belong together, or why none do.

Orbit and clock belong together when their IOD SSR agree and the clock is not older than the orbit's issue: the clock is
counted on top of that ephemeris's clock. Of the current and the previous ones the newest such pair is taken whose
ephemeris has been received, so that neither a half-arrived update nor an ephemeris that comes late leaves a gap.
"""

from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plumbline.epochs.correction_book import AgeLimits, CorrectionBook
from plumbline.epochs.correction_state import (
    CURRENT,
    IOD_SSR,
    ISSUE,
    NEVER_NS,
    PREVIOUS,
    REFERENCE,
    SINCE,
    CorrectionState,
    OrbitsAndClocks,
    T,
)
from plumbline.epochs.ephemeris_book import Entry, Match, issue_by_rule
from plumbline.epochs.ephemeris_chain import EphemerisLookup
from plumbline.gnss.orbits_broadcast import N_COLUMNS
from plumbline.gnss.ssr_orbits import CLOCK, CLOCK_T_S, HIGH_RATE_CLOCK, N_SSR_COLUMNS, ORBIT, ORBIT_T_S
from plumbline.gps_time import NS_PER_S
from plumbline.records import Booleans, Floats, Ints, SatelliteIds
from plumbline.signals import SATELLITES_PER_SYSTEM, System

SYSTEM_NAMES: Final = ("GPS", "GLONASS", "Galileo", "SBAS", "QZSS", "BeiDou", "NavIC")
_ISSUE_NAMES: Final = {System.GALILEO: "IODnav", System.GLONASS: "t_b", System.BEIDOU: "toe modulo"}
#: (orbit slot, clock slot), the newest first.
_PAIRS: Final = ((CURRENT, CURRENT), (PREVIOUS, CURRENT), (CURRENT, PREVIOUS), (PREVIOUS, PREVIOUS))


@dataclass(frozen=True, slots=True)
class MatchedCorrections:
    """One row per satellite asked for, in that order; zeros and NaN where not usable."""

    satellite: SatelliteIds  # (n,)
    match: NDArray[np.int8]  # (n,) Match
    rows: Floats  # (n, N_COLUMNS) packed ephemerides (gnss.orbits_broadcast)
    corrections: Floats  # (n, N_SSR_COLUMNS) packed orbit and clock corrections (gnss.ssr_orbits)
    entries: tuple[Entry | None, ...]
    orbit_age_s: Floats  # (n,) at the time asked for, from the corrections' epochs; given for too old ones too
    clock_age_s: Floats  # (n,)
    ura_m: Floats  # (n,) user range accuracy as the service gives it
    iod_ssr: Ints  # (n,) −1: none
    issue_wanted: Ints  # (n,) issue that the newest orbit correction refers to; −1: none
    issue_held: Ints  # (n,) the newest received ephemeris's, by the same rule; −1: none


def matched(
    ephemerides: EphemerisLookup,
    corrections: CorrectionBook,
    satellite: SatelliteIds,
    t_gps_ns: int,
    as_of_receive_ns: int,
    limits: AgeLimits,
    galileo_message: str = "INAV",
) -> MatchedCorrections:
    """Ephemerides with their corrections for satellite ids (n,) at a time, from what had been received as of another.

    ``galileo_message`` ("INAV" or "FNAV") is the one that the service's clocks refer to; the other is taken where only
    that has come in (same orbit; the clock then differs by some nanoseconds, constant over an issue).
    """
    n = len(satellite)
    out = MatchedCorrections(
        satellite=satellite,
        match=np.full(n, Match.NO_CORRECTIONS, dtype=np.int8),
        rows=np.zeros((n, N_COLUMNS)),
        corrections=np.full((n, N_SSR_COLUMNS), np.nan),
        entries=(),
        orbit_age_s=np.full(n, np.nan),
        clock_age_s=np.full(n, np.nan),
        ura_m=np.full(n, np.nan),
        iod_ssr=np.full(n, -1, dtype=np.int64),
        issue_wanted=np.full(n, -1, dtype=np.int64),
        issue_held=np.full(n, -1, dtype=np.int64),
    )
    entries: list[Entry | None] = [None] * n
    of_system = satellite // SATELLITES_PER_SYSTEM
    question = _Question(ephemerides, t_gps_ns, as_of_receive_ns, limits, galileo_message)
    for system, state in corrections.states(as_of_receive_ns).items():
        places = np.flatnonzero(of_system == system)
        if places.size:
            _match_system(out, entries, places, state, question)
    return replace(out, entries=tuple(entries))


@dataclass(frozen=True, slots=True)
class _Question:
    ephemerides: EphemerisLookup
    t_gps_ns: int
    as_of_ns: int
    limits: AgeLimits
    galileo_message: str


class _Found(NamedTuple):
    """Orbit and clock slot of the pair to use and its ephemeris, or why there is none."""

    orbit_slot: int
    clock_slot: int
    entry: Entry | None
    match: Match


def _match_system(
    out: MatchedCorrections,
    entries: list[Entry | None],
    places: NDArray[np.intp],
    state: CorrectionState,
    q: _Question,
) -> None:
    """Fill the rows ``places`` of one system."""
    table = state.orbits
    k = out.satellite[places].astype(np.intp) % SATELLITES_PER_SYSTEM
    orbit_ints, clock_ints = table.orbit_ints[:, k], table.clock_ints[:, k]
    present = np.flatnonzero((orbit_ints[CURRENT, :, T] != NEVER_NS) & (clock_ints[CURRENT, :, T] != NEVER_NS))
    places, k, orbit_ints, clock_ints = places[present], k[present], orbit_ints[:, present], clock_ints[:, present]
    newest_pairs = _newest_pairs(orbit_ints[CURRENT], clock_ints[CURRENT], q).tolist()
    found = []
    for j, (place, satellite) in enumerate(zip(places.tolist(), out.satellite[places].tolist(), strict=True)):
        one = None
        if newest_pairs[j]:
            one = _ask(satellite, (CURRENT, CURRENT), int(orbit_ints[CURRENT, j, ISSUE]), state.issue_rule, q)
        if one is None or one.entry is None:
            one = _match_one(satellite, orbit_ints[:, j].tolist(), clock_ints[:, j].tolist(), state.issue_rule, q)
        found.append(one)
        entries[place] = one.entry
        if one.entry is None and (newest := q.ephemerides.newest(satellite, q.as_of_ns)) is not None:
            out.issue_held[place] = issue_by_rule(newest.ephemeris, state.issue_rule)
    row = np.arange(places.size)
    o, c = np.array([f.orbit_slot for f in found], np.intp), np.array([f.clock_slot for f in found], np.intp)
    orbit, clock = orbit_ints[o, row], clock_ints[c, row]
    out.match[places] = [f.match for f in found]
    out.issue_wanted[places] = orbit_ints[CURRENT, :, ISSUE]
    out.iod_ssr[places] = orbit[:, IOD_SSR]
    out.orbit_age_s[places] = (q.t_gps_ns - orbit[:, T]) / NS_PER_S
    out.clock_age_s[places] = (q.t_gps_ns - clock[:, T]) / NS_PER_S
    used = np.flatnonzero(out.match[places] == Match.USABLE)
    if used.size:
        places, k, o, c, orbit, clock = places[used], k[used], o[used], c[used], orbit[used], clock[used]
        out.rows[places] = [f.entry.row for f in found if f.entry is not None]
        out.issue_held[places] = orbit[:, ISSUE]
        out.ura_m[places] = state.biases.ura_m[k]
        packed = np.empty((used.size, N_SSR_COLUMNS))
        packed[:, ORBIT_T_S], packed[:, ORBIT_T_S + 1] = np.divmod(orbit[:, REFERENCE], NS_PER_S)
        packed[:, ORBIT : ORBIT + 6] = table.orbit[o, k]
        packed[:, CLOCK_T_S], packed[:, CLOCK_T_S + 1] = np.divmod(clock[:, REFERENCE], NS_PER_S)
        packed[:, CLOCK : CLOCK + 3] = table.clock[c, k]
        packed[:, HIGH_RATE_CLOCK] = _high_rate_m(table, k, clock, q)
        out.corrections[places] = packed


def _ask(satellite: int, slots: tuple[int, int], issue: int, rule: str, q: _Question) -> _Found:
    entry, why = q.ephemerides.select(
        satellite, q.t_gps_ns, q.as_of_ns, issue=issue, issue_rule=rule, message=q.galileo_message
    )
    return _Found(*slots, entry, why)


def _newest_pairs(orbit: Ints, clock: Ints, q: _Question) -> Booleans:
    """Which of the newest orbits and clocks belong together and are in time: the common case, for all satellites."""
    orbit_limit_ns, clock_limit_ns = round(q.limits.orbit_s * NS_PER_S), round(q.limits.clock_s * NS_PER_S)
    together = (orbit[:, IOD_SSR] == clock[:, IOD_SSR]) & (clock[:, T] >= orbit[:, SINCE])
    in_time = (np.abs(q.t_gps_ns - orbit[:, T]) <= orbit_limit_ns) & (
        np.abs(q.t_gps_ns - clock[:, T]) <= clock_limit_ns
    )
    return np.asarray(together & in_time, dtype=np.bool_)


def _match_one(satellite: int, orbits: list[list[int]], clocks: list[list[int]], rule: str, q: _Question) -> _Found:
    """The newest pair of a satellite that can be used; else the reason why the newest in time cannot."""
    match = Match.CORRECTIONS_TOO_OLD
    for o, c in _PAIRS:
        if _belong_together(orbits, clocks, o, c) and _in_time(orbits[o], clocks[c], q):
            found = _ask(satellite, (o, c), orbits[o][ISSUE], rule, q)
            if found.entry is not None:
                return found
            match = found.match if match is Match.CORRECTIONS_TOO_OLD else match
    return _Found(CURRENT, CURRENT, None, match)


def _belong_together(orbits: list[list[int]], clocks: list[list[int]], o: int, c: int) -> bool:
    orbit, clock = orbits[o], clocks[c]
    if orbit[T] == NEVER_NS or clock[T] == NEVER_NS or orbit[IOD_SSR] != clock[IOD_SSR]:
        return False
    follows = clock[T] >= orbits[CURRENT][SINCE]
    return follows if o == CURRENT else not follows


def _in_time(orbit: list[int], clock: list[int], q: _Question) -> bool:
    orbit_age_ns, clock_age_ns = abs(q.t_gps_ns - orbit[T]), abs(q.t_gps_ns - clock[T])
    return orbit_age_ns <= q.limits.orbit_s * NS_PER_S and clock_age_ns <= q.limits.clock_s * NS_PER_S


def _high_rate_m(table: OrbitsAndClocks, k: NDArray[np.intp], clock: Ints, q: _Question) -> Floats:
    """The high-rate clocks that belong on top of clocks, (n,); zero where there is none in time."""
    stamps = table.high_rate_ints[k]
    limit_ns = round(q.limits.high_rate_s * NS_PER_S)
    in_time = (stamps[:, T] >= q.t_gps_ns - limit_ns) & (stamps[:, T] <= q.t_gps_ns + limit_ns)
    follows = (stamps[:, IOD_SSR] == clock[:, IOD_SSR]) & (stamps[:, T] >= clock[:, T])
    return np.where(in_time & follows, table.high_rate_m[k], 0.0)


# --------------------------------------------------------------------------------------------- in words


def reason(found: MatchedCorrections, system: System, limits: AgeLimits, last_epoch_age_s: float | None = None) -> str:
    """Why no satellite of a system can be used, in words that a user can act on; empty where one can.

    ``last_epoch_age_s``: age of the system's last correction (:meth:`CorrectionBook.last_epoch_ns`), None: never came.
    """
    name = SYSTEM_NAMES[system]
    rows = np.flatnonzero(found.satellite // SATELLITES_PER_SYSTEM == system)
    codes = found.match[rows]
    if np.any(codes == Match.USABLE):
        return ""
    if not rows.size:
        return f"no satellites of {name}"
    counts: Any = np.bincount(codes, minlength=len(Match))
    why = Match(int(np.argmax(counts)))
    if why in (Match.NO_CORRECTIONS, Match.CORRECTIONS_TOO_OLD):
        if last_epoch_age_s is None:
            return f"no corrections for {name}: none received"
        ages = found.clock_age_s[rows][codes == why]
        known = ages[np.isfinite(ages)]
        age_s = float(known[np.argmin(np.abs(known))]) if known.size else last_epoch_age_s
        return f"no corrections for {name}: last {age_s:.0f} s ago, limit {limits.clock_s:.0f} s"
    if why is Match.ISSUE_MISMATCH:
        row = int(rows[codes == why][0])
        issue = _ISSUE_NAMES.get(system, "IODE")
        wanted, held = int(found.issue_wanted[row]), int(found.issue_held[row])
        return (
            f"corrections for {name} refer to ephemerides that the stream does not carry "
            f"({issue} {wanted}; we hold {held})"
        )
    text = {
        Match.NO_EPHEMERIS: f"no ephemerides for {name}",
        Match.EPHEMERIS_TOO_OLD: f"ephemerides for {name} are too old",
        Match.UNHEALTHY: f"all satellites of {name} are unhealthy",
    }
    return text[why]
