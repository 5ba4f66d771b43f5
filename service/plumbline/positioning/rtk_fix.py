"""Integers for the filter: which ambiguities are known, which can be resolved now, and when to let go.

The float filter never learns the integers. Held integers are values beside it: an epoch's fixed solution is the
filter's given those values. So a wrong set leaves no trace once it is let go, and a free search over the float
ambiguities can contradict it at any time. Held values belong to each other within a group (they are relative to the
group's datum); a group without held ones takes its highest satellite as the reference.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit

from plumbline.config import RtkSettings
from plumbline.estimation.ambiguity import resolve
from plumbline.positioning.rtk_filter import estimate
from plumbline.positioning.rtk_lasting import lasting_of_arcs
from plumbline.positioning.rtk_state import N_CORE, POSITION
from plumbline.positioning.state import Records
from plumbline.records import Booleans, Floats, Ints

_MIN_AMBIGUITIES: Final = 4  # double differences; fewer leave the position undetermined
_SINE_STEPS: Final = (0.0, 0.26, 0.42, 0.57)  # of 0°, 15°, 25°, 35°: where not all can be resolved, the higher ones
_FIXED_SIGMA_M: Final = 0.10  # three-dimensional: relations that leave more do not make a fixed position


@dataclass(frozen=True, slots=True)
class Fix:
    """What became of the integers at one epoch."""

    fixed: bool
    position_m: Floats  # (3,) from the filter's origin: fixed where it could be, else float
    covariance_m2: Floats  # (3, 3)
    float_position_m: Floats  # (3,)
    arcs: Records  # with what is held from now on
    n_ambiguities: int  # integers of this epoch, double differences
    n_fixed: int
    ratio: float  # of the last search, NaN where none was needed
    success_rate: float
    reason: str  # why not fixed


@njit(cache=True)
def _references(rows: Records, arcs: Records, sine: Floats, respect_held: bool) -> Booleans:
    """Arcs (k,) that are their group's datum: the highest, integers first, where the group holds none."""
    k = arcs.size
    group, chosen = np.full(k, -1, np.int64), np.zeros(k, np.bool_)
    for row in rows:
        if row.arc >= 0:
            group[row.arc] = row.group
    for g in range(group.max() + 1 if k > 0 else 0):
        best, value, held = -1, -1.0, False
        for i in range(k):
            if group[i] == g:
                held = held or (arcs[i].held and respect_held)
                rank = sine[i] + (2.0 if arcs[i].integer else 0.0)
                if rank > value:
                    best, value = i, rank
        if best >= 0 and not held:
            chosen[best] = True
    return chosen


def references_of(rows: Records, arcs: Records, sine: Floats, respect_held: bool = False) -> Booleans:
    """Arcs (k,) to take as their groups' datum (ambiguity zero); ``respect_held``: of groups that hold none."""
    return _references(rows, arcs, sine, respect_held)  # type: ignore[no-any-return]


@njit(cache=True)
def sines_of_arcs(rows: Records, n_arcs: int) -> Floats:
    """Sine of the elevation of each arc's satellite, (k,)."""
    sine = np.zeros(n_arcs)
    for row in rows:
        if row.arc >= 0:
            sine[row.arc] = row.sine
    return sine


@dataclass(frozen=True, slots=True)
class _Search:
    """Outcome of an integer search over some arcs."""

    accepted: bool
    complete: bool
    values: Floats  # (k,) of the arcs, meaningful where `known`
    known: Booleans  # (k,)
    x: Floats  # position given what was resolved
    covariance: Floats
    ratio: float
    success_rate: float
    n_fixed: int
    reason: str


def _given(information: Floats, right: Floats, known: Booleans, values: Floats) -> tuple[Floats, Floats, bool]:
    full = np.concatenate([np.zeros(N_CORE, np.bool_), known])
    return estimate(information, right, full, np.concatenate([np.zeros(N_CORE), values]))  # type: ignore[no-any-return]


def _search(
    information: Floats, right: Floats, known: Booleans, values: Floats, wanted: Booleans, sine: Floats,
    lasting: Floats, settings: RtkSettings, partial: bool,
) -> _Search:  # fmt: skip
    """Resolve the ``wanted`` arcs given the ``known`` ones: all, else the higher ones, else what relations can be."""
    x, q, regular = _given(information, right, known, values)
    start = x[POSITION], q[POSITION, POSITION]
    if not regular:
        return _Search(False, False, values, known, *start, np.nan, 0.0, 0, "too few satellites for a float solution")
    ratio, rate, reason = np.nan, 0.0, ""
    for step in _SINE_STEPS if partial else (0.0,):
        chosen = np.flatnonzero(wanted & ~known & (sine >= step))
        if chosen.size < _MIN_AMBIGUITIES and not (known.any() and chosen.size and step == 0.0):
            break
        at = N_CORE + chosen
        q_aa = q[np.ix_(at, at)] + lasting[np.ix_(chosen, chosen)]
        found = resolve(x[at], q_aa, settings.min_ratio, settings.min_success_rate, partial=False)
        if step == 0.0:
            ratio, rate, reason = found.ratio, found.success_rate, found.reason
        if found.accepted:
            now, new_values = known.copy(), values.copy()
            now[chosen], new_values[chosen] = True, found.integers
            y, c, _ = _given(information, right, now, new_values)
            complete = bool(step == 0.0)
            return _Search(True, complete, new_values, now, y[POSITION], c[POSITION, POSITION], found.ratio,
                           found.success_rate, int(chosen.size), "")  # fmt: skip
    if partial:
        relations = _relations(x, q, np.flatnonzero(wanted & ~known), lasting, settings)
        if relations is not None:
            position, covariance, found_ratio, found_rate, n = relations
            return _Search(True, False, values, known, position, covariance, found_ratio, found_rate, n, "")
    return _Search(False, False, values, known, *start, ratio, rate, 0, reason or "too few ambiguities to resolve")


