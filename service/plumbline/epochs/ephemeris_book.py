"""The broadcast ephemerides that have been received, asked for *as of* a receive time.

A satellite's recent sets are all kept: corrections refer to the previous issue until they have followed, and a question
about the past must get the answer of the past. Sets are told apart by what they say, whoever sent them; a set's receive
time is the first time it came in.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final, NamedTuple

from plumbline.constants import BDT_BEHIND_GPST_S
from plumbline.gnss.orbits_broadcast import pack
from plumbline.gps_time import NS_PER_S, WEEK_NS
from plumbline.records import UNKNOWN_CHANNEL, Ephemeris, Floats, GlonassEphemeris
from plumbline.signals import SATELLITES_PER_SYSTEM, System, system_of

_SETS_KEPT: Final = 24  # a satellite: four hours of Galileo's ten-minute sets, days of the others'
#: Most time between a set's reference and its use, s: the systems' validity with some minutes' grace.
MAX_AGE_S: Final = {
    System.GPS: 7500,
    System.GLONASS: 1860,
    System.GALILEO: 14_400,
    System.SBAS: 360,
    System.QZSS: 7500,
    System.BEIDOU: 21_600,
    System.NAVIC: 7500,
}
#: Corrections that name a set may go on with it for longer than it would serve alone (HAS does by an hour); GPS repeats
#: an IODE after six hours at the earliest (IS-GPS-200, 20.3.4.4).
_AGE_FACTOR_WITH_ISSUE: Final = 2


class Match(IntEnum):
    """Whether a satellite's orbit and clock can be had, and if not, why."""

    USABLE = 0
    NO_EPHEMERIS = 1
    EPHEMERIS_TOO_OLD = 2
    UNHEALTHY = 3
    NO_CORRECTIONS = 4
    CORRECTIONS_TOO_OLD = 5
    ISSUE_MISMATCH = 6  # the corrections refer to a set that has not been received


@dataclass(frozen=True, slots=True)
class Entry:
    """A set, its packed row (:func:`plumbline.gnss.orbits_broadcast.pack`) and when it was first received."""

    ephemeris: Ephemeris
    row: Floats
    first_receive_ns: int


class Choice(NamedTuple):
    """The set to use, or the reason why there is none."""

    entry: Entry | None
    match: Match


