"""The tight filter's ambiguities: which are held as integers, which are states, and when one begins or ends.

An arc is one antenna, satellite and signal. Its ambiguity is counted from the receiver clock of its group, so integers
mean something relative to each other only; the first arc of a group is held at a whole number for a datum. The other
new ones are states of the filter until integer least squares resolves them.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numba import njit

from plumbline.fusion.tight_observations import TightEpoch
from plumbline.gps_time import NS_PER_S
from plumbline.positioning.state import Records
from plumbline.records import Booleans, Floats, Ints, Status

ARC_DTYPE: Final = np.dtype(
    [
        ("key", np.int64),
        ("group", np.int64),
        ("held", np.bool_),  # `value` is its integer; else the ambiguity is a state of the filter
        ("integer", np.bool_),
        ("value", np.float64),  # cycles; of a state: its estimate
        ("count", np.int64),  # epochs used
        ("refused", np.int64),  # epochs in a row that did not fit
        ("lock_time_s", np.float64),
        ("t_last_ns", np.int64),
    ]
)
MAX_GAP_NS: Final = 10 * NS_PER_S  # an arc not seen for longer is over
REFUSED_LIMIT: Final = 5
FIRST_SIGMA_CYCLES: Final = 300.0


@dataclass(frozen=True, slots=True)
class Pending:
    """Integers found, the same at ``count`` epochs since ``t_since_gps_ns``."""

    key: Ints  # (k,) of the arcs, sorted
    integer: Ints  # (k,)
    t_since_gps_ns: int
    count: int


@dataclass(frozen=True, slots=True)
class TightExtra:
    """What goes with the navigation state. ``arcs`` are sorted by key; their states follow the 15 in that order."""

    arcs: Records = field(default_factory=lambda: np.zeros(0, ARC_DTYPE))
    status: Status = Status.NO_OBSERVATIONS
    t_gnss_gps_ns: int | None = None  # of the last epoch used
    doubts: int = 0  # epochs in a row in which most integers did not fit
    n_satellites: int = 0
    n_rows: int = 0  # single differences used
    nis: float = np.nan  # normalised innovation squared of the last epoch's differences
    degrees: int = 0
    t_fixed_gps_ns: int | None = None  # when the position last rested on integers
    pending: Pending | None = None  # integers that wait for confirmation
    t_checked_gps_ns: int = 0  # when the integers held were last compared with a search that knows nothing of them
    contradictions: int = 0  # such searches in a row that spoke against them


def without(p: Floats, arcs: Records, drop: Booleans) -> tuple[Floats, Records]:
    """Covariance and arcs without the ones marked; their states are marginalised."""
    if not drop.any():
        return p, arcs
    keep = np.concatenate([np.ones(15, np.bool_), ~drop[~arcs["held"]]])
    return np.ascontiguousarray(p[np.ix_(keep, keep)]), arcs[~drop]


@njit(cache=True)
def matched(known: Ints, key: Ints) -> Ints:
    """Index (m,) of each key among sorted ``known`` ones, −1 where it is not."""
    at = np.searchsorted(known, key)
    for i in range(key.size):
        if at[i] == known.size or known[at[i]] != key[i]:
            at[i] = -1
    return at


def ended(arcs: Records, epoch: TightEpoch) -> Booleans:
    """Arcs (k,) that are over: lock was lost, they are long gone, or they did not fit again and again."""
    over: Booleans = _ended(arcs, matched(arcs["key"], epoch.key), epoch.lost_lock, epoch.lock_time_s, epoch.t_gps_ns)
    return over


@njit(cache=True)
def _ended(arcs, at, lost_lock, lock_time_s, t_gps_ns):  # type: ignore[no-untyped-def]
    over = np.zeros(arcs.size, np.bool_)
    for k in range(arcs.size):
        over[k] = arcs[k].t_last_ns < t_gps_ns - MAX_GAP_NS or arcs[k].refused >= REFUSED_LIMIT
    for i in range(at.size):
        if at[i] >= 0:
            arc, now = arcs[at[i]], lock_time_s[i]
            since_s, then = (t_gps_ns - arc.t_last_ns) * 1e-9, arc.lock_time_s
            relocked = (now < then and now < since_s) or (now < 0.5 * then and now < then - 1.0)
            over[at[i]] |= lost_lock[i] or relocked
    return over


@njit(cache=True)
def noted(arcs, at, used, there, lock_time_s, t_gps_ns):  # type: ignore[no-untyped-def]
    """Write an epoch into the arcs, in place; returns the share of the held ones that were refused."""
    held, off = 0, 0
    for i in range(at.size):
        arc = arcs[at[i]]
        if used[i]:
            arc.count += 1
            arc.refused = 0
        elif there[i]:
            arc.refused += 1
        arc.t_last_ns = t_gps_ns
        arc.lock_time_s = lock_time_s[i]
        if arc.held:
            held += 1
            off += 0 if used[i] else 1
    return off / max(held, 1)


def begun(p: Floats, arcs: Records, epoch: TightEpoch, cycles: Floats) -> tuple[Floats, Records]:
    """Arcs and covariance with new arcs for the rows that have none.

    ``cycles`` (m,): each row's innovation in cycles, the receiver clock still in it. In a group where no arc is known,
    the highest row becomes the datum, held; the others become states at the whole cycles that the innovations say.
    """
    new = (matched(arcs["key"], epoch.key) < 0) & np.isfinite(cycles)
    if not new.any():
        return p, arcs
    rows = np.zeros(int(new.sum()), ARC_DTYPE)
    rows["key"], rows["group"], rows["integer"] = epoch.key[new], epoch.group[new], epoch.integer[new]
    rows["lock_time_s"], rows["t_last_ns"] = epoch.lock_time_s[new], epoch.t_gps_ns
    sine, whole = epoch.sine[new], np.round(cycles[new])
    rows["value"] = whole
    for group in np.unique(rows["group"]):
        members = np.flatnonzero(rows["group"] == group)
        known = _offset(arcs, epoch, cycles, int(group))
        if known is not None:
            rows["value"][members] = np.round(cycles[new][members] - known)
            continue
        fit = members[rows["integer"][members]]
        datum = (fit if fit.size else members)[np.argmax(sine[fit if fit.size else members])]
        rows["held"][datum] = True
    both = np.concatenate([arcs, rows])
    order = np.argsort(both["key"], kind="stable")
    grown = np.zeros((15 + int((~both["held"]).sum()),) * 2)
    sorted_arcs = both[order]
    states = np.flatnonzero(~sorted_arcs["held"])
    place = np.full(both.size, -1)
    place[states] = 15 + np.arange(states.size)
    inverse = np.empty(both.size, np.int64)
    inverse[order] = np.arange(both.size)
    old = np.concatenate([np.arange(15), place[inverse[np.flatnonzero(~arcs["held"])]]])
    grown[np.ix_(old, old)] = p
    fresh = place[inverse[arcs.size + np.flatnonzero(~rows["held"])]]
    grown[fresh, fresh] = FIRST_SIGMA_CYCLES**2
    return grown, sorted_arcs


def _offset(arcs: Records, epoch: TightEpoch, cycles: Floats, group: int) -> float | None:
    """Cycles of the receiver clock in a group, from the arcs already known; None where there are none at hand."""
    at = matched(arcs["key"], epoch.key)
    rows = (epoch.group == group) & (at >= 0) & np.isfinite(cycles)
    if not rows.any():
        return None
    return float(np.median(cycles[rows] - arcs["value"][at[rows]]))
