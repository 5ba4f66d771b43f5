"""What relative positioning carries from epoch to epoch, and what a base station gives it.

The filter is kept in information form over ``x = (baseline correction (3,), m; one single-difference ambiguity for each
arc, cycles)``: ``information @ x = right``. Single differences between receivers leave, for every group of rows that
share a clock (one a system and signal), the mean of its ambiguities unknown: the information matrix is singular there
by construction, and choosing a reference satellite (its ambiguity taken as zero) is a choice of datum made when an
estimate is read out, not a part of the state. So nothing has to be transformed when the reference sets, a new
ambiguity is a row of zeros (no large variances), and losing one is a Schur complement.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from plumbline.estimation.dia_window import Window
from plumbline.positioning.state import Records
from plumbline.records import Epoch, Floats

POSITION: Final = slice(0, 3)
N_CORE: Final = 3

RTK_ARC_DTYPE: Final = np.dtype(
    [
        ("satellite", np.int16),
        ("signal", np.int16),  # of the rover
        ("base_signal", np.int16),
        ("integer", np.bool_),  # its double differences are integers (not GLONASS, no half cycle open)
        ("half_cycle", np.int8),  # bit 0: rover, bit 1: base
        ("held", np.bool_),  # resolved, relative to the other held ones of its group
        ("value", np.int64),  # the integer held, cycles
        ("count", np.int64),  # epochs since it began
        ("refused", np.int64),  # epochs in a row in which its phase did not fit the integers held
        ("off", np.int64),  # epochs in a row in which its phase was elsewhere than its change should have brought it
        ("off_m", np.float64),  # and how far
        ("t_first_ns", np.int64),
        ("t_last_ns", np.int64),
        ("lock_time_s", np.float64),
        ("base_lock_time_s", np.float64),
        ("offset_cycles", np.float64),  # whole cycles taken off the phase so that ambiguities stay small
        ("residual_m", np.float64),  # phase, observed minus computed at the position solved at t_last, less off_m
        ("code_residual_m", np.float64),  # of the code, the same; NaN: none
        ("code_off", np.int64),
        ("code_off_m", np.float64),
        ("code_square", np.float64),  # mean square of the code's changes, in units of their nominal variance
        ("code_count", np.int64),  # changes that it is the mean of
    ],
    align=True,
)


def no_rtk_arcs() -> Records:
    """An empty arc table."""
    return np.zeros(0, RTK_ARC_DTYPE)


@dataclass(frozen=True, slots=True)
class RtkState:
    """State after an epoch; frozen, picklable. ``t_gps_ns`` None: nothing has been estimated yet."""

    t_gps_ns: int | None = None  # of the last update
    t_last_epoch_ns: int | None = None
    t_base_first_ns: int | None = None  # of the first base epoch whose antenna's position nobody told
    base_position_ecef_m: tuple[float, float, float] | None = None  # adopted for a base that does not tell its own
    origin_ecef_m: Floats = field(default_factory=lambda: np.zeros(3))  # that the baseline correction counts from
    position_ecef_m: Floats = field(default_factory=lambda: np.zeros(3))  # the last one, antenna reference point
    information: Floats = field(default_factory=lambda: np.zeros((N_CORE, N_CORE)))
    right: Floats = field(default_factory=lambda: np.zeros(N_CORE))
    arcs: Records = field(default_factory=no_rtk_arcs)
    fixed_in_a_row: int = 0  # epochs whose integers agreed
    doubts_in_a_row: int = 0  # epochs that spoke against the integers held
    phase_size: float = 1.0  # how large the phases' changes usually are, in units of their nominal sigma
    code_size: float = 1.0  # the same of the codes'
    sizes_count: int = 4  # epochs that they are the mean of; the nominal sizes count for four
    variance_factor: float = 1.0  # of the epochs' adjustments, as it usually is
    variance_count: int = 0  # epochs that it is the mean of
    window: Window = field(default_factory=Window)  # the tests over the last epochs
    t_verified_ns: int = 0  # when the integers held were last compared with a free search
    reference_position_ecef_m: tuple[float, float, float] | None = None  # adopted where settings give none


@dataclass(frozen=True, slots=True)
class BaseView:
    """What is known of the base at one instant; ``epoch`` None: nothing usable, and ``reason`` says why."""

    station: str
    epoch: Epoch | None
    position_ecef_m: Floats | None  # antenna reference point
    reason: str = ""


def no_base(station: str, reason: str) -> BaseView:
    """A base that cannot be used."""
    return BaseView(station, None, None, reason)


def initial_state() -> RtkState:
    """The state before the first epoch."""
    return RtkState()