_Resolved = tuple[Floats, Floats, float, float, int]


def _relations(x: Floats, q: Floats, chosen: Ints, lasting: Floats, settings: RtkSettings) -> _Resolved | None:
    """Position given the integer relations that can be resolved, or None where they do not determine it."""
    if chosen.size < _MIN_AMBIGUITIES:
        return None
    at = N_CORE + chosen
    q_aa = q[np.ix_(at, at)] + lasting[np.ix_(chosen, chosen)]
    found = resolve(x[at], q_aa, settings.min_ratio, settings.min_success_rate, partial=True)
    if not found.accepted:
        return None
    z = found.transform.astype(np.float64)
    q_bz = q[POSITION][:, at] @ z.T
    gain = np.linalg.solve(z @ q_aa @ z.T, q_bz.T).T
    position = x[POSITION] - gain @ (z @ x[at] - found.integers)
    covariance = q[POSITION, POSITION] - gain @ q_bz.T
    if np.trace(covariance) > _FIXED_SIGMA_M**2:
        return None
    return position, covariance, found.ratio, found.success_rate, int(found.integers.size)


def fix(
    information: Floats, right: Floats, rows: Records, arcs: Records, settings: RtkSettings, verify: bool
) -> tuple[Fix, bool]:
    """The epoch's solution with integers where they can be known; last item: a free search contradicts what was held.

    ``verify`` asks for that free search.
    """
    sine, lasting = sines_of_arcs(rows, arcs.size), lasting_of_arcs(rows, arcs.size)
    arcs = arcs.copy()
    contradicted = False
    if arcs["held"].any() and verify and settings.integers != "off":
        contradicted = _contradicts(information, right, rows, arcs, sine, lasting, settings)
        if contradicted:
            arcs["held"] = False
    references = _references(rows, arcs, sine, True)
    free_references = _references(rows, arcs, sine, False)
    known = arcs["held"] | references
    values = np.where(arcs["held"], arcs["value"], 0).astype(np.float64)
    n = int(np.count_nonzero(arcs["integer"] & ~free_references))
    x, q, regular = _given(information, right, known, values)
    held = arcs["held"].any()
    base = (x[POSITION], q[POSITION, POSITION])
    wanted = arcs["integer"] & ~known
    if not regular or settings.integers == "off":
        why = "integers are not wanted" if regular else "too few satellites for a position"
        sigma = base[1] if regular else np.full((3, 3), np.inf)
        return Fix(False, base[0], sigma, base[0], arcs, n, 0, np.nan, 0.0, why), contradicted
    n_held = int(np.count_nonzero(arcs["held"])) - _groups_held(rows, arcs)
    if held and not wanted.any():
        ok = bool(np.trace(base[1]) < _FIXED_SIGMA_M**2)
        return Fix(
            ok, *base, base[0], arcs, n, n_held, np.nan, 1.0, "" if ok else "too few integers held"
        ), contradicted
    found = _search(information, right, known, values, wanted, sine, lasting, settings, settings.partial)
    if found.accepted:
        new = found.known & arcs["integer"] & _with_company(rows, found.known & arcs["integer"])
        arcs["value"] = np.where(new, found.values, arcs["value"]).astype(np.int64)
        arcs["held"] = new
        covariance = found.covariance
    else:
        covariance = base[1]
    position = found.x if found.accepted else base[0]
    ok = bool((found.accepted or n_held >= _MIN_AMBIGUITIES - 1) and np.trace(covariance) < _FIXED_SIGMA_M**2)
    return Fix(ok, position, covariance, base[0], arcs, n, n_held + found.n_fixed, found.ratio, found.success_rate,
               "" if ok else found.reason), contradicted  # fmt: skip


@njit(cache=True)
def _groups_held(rows: Records, arcs: Records) -> int:
    """How many groups hold integers."""
    seen = np.zeros(rows.size, np.bool_)
    for row in rows:
        if row.arc >= 0 and arcs[row.arc].held:
            seen[row.group] = True
    return int(np.sum(seen))


def _with_company(rows: Records, held: Booleans) -> Booleans:
    """Arcs of groups in which at least two are held: one alone says nothing."""
    with_arc = rows[rows["arc"] >= 0]
    count = np.bincount(with_arc["group"], weights=held[with_arc["arc"]])
    company = np.zeros(held.size, np.bool_)
    company[with_arc["arc"]] = count[with_arc["group"]] >= 2
    return company


def _contradicts(
    information: Floats, right: Floats, rows: Records, arcs: Records, sine: Floats, lasting: Floats,
    settings: RtkSettings,
) -> bool:  # fmt: skip
    """Whether a search that knows nothing of the integers held finds others, and is sure of them."""
    references = _references(rows, arcs, sine, False)
    wanted = arcs["integer"] & ~references
    none = np.zeros(arcs.size)
    found = _search(information, right, references, none, wanted, sine, lasting, settings, partial=False)
    if not found.accepted:
        return False
    with_arc = rows[rows["arc"] >= 0]
    for g in np.unique(with_arc["group"]):
        members = with_arc["arc"][with_arc["group"] == g]
        both = members[found.known[members] & arcs["held"][members]]
        difference = found.values[both] - arcs["value"][both]
        if both.size and np.any(difference != difference[0]):
            return True
    return False
