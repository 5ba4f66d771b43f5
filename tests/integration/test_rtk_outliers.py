"""Quality control against a base, on recorded receivers: outliers, slips, motions put into the rover's observations.

Oracle: what was put in, and the run without it.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.positioning.rtk import RtkDiagnostics
from plumbline.positioning.solutions import rotation_at
from plumbline.records import Epoch, Floats, Solution, Status
from plumbline.signals import FREQUENCY_HZ

from .relative_recordings import SC134, STR, Bench, Recording, displaced, replace

pytestmark = pytest.mark.realdata
Key = tuple[int, int, int, bool]  # epoch, satellite, signal, whether its phase
Ran = list[tuple[Solution, RtkDiagnostics | None]]
EPOCHS, WARM = 400, 10
OUTLIERS, SLIPS = 110, 60


@dataclass(frozen=True)
class Clean:
    """A recording, the run over it, and the observations that this uses."""

    bench: Bench
    ran: Ran
    used: list[Key]


@pytest.fixture(scope="module", params=[STR, SC134], ids=lambda recording: recording.folder)
def clean(request: pytest.FixtureRequest, data_dir: Path) -> Clean:
    return _clean(data_dir, request.param, 0, EPOCHS)


def _clean(data_dir: Path, recording: Recording, first: int, last: int) -> Clean:
    bench = Bench(data_dir, recording, first, last)
    ran = bench.run()
    return Clean(bench, ran, [key for key in _rows(ran, rejected=False) if key[0] >= WARM])


def _rows(ran: Ran, *, rejected: bool) -> list[Key]:
    """Observations that were left out, or that were used."""
    keys: list[Key] = []
    for k, (_, seen) in enumerate(ran):
        if seen is None:
            continue
        rows, judged = seen.rows, seen.judged
        for is_phase, verdict, use in ((False, judged.code, seen.use_code), (True, judged.phase, seen.use_phase)):
            at = np.flatnonzero(verdict if rejected else use)
            keys += [(k, int(rows["satellite"][i]), int(rows["signal"][i]), is_phase) for i in at]
    return keys


def _spoilt(epoch: Epoch, key: Key, size_m: float) -> Epoch:
    _, satellite, signal, is_phase = key
    row = (epoch.satellite == satellite) & (epoch.signal == signal)
    if is_phase:
        cycles = size_m * FREQUENCY_HZ[signal] / SPEED_OF_LIGHT_M_S
        return replace(epoch, carrier_phase_cycles=epoch.carrier_phase_cycles + np.where(row, cycles, 0.0))
    return replace(epoch, pseudorange_m=epoch.pseudorange_m + np.where(row, size_m, 0.0))


def _outliers(used: list[Key], rng: np.random.Generator) -> dict[Key, float]:
    """Alone and up to three at once: codes 3-30 m, phases 0.05-2 m, either sign."""
    by_epoch: dict[int, list[Key]] = {}
    for key in used:
        by_epoch.setdefault(key[0], []).append(key)
    plan: dict[Key, float] = {}
    for k in rng.permutation(sorted(by_epoch)):
        group = min(int(rng.integers(1, 4)), OUTLIERS - len(plan))
        for j in rng.choice(len(by_epoch[int(k)]), group, replace=False):
            key = by_epoch[int(k)][int(j)]
            plan[key] = (rng.uniform(0.05, 2.0) if key[3] else rng.uniform(3.0, 30.0)) * rng.choice([-1.0, 1.0])
        if len(plan) == OUTLIERS:
            break
    return plan


def _with_outliers(clean: Clean, plan: dict[Key, float]) -> Ran:
    def edit(k: int, epoch: Epoch) -> Epoch:
        for key, size_m in plan.items():
            epoch = _spoilt(epoch, key, size_m) if key[0] == k else epoch
        return epoch

    return clean.bench.run(edit)


def _away_m(ran: Ran, clean: Clean) -> Floats:
    """Distance of every fixed position from the undisturbed run's, (n,)."""
    both = [
        (a.position_ecef_m, b.position_ecef_m)
        for (a, _), (b, _) in zip(ran, clean.ran, strict=True)
        if a.status is Status.RTK_FIXED and b.status is Status.RTK_FIXED
    ]
    return np.array([np.linalg.norm(a - b) for a, b in both if a is not None and b is not None])


