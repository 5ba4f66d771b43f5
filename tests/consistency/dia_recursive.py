"""Errors too small for one epoch: the tests over a window of a filter's epochs, drawn many times.

A filter of an antenna that hardly moves: ten satellites' phases, position and clock, known ambiguities. One phase has a
bias that began with the window and is far below what an epoch tells.
"""

from dataclasses import dataclass

import numpy as np

from plumbline.estimation import dia
from plumbline.estimation.dia_tables import Levels, global_critical, noncentrality, w_critical
from plumbline.estimation.dia_window import Window, accumulate, add_epoch, carry_response, equivalent, respond
from plumbline.records import Floats

from .dia_worlds import sky

LEVELS = Levels()
EPOCHS = 30
SIGMA_M, STEP_M, CLOCK_M = 0.004, 0.0005, 30.0


@dataclass(frozen=True, slots=True)
class Recursive:
    """What was counted."""

    false_alarms: float  # of the window's global test
    false_w: float  # of the window's w-tests
    power: float  # at the window's MDB
    mdb_of_epoch: float  # mean over the observations, m
    mdb_of_window: float
    moved_beside_response: float  # largest |mean error of the position − response · MDB| over its sigma


class SlowBias:
    """The filter's gains are those of its covariances, so one run of these serves all draws."""

    def __init__(self) -> None:
        line, sine = sky(np.random.default_rng(51), 10)
        self.h = np.column_stack([-line, np.ones(10)])
        self.r = (SIGMA_M / sine) ** 2
        self.q = np.diag([STEP_M**2] * 3 + [CLOCK_M**2])
        self.m, p = 10, np.diag([0.01**2] * 3 + [CLOCK_M**2])
        for _ in range(200):
            p = self._updated(p)[0] + self.q
        self.p, self.gains, self.s, responses = p, [], [], []
        x_response = np.zeros((4, self.m))
        for _ in range(EPOCHS):
            p_after, gain, s = self._updated(p)
            response = respond(self.h, np.eye(self.m), x_response)
            x_response = carry_response(np.eye(4), gain, x_response, response)
            responses.append(response)
            self.gains.append(gain)
            self.s.append(s)
            p = p_after + self.q
        self.responses, self.x_response, self.p_end = responses, x_response, p - self.q
        self.information = [np.linalg.inv(s) for s in self.s]
        self.sizes = [np.einsum("ji,jk,ki->i", c, w, c) for c, w in zip(responses, self.information, strict=True)]
        root = np.sqrt(noncentrality(LEVELS))
        self.mdb, self.mdb_of_epoch = root / np.sqrt(np.sum(self.sizes, axis=0)), root / np.sqrt(self.sizes[0])

    def _updated(self, p: Floats) -> tuple[Floats, Floats, Floats]:
        s = self.h @ p @ self.h.T + np.diag(self.r)
        gain = np.linalg.solve(s, self.h @ p).T
        return p - gain @ self.h @ p, gain, s

    def run(self, rng: np.random.Generator, bias: Floats) -> tuple[Window, Floats, Floats]:
        """The window's global test and w-statistics (m,), and the error of the position at its end (3,)."""
        error = np.linalg.cholesky(self.p) @ rng.normal(size=4)  # estimated less true
        sums, window, w = np.zeros((self.m, 2)), Window(), np.zeros(self.m)
        root_q = np.sqrt(np.diag(self.q))
        for k in range(EPOCHS):
            v = bias + np.sqrt(self.r) * rng.normal(size=self.m) - self.h @ error
            table, _ = dia.information(self.s[k], v, np.ascontiguousarray(self.responses[k]))
            extra = slice(self.m, 2 * self.m)
            w = accumulate(sums, table[extra, -1].copy(), np.diag(table)[extra].copy(), 1.0)
            window = add_epoch(window, float(table[-1, -1]), self.m, 1.0)
            error = error + self.gains[k] @ v
            if k < EPOCHS - 1:
                error = error + root_q * rng.normal(size=4)
        return window, w, error[:3]


def count_recursive(n_clean: int, n_faults: int, seed: int) -> Recursive:
    """Window tests in clean runs and with one phase off by the window's MDB."""
    world, rng = SlowBias(), np.random.default_rng(seed)
    alarms = false = found = 0
    for _ in range(n_clean):
        window, w, _ = world.run(rng, np.zeros(world.m))
        statistic, freedom = equivalent(window)
        alarms += statistic > global_critical(LEVELS, round(freedom))
        false += int(np.count_nonzero(np.abs(w) > w_critical(LEVELS)))
    moved = np.zeros((world.m, 3))
    for trial in range(n_faults):
        i, bias = trial % world.m, np.zeros(world.m)
        bias[i] = world.mdb[i]
        _, w, error = world.run(rng, bias)
        found += abs(w[i]) > w_critical(LEVELS)
        moved[i] += error / (n_faults // world.m)
    expected = (world.x_response[:3] * world.mdb).T
    sigma = np.sqrt(np.diag(world.p_end)[:3] / (n_faults // world.m))
    return Recursive(
        alarms / n_clean, false / (n_clean * world.m), found / n_faults, float(world.mdb_of_epoch.mean()),
        float(world.mdb.mean()), float(np.abs((moved - expected) / sigma).max()),
    )  # fmt: skip
