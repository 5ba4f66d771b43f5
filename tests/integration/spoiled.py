"""Outliers and cycle slips put into real or simulated epochs, by a seed: Lee 2016's experiment, harder.

A plan names epochs, satellites, kinds and sizes; an editor puts them into the raw observations of the receiver. An
outlier is in the first frequency's observations, in the second's, or alike in both.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.positioning.preprocess import SIGNAL_BAND
from plumbline.records import Epoch
from plumbline.signals import FREQUENCY_HZ

Observed = tuple[int, bool]  # satellite, whether its phase
BOTH, FIRST, SECOND = range(3)


@dataclass(frozen=True)
class Outlier:
    """An error of one observation at one epoch."""

    satellite: int
    is_phase: bool
    size_m: float
    where: int  # BOTH, FIRST, SECOND


def plan_outliers(observed: dict[int, Sequence[Observed]], seed: int, n: int = 110) -> dict[int, list[Outlier]]:
    """``n`` outliers by epoch, alone and in groups of up to three: codes 3-30 m, phases 0.05-2 m, either sign.

    ``observed``: epoch → observations that it uses.
    """
    rng, made = np.random.default_rng(seed), 0
    plan: dict[int, list[Outlier]] = {}
    for k in rng.permutation(sorted(observed)):
        group = min(int(rng.integers(1, 4)), n - made)
        for j in rng.choice(len(observed[int(k)]), group, replace=False):
            satellite, is_phase = observed[int(k)][int(j)]
            size_m = rng.uniform(0.05, 2.0) if is_phase else rng.uniform(3.0, 30.0)
            outlier = Outlier(satellite, is_phase, size_m * rng.choice([-1.0, 1.0]), int(rng.integers(0, 3)))
            plan.setdefault(int(k), []).append(outlier)
        made += group
        if made >= n:
            break
    return plan


def with_outliers(epoch: Epoch, outliers: Sequence[Outlier]) -> Epoch:
    """The epoch with its outliers."""
    code, phase = epoch.pseudorange_m.copy(), epoch.carrier_phase_cycles.copy()
    for outlier in outliers:
        rows = _rows(epoch, outlier.satellite, outlier.where)
        if outlier.is_phase:
            phase[rows] += outlier.size_m * FREQUENCY_HZ[epoch.signal[rows]] / SPEED_OF_LIGHT_M_S
        else:
            code[rows] += outlier.size_m
    return replace(epoch, pseudorange_m=code, carrier_phase_cycles=phase)


def _rows(epoch: Epoch, satellite: int, where: int) -> np.ndarray:
    rows = np.flatnonzero(epoch.satellite == satellite)
    first = SIGNAL_BAND[epoch.signal[rows]] <= 2
    first &= SIGNAL_BAND[epoch.signal[rows]] == SIGNAL_BAND[epoch.signal[rows]].min(initial=9)
    return rows if where == BOTH else rows[first] if where == FIRST else rows[~first]


@dataclass(frozen=True)
class Slip:
    """One cycle on one frequency or both, from an epoch on."""

    satellite: int
    sign: int
    where: int


def plan_slips(ages: dict[int, dict[int, int]], seed: int, n: int) -> dict[int, list[Slip]]:
    """``n`` slips by epoch. ``ages``: epoch → satellite → epochs since its phase began; slips of a satellite are ten
    epochs apart and not within five of its beginning.
    """
    rng = np.random.default_rng(seed)
    candidates = [(k, s) for k, found in sorted(ages.items()) for s, age in sorted(found.items()) if age > 5]
    plan: dict[int, list[Slip]] = {}
    taken: dict[int, list[int]] = {}
    for j in rng.permutation(len(candidates)):
        k, satellite = candidates[j]
        if sum(map(len, plan.values())) >= n:
            break
        if all(abs(k - other) >= 10 for other in taken.get(satellite, [])):
            taken.setdefault(satellite, []).append(k)
            slip = Slip(satellite, int(rng.choice([-1, 1])), int(rng.integers(0, 3)))
            plan.setdefault(k, []).append(slip)
    return plan


class SlipEditor:
    """Puts slips into epochs in their order; they stay."""

    def __init__(self, plan: dict[int, list[Slip]]) -> None:
        self._plan = plan
        self._so_far: list[Slip] = []

    def __call__(self, k: int, epoch: Epoch) -> Epoch:
        """Epoch number ``k``."""
        self._so_far += self._plan.get(k, [])
        phase = epoch.carrier_phase_cycles.copy()
        for slip in self._so_far:
            phase[_rows(epoch, slip.satellite, slip.where)] += slip.sign
        return replace(epoch, carrier_phase_cycles=phase)
