"""Both books put together: for each satellite the ephemeris and corrections that belong together, or why none do.

Orbit and clock belong together when their IOD SSR agree and the clock is not older than the orbit's issue: the clock is
counted on top of that ephemeris's clock. Of the current and the previous ones the newest such pair is taken whose
ephemeris has been received, so that neither a half-arrived update nor an ephemeris that comes late leaves a gap.
"""

from dataclasses import dataclass
from typing import Any, Final

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
from plumbline.records import Floats, Ints, SatelliteIds
from plumbline.signals import SATELLITES_PER_SYSTEM, System, system_of

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


@dataclass(slots=True)
class _Tables:
    """A MatchedCorrections in the making."""

    match: NDArray[np.int8]
    rows: Floats
    corrections: Floats
    entries: list[Entry | None]
    ages: Floats  # (n, 2) orbit, clock
    ura_m: Floats
    issues: Ints  # (n, 3) IOD SSR, wanted, held


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
    out = _Tables(
        match=np.full(n, Match.NO_CORRECTIONS, dtype=np.int8),
        rows=np.zeros((n, N_COLUMNS)),
        corrections=np.full((n, N_SSR_COLUMNS), np.nan),
        entries=[None] * n,
        ages=np.full((n, 2), np.nan),
        ura_m=np.full(n, np.nan),
        issues=np.full((n, 3), -1, dtype=np.int64),
    )
    states = corrections.states(as_of_receive_ns)
    for i, satellite_id in enumerate(satellite.tolist()):
        state = states.get(system_of(satellite_id))
        if state is not None:
            question = _Question(ephemerides, satellite_id, t_gps_ns, as_of_receive_ns, limits, galileo_message)
            _match_one(out, i, state, question)
    return MatchedCorrections(
        satellite=satellite,
        match=out.match,
        rows=out.rows,
        corrections=out.corrections,
        entries=tuple(out.entries),
        orbit_age_s=out.ages[:, 0],
        clock_age_s=out.ages[:, 1],
        ura_m=out.ura_m,
        iod_ssr=out.issues[:, 0],
        issue_wanted=out.issues[:, 1],
        issue_held=out.issues[:, 2],
    )


@dataclass(frozen=True, slots=True)
class _Question:
    ephemerides: EphemerisLookup
    satellite: int
    t_gps_ns: int
    as_of_ns: int
    limits: AgeLimits
    galileo_message: str


def _match_one(out: _Tables, i: int, state: CorrectionState, q: _Question) -> None:
    k, table = q.satellite % SATELLITES_PER_SYSTEM, state.orbits
    orbits, clocks = table.orbit_ints[:, k].tolist(), table.clock_ints[:, k].tolist()
    if orbits[CURRENT][T] == NEVER_NS or clocks[CURRENT][T] == NEVER_NS:
        return
    out.ages[i] = (q.t_gps_ns - orbits[CURRENT][T]) / NS_PER_S, (q.t_gps_ns - clocks[CURRENT][T]) / NS_PER_S
    out.issues[i, :2] = orbits[CURRENT][IOD_SSR], orbits[CURRENT][ISSUE]
    match = Match.CORRECTIONS_TOO_OLD
    for o, c in _PAIRS:
        orbit, clock = orbits[o], clocks[c]
        if not (_belong_together(orbits, clocks, o, c) and _in_time(orbit, clock, q)):
            continue
        entry, why = q.ephemerides.select(
            q.satellite,
            q.t_gps_ns,
            q.as_of_ns,
            issue=orbit[ISSUE],
            issue_rule=state.issue_rule,
            message=q.galileo_message,
        )
        if entry is not None:
            out.match[i], out.entries[i], out.rows[i] = Match.USABLE, entry, entry.row
            out.ages[i] = (q.t_gps_ns - orbit[T]) / NS_PER_S, (q.t_gps_ns - clock[T]) / NS_PER_S
            out.issues[i] = orbit[IOD_SSR], orbits[CURRENT][ISSUE], orbit[ISSUE]
            out.ura_m[i] = state.biases.ura_m[k]
            _fill(out.corrections[i], table, k, (o, c), orbit, clock)
            out.corrections[i, HIGH_RATE_CLOCK] = _high_rate_m(table, k, clock, q)
            return
        match = why if match is Match.CORRECTIONS_TOO_OLD else match
    out.match[i] = match
    newest = q.ephemerides.newest(q.satellite, q.as_of_ns)
    out.issues[i, 2] = -1 if newest is None else issue_by_rule(newest.ephemeris, state.issue_rule)


def _belong_together(orbits: list[list[int]], clocks: list[list[int]], o: int, c: int) -> bool:
    orbit, clock = orbits[o], clocks[c]
    if orbit[T] == NEVER_NS or clock[T] == NEVER_NS or orbit[IOD_SSR] != clock[IOD_SSR]:
        return False
    follows = clock[T] >= orbits[CURRENT][SINCE]
    return follows if o == CURRENT else not follows


def _in_time(orbit: list[int], clock: list[int], q: _Question) -> bool:
    orbit_age_ns, clock_age_ns = abs(q.t_gps_ns - orbit[T]), abs(q.t_gps_ns - clock[T])
    return orbit_age_ns <= q.limits.orbit_s * NS_PER_S and clock_age_ns <= q.limits.clock_s * NS_PER_S


def _fill(
    row: Floats, table: OrbitsAndClocks, k: int, slots: tuple[int, int], orbit: list[int], clock: list[int]
) -> None:
    o, c = slots
    row[ORBIT_T_S], row[ORBIT_T_S + 1] = divmod(orbit[REFERENCE], NS_PER_S)
    row[ORBIT : ORBIT + 6] = table.orbit[o, k]
    row[CLOCK_T_S], row[CLOCK_T_S + 1] = divmod(clock[REFERENCE], NS_PER_S)
    row[CLOCK : CLOCK + 3] = table.clock[c, k]


def _high_rate_m(table: OrbitsAndClocks, k: int, clock: list[int], q: _Question) -> float:
    """The high-rate clock that belongs on top of a clock; zero where there is none in time."""
    t_ns, _, iod_ssr = table.high_rate_ints[k].tolist()
    in_time = abs(q.t_gps_ns - t_ns) <= q.limits.high_rate_s * NS_PER_S
    return float(table.high_rate_m[k]) if in_time and iod_ssr == clock[IOD_SSR] and t_ns >= clock[T] else 0.0


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
