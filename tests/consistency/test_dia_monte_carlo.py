"""What the tests promise, counted: false alarms, the power at the MDB, what the protection levels bound.

Ten thousand epochs of a code and phase filter over a simulated sky, with normal errors of exactly the covariance that
the tests are told. The oracle is the truth that was drawn.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from plumbline.estimation import dia
from plumbline.estimation.dia_tables import Levels, alternative_critical, global_critical
from plumbline.estimation.kalman import update_sequential
from plumbline.quality.reliability import Integrity, factors, measures
from plumbline.records import Floats

LEVELS = Levels()
CRITICAL = alternative_critical(LEVELS)
TRIALS = 10_000


@dataclass(frozen=True)
class Epoch:
    """A filter's epoch before its update: 10 satellites, a code and a phase each."""

    h: Floats
    r: Floats
    p: Floats
    s: Floats
    root_p: Floats

    @property
    def m(self) -> int:
        return len(self.r)

    def draw(self, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Error of the predicted state (n,), and innovations (m,)."""
        error = self.root_p @ rng.normal(size=len(self.p))
        return error, -self.h @ error + np.sqrt(self.r) * rng.normal(size=self.m)


@pytest.fixture(scope="module")
def epoch() -> Epoch:
    rng = np.random.default_rng(21)
    n_satellites = 10
    azimuth = rng.uniform(0, 2 * np.pi, n_satellites)
    sine = rng.uniform(0.2, 1.0, n_satellites)
    cosine = np.sqrt(1 - sine**2)
    line = np.column_stack([cosine * np.sin(azimuth), cosine * np.cos(azimuth), sine])
    h = np.zeros((2 * n_satellites, 4 + n_satellites))
    h[:, :3], h[:, 3] = -np.repeat(line, 2, axis=0), 1.0
    h[1::2, 4:] = np.eye(n_satellites)
    r = np.column_stack([(0.5 / sine) ** 2, (0.005 / sine) ** 2]).ravel()
    before = np.diag(np.concatenate([np.full(3, 100.0), [900.0], np.full(n_satellites, 900.0)]))
    x = np.zeros(len(before))
    for _ in range(30):  # codes level the ambiguities, as half an hour would; position and clock are free each epoch
        update_sequential(x, before, h, r, np.zeros(len(r)), np.ones(len(r), bool))
        before[:3, :3] += 100.0 * np.eye(3)
        before[3, 3] += 900.0
    return Epoch(h, r, before, h @ before @ h.T + np.diag(r), np.linalg.cholesky(before))


def test_false_alarms_of_the_global_test_are_its_significance(epoch: Epoch) -> None:
    rng, alarms = np.random.default_rng(22), 0
    n = 4 * TRIALS  # 10 % of 5 % is 4.6 sigma of the count
    for _ in range(n):
        _, v = epoch.draw(rng)
        alarms += v @ np.linalg.solve(epoch.s, v) > global_critical(LEVELS, epoch.m)
    assert alarms / n == pytest.approx(LEVELS.significance, rel=0.10)


def test_a_bias_of_the_mdb_is_found_with_the_power_stated(epoch: Epoch) -> None:
    """Found: its w-test exceeds the critical value."""
    rng = np.random.default_rng(23)
    table, _ = dia.information(epoch.s, np.zeros(epoch.m), np.zeros((epoch.m, 0)))
    _, sigma_b = dia.w_values(table, np.zeros(epoch.m, bool))
    mdb = factors(LEVELS, Integrity()).root_noncentrality * sigma_b
    found = 0
    for trial in range(TRIALS):
        i = trial % epoch.m
        _, v = epoch.draw(rng)
        v[i] += mdb[i] * rng.choice([-1.0, 1.0])
        table, _ = dia.information(epoch.s, v, np.zeros((epoch.m, 0)))
        w, _ = dia.w_values(table, np.zeros(epoch.m, bool))
        found += abs(w[i]) > np.sqrt(CRITICAL[1])
    assert found / TRIALS == pytest.approx(LEVELS.power, abs=0.03)


def test_a_larger_error_is_attributed_to_its_own_observation(epoch: Epoch) -> None:
    rng, starts = np.random.default_rng(24), np.arange(epoch.m + 1)
    table, _ = dia.information(epoch.s, np.zeros(epoch.m), np.zeros((epoch.m, 0)))
    _, sigma_b = dia.w_values(table, np.zeros(epoch.m, bool))
    named, others, n = 0, 0, 3000
    for trial in range(n):
        i = trial % epoch.m
        _, v = epoch.draw(rng)
        v[i] += 8.0 * sigma_b[i]
        table, _ = dia.information(epoch.s, v, np.zeros((epoch.m, 0)))
        found = dia.identify(table, starts, np.ones(epoch.m, bool), np.full(epoch.m, CRITICAL[1]), 6)
        named += bool(found.adopted[i])
        others += int(found.adopted.sum()) - int(found.adopted[i])
    assert named / n > 0.99
    assert others / (n * epoch.m) < 2.0 * LEVELS.w_significance


@pytest.mark.parametrize("size_in_mdb", [0.0, 0.6, 1.0, 1.3, 2.0])
def test_protection_levels_bound_the_error_at_the_risk_stated(epoch: Epoch, size_in_mdb: float) -> None:
    """Position errors that quality control lets through; any size of one observation's error, also the worst ones.

    The risk is stated large enough to be counted: 1e-3 an epoch, faults in one of ten.
    """
    integrity = Integrity(risk=1e-3, prior=0.1)
    rng, starts = np.random.default_rng(25), np.arange(epoch.m + 1)
    allowed, factor = np.ones(epoch.m, bool), factors(LEVELS, integrity)
    beyond_h = beyond_v = 0
    for trial in range(TRIALS):
        error, v = epoch.draw(rng)
        i = trial % epoch.m
        table, _ = dia.information(epoch.s, v, np.zeros((epoch.m, 0)))
        _, sigma_b = dia.w_values(table, np.zeros(epoch.m, bool))
        v[i] += size_in_mdb * factor.root_noncentrality * sigma_b[i]
        table, _ = dia.information(epoch.s, v, np.zeros((epoch.m, 0)))
        found = dia.identify(table, starts, allowed, np.full(epoch.m, CRITICAL[1]), 6)
        used = ~found.adopted
        x, p = np.zeros(len(error)), epoch.p.copy()
        update_sequential(x, p, epoch.h, epoch.r, v, used)
        _, sigma_b = dia.w_values(found.swept, found.adopted)
        made = measures(sigma_b, epoch.r, used, epoch.h, epoch.r, p[:3].copy(), np.eye(3), factor)
        wrong = (x + error)[:3]
        beyond_h += np.hypot(wrong[0], wrong[1]) > made.protection_horizontal
        beyond_v += abs(wrong[2]) > made.protection_vertical
    bound = integrity.risk if size_in_mdb == 0.0 else integrity.risk / integrity.prior
    allowance = bound * TRIALS + 3.0 * np.sqrt(bound * TRIALS)
    assert beyond_h <= allowance
    assert beyond_v <= allowance


def test_undetected_errors_stay_within_the_external_reliability(epoch: Epoch) -> None:
    """An error of the MDB moves the mean position by the external reliability, no more (eq. 56)."""
    rng, factor = np.random.default_rng(26), factors(LEVELS, Integrity())
    table, _ = dia.information(epoch.s, np.zeros(epoch.m), np.zeros((epoch.m, 0)))
    _, sigma_b = dia.w_values(table, np.zeros(epoch.m, bool))
    all_used = np.ones(epoch.m, bool)
    for i in (1, 4, 7):
        moved = np.zeros(3)
        for _ in range(400):
            error, v = epoch.draw(rng)
            x, p, y, q = np.zeros(len(error)), epoch.p.copy(), np.zeros(len(error)), epoch.p.copy()
            update_sequential(x, p, epoch.h, epoch.r, v, all_used)
            v[i] += factor.root_noncentrality * sigma_b[i]
            update_sequential(y, q, epoch.h, epoch.r, v, all_used)
            moved += (y - x)[:3] / 400
        made = measures(sigma_b, epoch.r, all_used, epoch.h, epoch.r, p[:3].copy(), np.eye(3), factor)
        np.testing.assert_allclose(moved, made.external[i], atol=1e-9)
