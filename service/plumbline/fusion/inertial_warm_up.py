"""Compiles the inertial filters' kernels, by a tenth of a second of each filter."""

import numpy as np

from plumbline.config import InertialSettings, RtkSettings
from plumbline.fusion.alignment import Alignment, level_velocity_changes
from plumbline.fusion.loose_eskf import initial_loose_state, receive_samples, receive_solution
from plumbline.fusion.loose_start import start
from plumbline.fusion.loose_state import LooseExtra
from plumbline.fusion.tight_multi_antenna import initial_tight_state, receive_epoch, start_tight
from plumbline.fusion.tight_multi_antenna import receive_samples as receive_tight_samples
from plumbline.fusion.tight_observations import ANTENNA_KEY, SIGNAL_KEY, TightEpoch
from plumbline.fusion.tight_start import first_tight_node
from plumbline.fusion.timeline import Node
from plumbline.records import Solution, Status

_SETTINGS = InertialSettings(lever_arms_body_m=((0.0, 0.5, 0.1), (0.5, 0.0, 0.1)))
_STEP_NS = 10_000_000
_SAMPLES = np.tile([0.0, 0.0, 9.8, 0.0, 0.0, 0.0], (11, 1))
_PLACE = np.array([6_378_137.0, 0.0, 0.0])


def warm_up() -> None:
    """Compile (or load from the cache) every kernel of the loose and the tight filter."""
    times = np.arange(11, dtype=np.int64) * _STEP_NS
    nav = np.zeros(21)
    nav[6:15] = np.eye(3).ravel()
    state = start(initial_loose_state("warm"), Node(0, nav, np.eye(15) * 1e-4, LooseExtra()), "given", _SETTINGS)
    state = receive_samples(state, times, _SAMPLES, _SETTINGS).state
    fix = Solution("warm", 5 * _STEP_NS, 5 * _STEP_NS, Status.RTK_FIXED, "", 9, _PLACE, None, np.eye(3), np.zeros(3))
    receive_solution(state, fix, _SETTINGS)
    level_velocity_changes(times, _SAMPLES, np.eye(3), np.zeros(3), 0, times[5:6])
    node = first_tight_node(0, _PLACE, 0.01, Alignment(np.eye(3), np.full(3, 1e-3), np.eye(3)), _SETTINGS)
    tight = start_tight(initial_tight_state("warm"), node)
    tight = receive_tight_samples(tight, times, _SAMPLES, _SETTINGS, RtkSettings()).state
    for k in (4, 8):
        tight = receive_epoch(tight, _epoch(k * _STEP_NS), _SETTINGS, RtkSettings()).state


def _epoch(t_ns: int) -> TightEpoch:
    """Six satellites on two antennas, nothing measured."""
    angles = np.linspace(0.2, 2.9, 6)
    lines = np.column_stack([0.6 + 0.1 * np.sin(3 * angles), np.cos(angles), np.sin(angles) * np.cos(3 * angles)])
    lines /= np.linalg.norm(lines, axis=1)[:, None]
    antenna, satellite = np.repeat([0, 1], 6), np.tile(np.arange(6), 2)
    return TightEpoch(
        t_ns, antenna, antenna * ANTENNA_KEY + satellite * SIGNAL_KEY, antenna * ANTENNA_KEY, satellite * SIGNAL_KEY,
        np.full(12, 0.19), np.tile(lines, (2, 1)), np.full(12, 0.5), np.zeros(12), np.zeros(12), np.zeros(12),
        np.tile([1e-5, 0.1, 1e-3], (12, 1)), np.ones(12, np.bool_), np.zeros(12, np.bool_), np.full(12, np.nan),
        np.tile(_PLACE, (2, 1)),
    )  # fmt: skip
