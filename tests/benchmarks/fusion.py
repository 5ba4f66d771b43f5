"""Samples a second of processor time through the multirate filter, against plain NumPy on the same samples."""

import time
from collections.abc import Callable

import numpy as np
from tests.benchmarks.table import Row
from tests.unit.fusion.scenes import SETTINGS, T0, S, block, solution
from tests.unit.fusion.test_kernels import matrices

from plumbline.fusion import initial_state, receive_inertial, receive_solution, warm_up
from plumbline.records import Floats

RATE, N_S, REPEATS = 100, 60, 7


def _ours(samples: Floats, measured: Floats) -> Floats:
    state = initial_state("A")
    for k in range(N_S):
        state, _, _ = receive_solution(state, solution(T0 + k * S, measured[k]), SETTINGS)
        piece = samples[k * RATE : (k + 1) * RATE]
        state, _, _ = receive_inertial(state, block(T0 + k * S, piece, S // RATE), SETTINGS)
    return state.head.x


def _numpy(samples: Floats, measured: Floats) -> Floats:
    """Eqs 3-8 as matrices, the covariances constant, no bookkeeping at all."""
    q_a, q_u = SETTINGS.acceleration_noise_m_s2_sqrt_hz**2, SETTINGS.baseline_drift_m_s2_sqrt_s**2
    a, b, q = matrices(1 / RATE, q_a, q_u)
    h, r = np.eye(3, 9), np.eye(3) * 0.005**2
    x, p = np.zeros(9), np.eye(9)
    for k in range(len(samples)):
        x = a @ x + b @ (0.5 * (samples[k] + samples[max(k - 1, 0)]))
        p = a @ p @ a.T + q
        if k % RATE == 0:
            gain = np.linalg.solve(h @ p @ h.T + r, h @ p).T
            x = x + gain @ (measured[k // RATE] - h @ x)
            p = (np.eye(9) - gain @ h) @ p
    return x


def _processor_s(job: Callable[[Floats, Floats], Floats], samples: Floats, measured: Floats) -> float:
    start = time.process_time()
    job(samples, measured)
    return time.process_time() - start


def run() -> list[Row]:
    """One row: the live functions (states, blocks, solutions and all) against the bare matrices."""
    warm_up()
    rng = np.random.default_rng(0)
    samples, measured = rng.normal(0, 5e-3, (N_S * RATE, 3)), rng.normal(0, 5e-3, (N_S, 3))
    _ours(samples, measured)
    pairs = [(_processor_s(_ours, samples, measured), _processor_s(_numpy, samples, measured)) for _ in range(REPEATS)]
    ours, theirs = (len(samples) / min(times) for times in zip(*pairs, strict=True))
    return [Row("multirate fusion at 100 Hz, one station", "NumPy matrices", ours, theirs, "samples/s", ours / theirs)]


if __name__ == "__main__":
    for row in run():
        print(row)
