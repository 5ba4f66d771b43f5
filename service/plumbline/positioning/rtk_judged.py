"""What all tests of an epoch say of each row's code and phase: which are used, and why the others are not."""

from dataclasses import dataclass, field
from typing import Final, Self

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plumbline.positioning.rtk_arcs import Tracked
from plumbline.positioning.rtk_control import Adjusted, Limits, test_rows
from plumbline.positioning.state import Records
from plumbline.records import Booleans, Floats, Verdict

_ACCEPTED, _SLIP = int(Verdict.ACCEPTED), int(Verdict.SLIP)
_DOUBTFUL_VARIANCE: Final = 9.0  # of the held phases' residuals, in units of their own


@dataclass(slots=True)
class Judged:
    """Verdicts of one epoch's rows, (n,) each."""

    code: NDArray[np.int8]
    phase: NDArray[np.int8]
    w_code: Floats  # of the test that left it out; 0 where none did
    w_phase: Floats
    use_code: Booleans
    use_phase: Booleans
    slips: int
    taken_back: int
    motion_m: Floats | None = None  # (3,) of an antenna that was thought to stand
    contradiction: bool = False
    held_doubted: bool = False
    squares: float = 0.0  # of the adjustments of codes and of held phases, of what is used: χ² of …
    degrees_of_freedom: float = 0.0
    slipped: NDArray[np.int16] = field(default_factory=lambda: np.zeros(0, np.int16))  # satellites

    @classmethod
    def of(cls, rows: Records, tracked: Tracked, codes: Adjusted) -> Self:
        """From the codes' own adjustment and the changes since the epoch before."""
        use_code = codes.use
        phase, code = tracked.phases.verdict, tracked.codes.verdict.copy()
        code[code == _SLIP] = _ACCEPTED  # believed at its new level
        code[(code == _ACCEPTED) & ~use_code & (rows["code_weight"] > 0.0)] = int(Verdict.OUTLIER)
        slipped = phase == _SLIP
        phase = np.where(slipped, _ACCEPTED, phase).astype(np.int8)  # with its new ambiguity
        return cls(
            code=code, phase=phase,
            w_code=np.where(code != _ACCEPTED, np.where(use_code, tracked.codes.w, codes.w), 0.0),
            w_phase=np.where(phase != _ACCEPTED, tracked.phases.w, 0.0),
            use_code=(code == _ACCEPTED) & (rows["code_weight"] > 0.0),
            use_phase=(phase == _ACCEPTED) & (rows["arc"] >= 0),
            slips=int(np.count_nonzero(slipped)), taken_back=tracked.phases.taken_back + tracked.codes.taken_back
            + codes.taken_back,
            motion_m=tracked.motion[0] if tracked.motion is not None and tracked.moved else None,
            contradiction=tracked.contradiction, squares=codes.squares, degrees_of_freedom=codes.degrees_of_freedom,
            slipped=rows["satellite"][slipped],
        )  # fmt: skip

    @property
    def columns(self) -> tuple[Booleans, NDArray[np.int8], Floats]:
        """Use, verdict and w of the test that left one out (else 0), of codes and phases, (2, n) each."""
        shape = (2, self.code.size)
        use, verdict, w = np.empty(shape, np.bool_), np.empty(shape, np.int8), np.empty(shape)
        use[0], use[1], verdict[0], verdict[1] = self.use_code, self.use_phase, self.code, self.phase
        w[0], w[1] = self.w_code, self.w_phase
        return use, verdict, w

    @property
    def left_out(self) -> int:
        """Observations that failed a test."""
        return int(np.count_nonzero(self.code) + np.count_nonzero(self.phase))

    @property
    def squares_left_out(self) -> float:
        """What they had added to the sum of squares, as far as they do not share it."""
        return float(self.w_code @ self.w_code + self.w_phase @ self.w_phase)

    def test_held(self, rows: Records, arcs: Records, n_groups: int, limits: Limits) -> bool:
        """Test the phases of held integers against each other; whether they contradict each other altogether.

        Refusals are counted in the arcs.
        """
        if not arcs["held"].any():
            return False
        found, tested = _held(rows, arcs, self.use_phase, n_groups, limits.row)
        if not found.regular or found.degrees_of_freedom < 1.0:
            return False
        bad = tested & ~found.use
        arcs["refused"][rows["arc"][tested & found.use]] = 0
        arcs["refused"][rows["arc"][bad]] += 1
        self.phase[bad] = np.where(found.inseparable[bad], int(Verdict.INSEPARABLE), int(Verdict.UNDECIDED))
        self.w_phase[bad] = found.w[bad]
        self.use_phase &= ~bad
        self.taken_back += int(found.taken_back)
        self.squares += float(found.squares)
        self.degrees_of_freedom += float(found.degrees_of_freedom)
        many = 4 * np.count_nonzero(bad) > np.count_nonzero(tested)
        self.held_doubted = bool(many or found.squares > found.degrees_of_freedom * _DOUBTFUL_VARIANCE)
        return self.held_doubted


@njit(cache=True)
def _held(rows, arcs, use_phase, n_groups, critical):  # type: ignore[no-untyped-def]
    """The phases of held integers, adjusted and tested; and which of the rows they are."""
    n = rows.size
    v, w, line, group = np.zeros(n), np.zeros(n), np.zeros((n, 3)), np.zeros(n, np.int64)
    for i in range(n):
        row = rows[i]
        group[i], line[i] = row.group, row.line
        if use_phase[i] and arcs[row.arc].held:
            v[i] = row.phase_oc_m - row.wavelength_m * (arcs[row.arc].offset_cycles + arcs[row.arc].value)
            w[i] = row.phase_weight
    found = test_rows(line, v, w, group, n_groups, critical, np.inf, max(n // 3, 1), np.zeros((3, 3)))
    return found, w > 0.0
