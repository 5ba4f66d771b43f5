"""Filters' epochs with normal errors of exactly the covariance that the tests are told, drawn as often as wanted.

Each world draws misclosures and the error that its state has, tests them with the code that stations run, and says what
that code promises: critical values, minimal detectable biases, external reliability, protection levels.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from plumbline.estimation import dia
from plumbline.estimation.dia_tables import Levels, alternative_critical, global_critical
from plumbline.estimation.kalman import update_sequential
from plumbline.estimation.least_squares import solve
from plumbline.positioning.rtk_control import test_rows as adjust_rows
from plumbline.quality.reliability import Factors, Integrity, factors, measures
from plumbline.records import Booleans, Floats

LEVELS = Levels()
CRITICAL = float(alternative_critical(LEVELS)[1])
MOST = 6  # errors adopted at once


class Promised(NamedTuple):
    """Of an epoch without errors."""

    mdb: Floats  # (m,)
    external: Floats  # (m, 3) what an error of the MDB does to the position
    degrees_of_freedom: int


class Tested(NamedTuple):
    """An epoch after detection, identification and adaptation."""

    statistic: float  # of the global test, before
    w: Floats  # (m,) before anything was left out
    adopted: Booleans  # (m,) left out
    position_error: Floats  # (3,) after
    protection_horizontal: float
    protection_vertical: float


class World(Protocol):
    """Where errors come from."""

    name: str
    m: int

    def draw(self, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Error of the predicted state, and misclosures (m,)."""

    def promised(self) -> Promised:
        """What the tests promise."""

    def tested(self, error: Floats, v: Floats, factor: Factors, *, identify: bool = True) -> Tested:
        """The tests, and the position's error after them; without ``identify`` all are used."""