def _check_outliers(clean: Clean, seeds: range) -> None:
    found = false = good = planned = 0
    for seed in seeds:
        plan = _outliers(clean.used, np.random.default_rng(seed))
        ran = _with_outliers(clean, plan)
        rejected = set(_rows(ran, rejected=True))
        planned, found = planned + len(plan), found + len(plan.keys() & rejected)
        false += len(rejected - plan.keys())
        good += len(_rows(ran, rejected=False))
        away_m = _away_m(ran, clean)
        assert away_m.max() < 0.02  # no wrong integer: half a cycle is nine centimetres
        assert len(away_m) >= 0.995 * len(clean.ran)
    print(f"outliers: {found} of {planned} found, {false} of {good} good ones left out")
    assert found >= 0.99 * planned, (found, planned)
    assert false < 0.001 * good, (false, good)


def test_outliers_are_found_and_attributed_and_cause_no_wrong_fix(clean: Clean) -> None:
    _check_outliers(clean, range(2))


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("recording", [STR, SC134], ids=lambda recording: recording.folder)
def test_outliers_of_many_seeds_in_the_whole_recordings(data_dir: Path, recording: Recording) -> None:
    _check_outliers(_clean(data_dir, recording, 0, 10_000), range(100, 105))


def _plan_slips(clean: Clean, rng: np.random.Generator) -> dict[Key, int]:
    """One cycle of one frequency's phase, from an epoch on; of one satellite ten epochs apart, the last five free."""
    candidates = [key for key in clean.used if key[3] and key[0] < len(clean.ran) - 5]
    plan: dict[Key, int] = {}
    for j in rng.permutation(len(candidates)):
        k, satellite, _, _ = key = candidates[j]
        if all(other[1] != satellite or abs(other[0] - k) >= 10 for other in plan):
            plan[key] = int(rng.choice([-1, 1]))
        if len(plan) == SLIPS:
            break
    return plan


@pytest.mark.parametrize("both", [False, True], ids=["one frequency", "both frequencies"])
def test_slips_of_one_cycle_are_found_and_resolved_anew(clean: Clean, both: bool) -> None:
    plan = _plan_slips(clean, np.random.default_rng(7))

    def edit(k: int, epoch: Epoch) -> Epoch:
        phase = epoch.carrier_phase_cycles.copy()
        for (since, satellite, signal, _), sign in plan.items():
            if since <= k:
                phase[(epoch.satellite == satellite) & (both | (epoch.signal == signal))] += sign
        return replace(epoch, carrier_phase_cycles=phase)

    ran = clean.bench.run(edit)
    found = sum(
        seen is not None and satellite in seen.judged.slipped
        for (k, satellite, _, _) in plan
        for _, seen in [ran[k + 1]]
    )  # fmt: skip
    slips = sum(len(set(seen.judged.slipped.tolist())) for _, seen in ran if seen is not None)
    undisturbed = sum(len(set(seen.judged.slipped.tolist())) for _, seen in clean.ran if seen is not None)
    assert found >= 0.99 * len(plan), (found, len(plan))
    assert slips <= len(plan) + undisturbed + 1
    assert undisturbed * 3600.0 / len(clean.ran) < 10.0  # of a satellite; less than one a station-hour: see soak
    away_m = _away_m(ran, clean)
    assert away_m.max() < 0.02
    assert len(away_m) >= 0.995 * len(clean.ran)


@pytest.mark.parametrize("what", ["step", "vibration"])
def test_a_real_motion_goes_through_as_with_control_off(clean: Clean, what: str) -> None:
    """5 cm at once, and 19 mm at 0.5 Hz (as 1 Hz epochs see it, off its zero crossings)."""

    def motion_m(k: int) -> float:
        return 0.05 if what == "step" and k >= 200 else 0.019 * np.sin(np.pi * k + 1.2) if what != "step" else 0.0

    direction = np.array([0.6, -0.48, 0.64])
    series = []
    for control in ("on", "off"):
        settings = clean.bench.settings(quality_control=control)
        ran = clean.bench.run(lambda k, epoch: displaced(epoch, clean.bench, motion_m(k) * direction), settings)
        series.append(_displacements(ran))
    on, off = series
    assert np.isfinite(on).all()
    assert np.abs(on - off).max() < 0.001
    seen = (on - _displacements(clean.ran)) @ direction
    truth = np.array([motion_m(k) for k in range(len(seen))])
    scale = float(seen @ truth / (truth @ truth))
    assert scale == pytest.approx(1.0, abs=0.01)


def _displacements(ran: Ran) -> Floats:
    """East, north, up (n, 3) from the first epoch's position."""
    first = next(s.position_ecef_m for s, _ in ran if s.position_ecef_m is not None)
    places = [np.full(3, np.nan) if s.position_ecef_m is None else s.position_ecef_m for s, _ in ran]
    return (np.array(places) - first) @ rotation_at(first).T