def issue_by_rule(ephemeris: Ephemeris, rule: str) -> int:
    """The number by which corrections of a rule (:class:`plumbline.records.SsrOrbit`) name an ephemeris.

    BeiDou: RTCM's toe modulo, 8 s units modulo 1024 (DF470); IGS SSR's toe in units of 720 s modulo 240 (IDF012).
    """
    if rule == "issue":
        return ephemeris.issue
    toe_bdt_s = (ephemeris.toe_gps_ns // NS_PER_S - BDT_BEHIND_GPST_S) % (WEEK_NS // NS_PER_S)
    return toe_bdt_s // 8 % 1024 if rule == "toe_8s" else toe_bdt_s // 720 % 240


def issue_matches(ephemeris: Ephemeris, issue: int, rule: str) -> bool:
    """Whether corrections with an issue refer to an ephemeris; encoders that keep 8 of toe's 10 bits are understood."""
    own = issue_by_rule(ephemeris, rule)
    return own == issue or (rule == "toe_8s" and issue < 256 and own % 256 == issue)


@dataclass(slots=True)
class _Kept:
    """A satellite's sets by first receive time, and the last answer with the span in which it holds."""

    entries: list[Entry] = field(default_factory=list)
    answers: dict[tuple[str | None, int | None, str], tuple[int, int, Choice]] = field(default_factory=dict)


@dataclass(slots=True)
class EphemerisBook:
    """All satellites' sets. Bounded: the last sets of each satellite. Picklable."""

    max_age_s: dict[System, int] = field(default_factory=lambda: dict(MAX_AGE_S))
    _kept: dict[int, _Kept] = field(default_factory=dict)

    def add(self, ephemeris: Ephemeris) -> bool:
        """Take a set in; False where it is known already."""
        kept = self._kept.setdefault(ephemeris.satellite, _Kept())
        key = _content(ephemeris)
        for place, entry in enumerate(kept.entries):
            if _content(entry.ephemeris) == key:
                if ephemeris.t_receive_ns >= entry.first_receive_ns:
                    return False
                del kept.entries[place]
                break
        kept.answers.clear()
        kept.entries.append(Entry(ephemeris, pack(ephemeris), ephemeris.t_receive_ns))
        kept.entries.sort(key=lambda entry: entry.first_receive_ns)
        del kept.entries[:-_SETS_KEPT]
        return True

    def satellites(self) -> list[int]:
        """Satellite ids with any set, ascending."""
        return sorted(self._kept)

    def select(
        self,
        satellite: int,
        t_gps_ns: int,
        as_of_receive_ns: int,
        *,
        issue: int | None = None,
        issue_rule: str = "issue",
        message: str | None = None,
    ) -> Choice:
        """The set for a satellite at a time, from what had been received by ``as_of_receive_ns``.

        Without ``issue``: the one whose reference time is nearest, the later received of equals. ``message`` ("INAV",
        "FNAV"; Galileo only) is preferred to the other that would do, not demanded.
        """
        kept = self._kept.get(satellite)
        if kept is None:
            return Choice(None, Match.NO_EPHEMERIS)
        galileo = satellite // SATELLITES_PER_SYSTEM == System.GALILEO
        message = message if galileo else None
        all_visible = kept.entries[-1].first_receive_ns <= as_of_receive_ns
        key = (message, issue, issue_rule)
        answer = kept.answers.get(key) if all_visible else None
        if answer is not None and answer[0] < t_gps_ns < answer[1]:
            return answer[2]
        visible = [entry for entry in kept.entries if entry.first_receive_ns <= as_of_receive_ns]
        limit_ns = self.max_age_s[system_of(satellite)] * NS_PER_S * (1 if issue is None else _AGE_FACTOR_WITH_ISSUE)
        lower, upper, choice = _choose(visible, t_gps_ns, limit_ns, issue, issue_rule, message)
        if all_visible:
            kept.answers[key] = (lower, upper, choice)
            if len(kept.answers) > 2 * _SETS_KEPT:
                kept.answers.clear()
        return choice

    def newest(self, satellite: int, as_of_receive_ns: int) -> Entry | None:
        """The set received last."""
        kept = self._kept.get(satellite)
        visible = [e for e in kept.entries if e.first_receive_ns <= as_of_receive_ns] if kept else []
        return visible[-1] if visible else None

    def glonass_channel(self, satellite: int, as_of_receive_ns: int) -> int:
        """Frequency channel of a GLONASS satellite by its ephemeris, ``UNKNOWN_CHANNEL`` without one."""
        entry = self.newest(satellite, as_of_receive_ns)
        if entry is None or not isinstance(entry.ephemeris, GlonassEphemeris):
            return UNKNOWN_CHANNEL
        return entry.ephemeris.frequency_channel

    def __getstate__(self) -> tuple[dict[System, int], list[Entry]]:
        return self.max_age_s, [entry for kept in self._kept.values() for entry in kept.entries]

    def __setstate__(self, state: tuple[dict[System, int], list[Entry]]) -> None:
        self.max_age_s, entries = state
        self._kept = {}
        for entry in entries:
            self._kept.setdefault(entry.ephemeris.satellite, _Kept()).entries.append(entry)


def _content(ephemeris: Ephemeris) -> tuple[float | str, ...]:
    """What makes a set a different one."""
    if isinstance(ephemeris, GlonassEphemeris):
        own: tuple[float | str, ...] = ("", *ephemeris.position_pz90_m, ephemeris.clock_bias_s)
    else:
        own = (ephemeris.message, ephemeris.toc_gps_ns, ephemeris.mean_anomaly_rad, ephemeris.clock_bias_s)
    return (ephemeris.toe_gps_ns, ephemeris.issue, ephemeris.health, *own)


_FOREVER_NS: Final = 1 << 62
_Answer = tuple[int, int, Choice]


def _choose(
    entries: list[Entry], t_gps_ns: int, limit_ns: int, issue: int | None, rule: str, message: str | None
) -> _Answer:
    """(after, before, choice): the choice and the open span of times in which it is the same."""
    if not entries:
        return -_FOREVER_NS, _FOREVER_NS, Choice(None, Match.NO_EPHEMERIS)
    fitting = entries if issue is None else [e for e in entries if issue_matches(e.ephemeris, issue, rule)]
    if not fitting:
        return -_FOREVER_NS, _FOREVER_NS, Choice(None, Match.ISSUE_MISMATCH)
    preferred = [e for e in fitting if message in (None, _message_of(e))]
    if preferred:
        answer = _nearest(entries, preferred, t_gps_ns, limit_ns)
        if answer[2].match is Match.USABLE or len(preferred) == len(fitting):
            return answer
    return t_gps_ns, t_gps_ns, _nearest(entries, fitting, t_gps_ns, limit_ns)[2]


def _nearest(entries: list[Entry], fitting: list[Entry], t_gps_ns: int, limit_ns: int) -> _Answer:
    nearest = min(fitting, key=lambda e: (abs(t_gps_ns - e.ephemeris.toe_gps_ns), -e.first_receive_ns))
    toe_ns = nearest.ephemeris.toe_gps_ns
    if abs(t_gps_ns - toe_ns) > limit_ns:
        return t_gps_ns, t_gps_ns, Choice(None, Match.EPHEMERIS_TOO_OLD)
    others = [e.ephemeris.toe_gps_ns for e in fitting if e.ephemeris.toe_gps_ns != toe_ns]
    after = max([toe_ns - limit_ns, *((toe_ns + other) // 2 for other in others if other < toe_ns)])
    before = min([toe_ns + limit_ns, *((toe_ns + other) // 2 for other in others if other > toe_ns)])
    if nearest.ephemeris.health or _newest_alike(entries, nearest).ephemeris.health:
        return after, before, Choice(None, Match.UNHEALTHY)
    return after, before, Choice(nearest, Match.USABLE)


def _message_of(entry: Entry) -> str | None:
    """Message of a Keplerian set; None for GLONASS, which knows but one."""
    return getattr(entry.ephemeris, "message", None)


def _newest_alike(entries: Iterable[Entry], entry: Entry) -> Entry:
    """The last received set of the same message: its health is the satellite's."""
    kind = _message_of(entry)
    return [e for e in entries if _message_of(e) == kind][-1]
