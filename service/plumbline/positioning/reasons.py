"""Why satellites are not used, in words that an operator can act on."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from plumbline.positioning.satellites import Cause, SatelliteStates
from plumbline.positioning.state import Records
from plumbline.signals import System, system_of_letter

SYSTEM_NAMES: Final[dict[System, str]] = {
    System.GPS: "GPS",
    System.GLONASS: "GLONASS",
    System.GALILEO: "Galileo",
    System.SBAS: "SBAS",
    System.QZSS: "QZSS",
    System.BEIDOU: "BeiDou",
    System.NAVIC: "NavIC",
}


def _age_text(ages_s: Sequence[float], limit_s: float) -> str:
    known = [age for age in ages_s if np.isfinite(age)]
    if not known:
        return ""
    limit = f", limit {limit_s:.0f} s" if np.isfinite(limit_s) else ""
    nearest_s = min(known, key=abs)
    return (
        f": last {nearest_s:.0f} s ago{limit}" if nearest_s >= 0.0 else f": the next is {-nearest_s:.0f} s ahead{limit}"
    )


_TEXTS: Final[dict[Cause, str]] = {
    Cause.USABLE: "",
    Cause.NO_EPHEMERIS: "no ephemeris for {who}",
    Cause.EPHEMERIS_TOO_OLD: "ephemeris of {who} too old",
    Cause.UNHEALTHY: "{who} marked unhealthy",
    Cause.NO_CORRECTIONS: "no corrections for {who}",
    Cause.CORRECTIONS_TOO_OLD: "no corrections for {who}{age}",
    Cause.ISSUE_MISMATCH: "corrections for {who} refer to ephemerides that have not been received",
    Cause.NO_PRECISE_ORBIT: "no precise orbit for {who} at this time",
    Cause.NO_PRECISE_CLOCK: "no precise clock for {who} at this time",
    Cause.NO_CHANNEL: "frequency channel of {who} not known",
}


def cause_text(cause: Cause, who: str, ages_s: Sequence[float] = (), limit_s: float = np.nan) -> str:
    """One cause in words; ``who`` names a system or some of its satellites."""
    return _TEXTS[cause].format(who=who, age=_age_text(ages_s, limit_s))


def missing_systems(systems: str, pairs: Records, states: SatelliteStates) -> str:
    """Why wanted, observed systems do not contribute, or less than half of their satellites do; empty: they all do."""
    if not states.cause.any():
        return ""
    texts = []
    for letter in systems:
        system = system_of_letter(letter)
        observed = np.flatnonzero(pairs["system"] == system)
        missing = observed[states.cause[observed] != Cause.USABLE]
        if 2 * missing.size <= observed.size:
            continue
        causes, counts = np.unique(states.cause[missing], return_counts=True)
        cause = Cause(int(causes[np.argmax(counts)]))
        same = missing[states.cause[missing] == cause]
        name = SYSTEM_NAMES[system]
        who = name if missing.size == observed.size else f"{missing.size} of {observed.size} {name} satellites"
        texts.append(cause_text(cause, who, [float(age) for age in states.age_s[same]], states.limit_s))
    return "; ".join(text for text in texts if text)


def too_few(n: int, needed: int, why: str) -> str:
    """Reason of an epoch with too few satellites."""
    return f"{n} usable satellites, {needed} needed" + (f"; {why}" if why else "")
