"""What phases and codes have changed by between two epochs, tested against the motion that most of them agree on.

Multipath and atmosphere change little from one second to the next, so that changes tell errors of centimetres in phases
and of decimetres in codes, many times smaller than those that an epoch by itself tells. How much they usually change is
learnt, of all phases together and of each code, and the tests are held against that: receivers smooth their codes more
or less, and a second is not half a minute.

An error of a phase is an outlier or a slip, and no single epoch tells which: it is left out until the next one does.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plumbline.positioning.rtk_control import Adjusted, test_rows, usual_size
from plumbline.positioning.state import Records
from plumbline.records import Floats, Ints, Verdict

_ACCEPTED, _OUTLIER, _SLIP = int(Verdict.ACCEPTED), int(Verdict.OUTLIER), int(Verdict.SLIP)
_UNDECIDED, _INSEPARABLE = int(Verdict.UNDECIDED), int(Verdict.INSEPARABLE)
_PHASE_FLOOR_M: Final = 0.004  # sigma of a change: multipath moves slowly, but moves
_WANDER_M_S: Final = 0.0005  # and further with time
_CODE_FLOOR_M: Final = 0.1
_LEAST_SIZE, _MOST_SIZE = 0.1, 3.0
_LEAST_IN_GROUP: Final = 3
_ALIKE_SIGMAS: Final = 5.0  # two misfits that differ by less are one slip
_POOLED: Final = 8.0  # changes of a code that the usual size of all codes counts for
_MEMORY: Final = 50  # changes
_LARGEST_SQUARE: Final = 12.0  # that a change counts for at most, in its expected variance


@dataclass(frozen=True, slots=True)
class ChangeTest:
    """How the changes of an epoch are tested."""

    critical: float  # χ² value of the w-tests, infinite: nothing is left out
    critical_move: float  # of a motion of an antenna that is thought to stand
    phase_size: float  # how large phases' changes usually are, in units of their nominal sigma
    code_size: float  # the same of codes'
    standstill_m2: float  # variance of the motion of an antenna that is thought to stand; 0: it may be anywhere


NO_CHANGE_TEST: Final = ChangeTest(np.inf, np.inf, 1.0, 1.0, 0.0)


class Verdicts(NamedTuple):
    """What the changes of one kind say of each row, (n,)."""

    verdict: NDArray[np.int8]
    w: Floats  # 0 where there was nothing to compare with
    error_m: Floats  # how far each is from where its change should have brought it
    square: Floats  # mean square of a code's changes from now on, NaN where there was none
    usual: float  # how large this epoch's changes are, in nominal sigmas; NaN: too few
    taken_back: int


@njit(cache=True)
def no_verdicts(n: int) -> Verdicts:
    """Nothing is said against any row."""
    nothing = np.zeros(n)
    return Verdicts(np.zeros(n, np.int8), nothing, nothing, np.full(n, np.nan), np.nan, 0)


@njit(cache=True)
def _clocks(group, w, n_groups):  # type: ignore[no-untyped-def]
    """Number of the clock whose change each row shares, (n,), in place of its group's.

    Receiver clocks change for all signals alike, so that groups too small to check their rows by themselves can take
    part in the largest's; hardware delays, which keep groups apart, change slowly.
    """
    count = np.zeros(n_groups, np.int64)
    for i in range(w.size):
        if w[i] > 0.0:
            count[group[i]] += 1
    largest = np.argmax(count)
    for i in range(w.size):
        if count[group[i]] < _LEAST_IN_GROUP:
            group[i] = largest


def _prior(standstill_m2: float) -> Floats:
    return np.eye(3) / standstill_m2 if standstill_m2 > 0.0 else np.zeros((3, 3))


def test_phases(
    rows: Records, arcs: Records, previous: Ints, dt_s: float, n_groups: int, test: ChangeTest, limit: int
) -> tuple[Adjusted, Verdicts]:  # fmt: skip
    """Changes of phases that carry on old arcs ``previous`` (n,), −1: none; ``limit`` epochs off make a slip."""
    size = min(max(test.phase_size, _LEAST_SIZE), _MOST_SIZE)
    return _phases(  # type: ignore[no-any-return]
        rows, arcs, previous, dt_s, n_groups, test.critical, test.critical_move, size, _prior(test.standstill_m2), limit
    )


@njit(cache=True)
def _phases(rows, arcs, previous, dt_s, n_groups, critical, critical_move, size, prior, limit):  # type: ignore[no-untyped-def]
    n = rows.size
    v, w, nominal = np.zeros(n), np.zeros(n), np.zeros(n)
    line, group = np.zeros((n, 3)), np.zeros(n, np.int64)
    least = _PHASE_FLOOR_M**2 + (_WANDER_M_S * dt_s) ** 2
    for i in range(n):
        row = rows[i]
        group[i], line[i] = row.group, row.line
        if previous[i] >= 0:
            v[i] = row.phase_oc_m - arcs[previous[i]].residual_m
            nominal[i] = np.sqrt(2.0 / row.phase_weight)
            w[i] = 1.0 / max((size * nominal[i]) ** 2, least)
    _clocks(group, w, n_groups)
    found = test_rows(line, v, w, group, n_groups, critical, critical_move, max(n // 3, 1), prior)
    verdict, sizes = np.zeros(n, np.int8), np.zeros(n)
    for i in range(n):
        if w[i] == 0.0:
            continue
        sizes[i] = found.w[i] / (nominal[i] * np.sqrt(w[i]))
        if found.use[i]:
            continue
        arc = arcs[previous[i]]
        alike = arc.off > 0 and abs(found.residual_m[i] - arc.off_m) < _ALIKE_SIGMAS * found.sigma_error_m[i]
        if found.inseparable[i]:
            verdict[i] = _INSEPARABLE
        elif alike or arc.off + 1 >= limit:
            verdict[i] = _SLIP
        else:
            verdict[i] = _UNDECIDED
    usual = usual_size(sizes, (w > 0.0) & found.use)
    return found, Verdicts(verdict, found.w, found.residual_m, np.full(n, np.nan), usual, found.taken_back)


def test_codes(
    rows: Records, arcs: Records, same: Ints, motion: tuple[Floats, Floats], n_groups: int, test: ChangeTest, limit: int
) -> Verdicts:
    """Changes of codes since the epoch before, given the motion that the phases tell."""
    prior = np.linalg.inv(motion[1] + 1e-8 * np.eye(3))
    size = min(max(test.code_size, _LEAST_SIZE), _MOST_SIZE)
    return _codes(rows, arcs, same, motion[0], prior, n_groups, test.critical, size, limit)  # type: ignore[no-any-return]


@njit(cache=True)
def _codes(rows, arcs, same, b, prior, n_groups, critical, size, limit):  # type: ignore[no-untyped-def]
    n = rows.size
    v, w, nominal = np.zeros(n), np.zeros(n), np.zeros(n)
    line, group, square = np.zeros((n, 3)), np.zeros(n, np.int64), np.full(n, np.nan)
    for i in range(n):
        row = rows[i]
        group[i], line[i] = row.group, row.line
        if same[i] < 0 or row.code_weight == 0.0 or np.isnan(arcs[same[i]].code_residual_m):
            continue
        arc = arcs[same[i]]
        v[i] = row.code_oc_m - arc.code_residual_m + line[i, 0] * b[0] + line[i, 1] * b[1] + line[i, 2] * b[2]
        nominal[i] = np.sqrt(2.0 / row.code_weight)
        count = min(arc.code_count, _MEMORY)
        square[i] = (_POOLED * size**2 + count * arc.code_square) / (_POOLED + count)
        w[i] = 1.0 / max(square[i] * nominal[i] ** 2, _CODE_FLOOR_M**2)
    _clocks(group, w, n_groups)
    found = test_rows(line, v, w, group, n_groups, critical, np.inf, max(n // 3, 1), prior)
    verdict, sizes = np.zeros(n, np.int8), np.zeros(n)
    for i in range(n):
        if w[i] == 0.0:
            continue
        relative = found.w[i] / np.sqrt(w[i])  # the change in metres, at the variance of one that nothing correlates
        sizes[i] = relative / nominal[i]
        arc = arcs[same[i]]
        now = min(sizes[i] ** 2, _LARGEST_SQUARE * square[i])
        count = min(arc.code_count, _MEMORY)
        square[i] = arc.code_square + (now - arc.code_square) / (count + 1)
        if found.use[i]:
            continue
        if arc.code_off + 1 >= limit:
            verdict[i] = _SLIP  # it stays elsewhere: its new level is believed
        else:
            verdict[i] = _INSEPARABLE if found.inseparable[i] else _OUTLIER
    usual = usual_size(sizes, (w > 0.0) & found.use)
    return Verdicts(verdict, found.w, found.residual_m, square, usual, found.taken_back)