def sky(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Lines to satellites (n, 3), east, north, up, and the sines of their elevations (n,)."""
    azimuth, sine = rng.uniform(0, 2 * np.pi, n), rng.uniform(0.2, 1.0, n)
    cosine = np.sqrt(1 - sine**2)
    return np.column_stack([cosine * np.sin(azimuth), cosine * np.cos(azimuth), sine]), sine


def _identified(table: Floats, m: int, identify: bool) -> dia.Findings:
    return dia.identify(table, np.arange(m + 1), np.full(m, identify), np.full(m, CRITICAL), MOST)


class SinglePoint:
    """Codes of one epoch by least squares: position and clock are unknown."""

    name = "single point"

    def __init__(self, n_satellites: int = 12) -> None:
        line, sine = sky(np.random.default_rng(31), n_satellites)
        self.h = np.column_stack([-line, np.ones(n_satellites)])
        self.sigma, self.m = 0.8 / sine, n_satellites

    def draw(self, rng: np.random.Generator) -> tuple[Floats, Floats]:
        return np.zeros(4), self.sigma * rng.normal(size=self.m)

    def promised(self) -> Promised:
        made = self._measures(np.zeros(self.m), np.zeros(self.m, bool), factors(LEVELS, Integrity()))
        return Promised(made.mdb, made.external, self.m - 4)

    def _measures(self, v: Floats, adopted: Booleans, factor: Factors):  # type: ignore[no-untyped-def]
        table, _ = dia.residual_information(self.h, v, self.sigma)
        for k in np.flatnonzero(adopted):
            dia.sweep(table, int(k), False)
        _, sigma_b = dia.w_values(table, adopted)
        _, covariance, _ = solve(self.h[~adopted], v[~adopted], self.sigma[~adopted])
        variance = self.sigma**2
        return measures(
            sigma_b, variance, ~adopted, self.h, variance, np.ascontiguousarray(covariance[:3]), np.eye(3), factor
        )  # fmt: skip

    def tested(self, error: Floats, v: Floats, factor: Factors, *, identify: bool = True) -> Tested:
        table, _ = dia.residual_information(self.h, v, self.sigma)
        w, _ = dia.w_values(table, np.zeros(self.m, bool))
        adopted = _identified(table, self.m, identify).adopted
        x, _, _ = solve(self.h[~adopted], v[~adopted], self.sigma[~adopted])
        made = self._measures(v, adopted, factor)
        return Tested(table[-1, -1], w, adopted, x[:3], made.protection_horizontal, made.protection_vertical)


class CodeAndPhaseFilter:
    """A precise point position's epoch before its update: 10 satellites, a code and a phase each."""

    name = "filter of codes and phases"

    def __init__(self, n_satellites: int = 10) -> None:
        line, sine = sky(np.random.default_rng(21), n_satellites)
        self.m = 2 * n_satellites
        self.h = np.zeros((self.m, 4 + n_satellites))
        self.h[:, :3], self.h[:, 3] = -np.repeat(line, 2, axis=0), 1.0
        self.h[1::2, 4:] = np.eye(n_satellites)
        self.r = np.column_stack([(0.5 / sine) ** 2, (0.005 / sine) ** 2]).ravel()
        p = np.diag(np.concatenate([np.full(3, 100.0), [900.0], np.full(n_satellites, 900.0)]))
        x, used = np.zeros(len(p)), np.ones(self.m, bool)
        for _ in range(30):  # codes level the ambiguities; position and clock are free each epoch
            update_sequential(x, p, self.h, self.r, np.zeros(self.m), used)
            p[:3, :3] += 100.0 * np.eye(3)
            p[3, 3] += 900.0
        self.p, self.s, self.root_p = p, self.h @ p @ self.h.T + np.diag(self.r), np.linalg.cholesky(p)

    def draw(self, rng: np.random.Generator) -> tuple[Floats, Floats]:
        error = self.root_p @ rng.normal(size=len(self.p))
        return error, -self.h @ error + np.sqrt(self.r) * rng.normal(size=self.m)

    def promised(self) -> Promised:
        found = _identified(dia.information(self.s, np.zeros(self.m), np.zeros((self.m, 0)))[0], self.m, False)
        _, made = self._updated(found, np.zeros(self.m), factors(LEVELS, Integrity()))
        return Promised(made.mdb, made.external, self.m)

    def _updated(self, found: dia.Findings, v: Floats, factor: Factors):  # type: ignore[no-untyped-def]
        x, p, used = np.zeros(len(self.p)), self.p.copy(), ~found.adopted
        update_sequential(x, p, self.h, self.r, v, used)
        _, sigma_b = dia.w_values(found.swept, found.adopted)
        return x, measures(sigma_b, self.r, used, self.h, self.r, p[:3].copy(), np.eye(3), factor)

    def tested(self, error: Floats, v: Floats, factor: Factors, *, identify: bool = True) -> Tested:
        table, _ = dia.information(self.s, v, np.zeros((self.m, 0)))
        w, _ = dia.w_values(table, np.zeros(self.m, bool))
        found = _identified(table, self.m, identify)
        x, made = self._updated(found, v, factor)
        wrong = (x + error)[:3]
        return Tested(
            found.statistic, w, found.adopted, wrong, made.protection_horizontal, made.protection_vertical
        )  # fmt: skip


class Relative:
    """Phases of held integers against a base, of two systems with a clock each: the rows that RTK adjusts."""

    name = "RTK, integers held"

    def __init__(self, n_satellites: int = 8) -> None:
        line, sine = sky(np.random.default_rng(41), 2 * n_satellites)
        self.line, self.group, self.m = line, np.repeat([0, 1], n_satellites), 2 * n_satellites
        self.weight = 1.0 / (2.0 * (0.002**2) * (0.5 + 0.5 / sine**2))

    def draw(self, rng: np.random.Generator) -> tuple[Floats, Floats]:
        return np.zeros(3), rng.normal(size=self.m) / np.sqrt(self.weight)

    def _adjusted(self, v: Floats, critical: float):  # type: ignore[no-untyped-def]
        return adjust_rows(
            self.line, v, self.weight, self.group, 2, critical, np.inf, MOST, np.zeros((3, 3))
        )  # fmt: skip

    def _measures(self, found, factor: Factors):  # type: ignore[no-untyped-def]
        weight = np.where(found.use, self.weight, 0.0)
        mean = np.array([weight[self.group == g] @ -self.line[self.group == g] for g in (0, 1)])
        mean /= np.array([weight[self.group == g].sum() for g in (0, 1)])[:, None]
        return measures(
            found.sigma_error_m, 1.0 / self.weight, found.use, -self.line - mean[self.group], 1.0 / self.weight,
            np.ascontiguousarray(found.covariance_m2), np.eye(3), factor,
        )  # fmt: skip

    def promised(self) -> Promised:
        found = self._adjusted(np.zeros(self.m), np.inf)
        made = self._measures(found, factors(LEVELS, Integrity()))
        return Promised(made.mdb, made.external, self.m - 5)

    def tested(self, error: Floats, v: Floats, factor: Factors, *, identify: bool = True) -> Tested:
        before = self._adjusted(v, np.inf)
        found = self._adjusted(v, CRITICAL) if identify else before
        made = self._measures(found, factor)
        return Tested(
            before.squares, before.w, ~found.use, found.b_m, made.protection_horizontal, made.protection_vertical
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Counted:
    """What was found over many draws."""

    false_alarms: float  # share of clean epochs whose global test fails
    false_w: float  # share of clean observations whose w-test fails
    power: float  # share of errors of the MDB whose w-test fails


def count_alarms(world: World, n_clean: int, n_faults: int, seed: int) -> Counted:
    """False alarms in clean epochs, and how many errors of the MDB are found."""
    rng, promised, factor = np.random.default_rng(seed), world.promised(), factors(LEVELS, Integrity())
    limit, alarms, false, found = global_critical(LEVELS, promised.degrees_of_freedom), 0, 0, 0
    for _ in range(n_clean):
        made = world.tested(*world.draw(rng), factor, identify=False)
        alarms += made.statistic > limit
        false += int(np.count_nonzero(made.w**2 > CRITICAL))
    for trial in range(n_faults):
        i = trial % world.m
        error, v = world.draw(rng)
        v[i] += promised.mdb[i] * rng.choice([-1.0, 1.0])
        found += world.tested(error, v, factor, identify=False).w[i] ** 2 > CRITICAL
    return Counted(alarms / n_clean, false / (n_clean * world.m), found / n_faults)


def count_beyond(world: World, size_in_mdb: float, integrity: Integrity, n: int, seed: int) -> tuple[int, int]:
    """How often the position's error exceeds its protection levels, with an error of one observation each time."""
    rng, promised, factor = np.random.default_rng(seed), world.promised(), factors(LEVELS, integrity)
    beyond_h = beyond_v = 0
    for trial in range(n):
        error, v = world.draw(rng)
        v[trial % world.m] += size_in_mdb * promised.mdb[trial % world.m]
        made = world.tested(error, v, factor)
        east, north, up = made.position_error
        beyond_h += np.hypot(east, north) > made.protection_horizontal
        beyond_v += abs(up) > made.protection_vertical
    return beyond_h, beyond_v


def worst_external_difference(world: World, seed: int) -> float:
    """Largest difference of what errors of the MDB do to the position from the external reliability, relative to it."""
    rng, promised, factor, worst = np.random.default_rng(seed), world.promised(), factors(LEVELS, Integrity()), 0.0
    for i in range(world.m):
        error, v = world.draw(rng)
        before = world.tested(error, v, factor, identify=False).position_error
        v[i] += promised.mdb[i]
        moved = world.tested(error, v, factor, identify=False).position_error - before
        size = float(np.linalg.norm(promised.external[i]))
        worst = max(worst, float(np.linalg.norm(moved - promised.external[i])) / size)
    return worst


WORLDS = (SinglePoint, CodeAndPhaseFilter, Relative)
