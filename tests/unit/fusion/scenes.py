"""Motions that the fusion's tests run on, with their solutions and samples."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from plumbline.config import FusionSettings
from plumbline.constants import STANDARD_GRAVITY_M_S2
from plumbline.fusion import FusionState, initial_state, receive_inertial, receive_solution
from plumbline.records import Floats, InertialBlock, Motion, Solution, Status

T0 = 1_300_000_000 * 10**9  # a whole GPS second
S = 10**9
SETTINGS = FusionSettings()


def solution(
    t_ns: int, displacement: Floats | list[float], sigma_m: float | Floats = 0.005, **changes: object
) -> Solution:
    covariance = np.diag(np.broadcast_to(np.asarray(sigma_m, float), 3) ** 2)
    made = Solution(
        "A",
        t_ns,
        t_ns,
        Status.PPP_FLOAT,
        "",
        displacement_enu_m=np.array(displacement, float),
        covariance_enu_m2=covariance,
    )
    return replace(made, **changes)  # type: ignore[arg-type]


def block(
    t_ns: int, acceleration_enu: Floats, interval_ns: int = 10_000_000, received_ns: int | None = None
) -> InertialBlock:
    """Samples of a sensor whose axes are east, north, up: the upward one feels gravity."""
    force = np.add(acceleration_enu, [0.0, 0.0, STANDARD_GRAVITY_M_S2])
    return InertialBlock(t_ns, received_ns or t_ns + S, interval_ns, force)


def shaken(n_seconds: int = 20, rate: int = 100, seed: int = 7) -> tuple[list[Solution], list[InertialBlock]]:
    """A noisy sway with a mounting bias: a solution at each second's start and its block of samples."""
    rng = np.random.default_rng(seed)
    t = np.arange(n_seconds * rate) / rate
    omega = 2 * np.pi * 0.4
    acceleration = np.outer(-(omega**2) * 0.05 * np.sin(omega * t), [1.0, -0.5, 0.2])
    acceleration += np.array([0.12, -0.2, 0.05]) + rng.normal(0, 3e-3, acceleration.shape)
    seconds = np.arange(n_seconds)
    truth = np.outer(0.05 * np.sin(omega * seconds), [1.0, -0.5, 0.2])
    measured = truth + rng.normal(0, 0.004, truth.shape)
    solutions = [solution(T0 + int(k) * S, measured[k]) for k in seconds]
    blocks = [block(T0 + int(k) * S, acceleration[k * rate : (k + 1) * rate], S // rate) for k in seconds]
    return solutions, blocks


def feed(
    records: Sequence[Solution | InertialBlock], settings: FusionSettings = SETTINGS, state: FusionState | None = None
) -> tuple[FusionState, list[Motion]]:
    """State and every published block, in the order of publication."""
    state = state or initial_state("A")
    published: list[Motion] = []
    for record in records:
        receive = receive_solution if isinstance(record, Solution) else receive_inertial
        state, motions, _ = receive(state, record, settings)  # type: ignore[arg-type]
        published += motions
    return state, published


def stored(published: list[Motion]) -> dict[int, Motion]:
    """What a store keeps: the highest revision of each block."""
    kept: dict[int, Motion] = {}
    for motion in published:
        old = kept.get(motion.t_first_gps_ns)
        assert old is None or motion.revision > old.revision
        kept[motion.t_first_gps_ns] = motion
    return kept


def in_order(solutions: list[Solution], blocks: list[InertialBlock]) -> list[Solution | InertialBlock]:
    return [record for pair in zip(solutions, blocks, strict=True) for record in pair]
