"""The state that a station's position filter carries from epoch to epoch: small, frozen, picklable.

Layout of ``x`` (and of ``p``): the core states below, then one ionosphere-free ambiguity (metres) for every arc, in the
order of ``arcs``. A core state that is not in use yet has a zero row in ``p``.

An *arc* is the history of one satellite's pair of signals: what cycle-slip detection compares with, and how long the
ambiguity has been the same.
"""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from plumbline.estimation.dia_window import Share, Window
from plumbline.records import Floats
from plumbline.signals import SATELLITES_PER_SYSTEM, System

POSITION: Final = slice(0, 3)  # antenna's marker, ECEF, m
ZENITH_DELAY: Final = 3  # wet part, m
GRADIENTS: Final = slice(4, 6)  # north, east, m
CLOCKS: Final = slice(6, 6 + len(System))  # receiver clock against each system's, m
N_CORE: Final = 6 + len(System)

ARC_DTYPE: Final = np.dtype(
    [
        ("satellite", np.int16),
        ("signal_1", np.int16),
        ("signal_2", np.int16),
        ("discontinuity_1", np.int16),
        ("discontinuity_2", np.int16),
        ("half_cycle", np.int8),  # bit 0: first signal's ambiguity may be off by half a cycle, bit 1: second's
        ("estimated", np.bool_),  # its ambiguity state is in use
        ("t_first_ns", np.int64),
        ("t_last_ns", np.int64),
        ("lock_time_s", np.float64),
        ("geometry_free_m", np.float64),  # phase, first minus second frequency, at t_last
        ("geometry_free_rate_m_s", np.float64),  # NaN until two epochs are known
        ("phase_minus_code_m", np.float64),  # ionosphere-free, at t_last
        ("wind_up_cycles", np.float64),  # continuous over the arc; NaN before the first
        ("code_weight_m2", np.float64),  # Σ 1/σ² of the codes used so far, without their constant bias, 1/m²
        ("refused", np.int64),  # epochs in a row in which quality control refused the phase
        ("refused_m", np.float64),  # … and by how much it was off the last time
        ("residual_m", np.float64),  # what the last accepted phase differed by from the updated filter
        ("t_residual_ns", np.int64),  # … and when; zero: there was none
        ("residual_geometry_free_m", np.float64),
        ("doubted", np.int64),  # epochs in a row whose geometry-free phase does not carry on from t_last's
        ("geometry_free_doubted_m", np.float64),  # … the last of them
        ("t_doubted_ns", np.int64),
        ("began", np.int8),  # why: see plumbline.positioning.cycle_slip
        ("code_count", np.int64),  # epochs of codes behind the means below
        ("wide_lane_mean_cycles", np.float64),  # of Melbourne-Wübbena, over accepted codes
        ("phase_minus_code_mean_m", np.float64),  # ionosphere-free
    ],
    align=True,
)

Records = NDArray[Any]  # structured arrays: NumPy's types do not name their fields

LEVEL_DTYPE: Final = np.dtype(
    [
        ("offset_m", np.float64),  # mean of a satellite's code's innovations
        ("scale", np.float64),  # how large its statistics usually are
        ("count", np.int64),  # epochs behind it
        ("refused", np.int64),  # epochs in a row in which quality control refused the code
        ("t_last_ns", np.int64),
    ],
    align=True,
)


def no_levels() -> Records:
    """Means of codes' innovations of which nothing is known, by satellite id."""
    return np.zeros(len(System) * SATELLITES_PER_SYSTEM, LEVEL_DTYPE)


def no_arcs() -> Records:
    """An empty arc table."""
    return np.zeros(0, ARC_DTYPE)


@dataclass(frozen=True, slots=True)
class PppState:
    """State of the position filter after an epoch. ``t_gps_ns`` None: nothing has been estimated yet.

    Arcs are kept through epochs without corrections too, so that ambiguities survive them.
    """

    t_gps_ns: int | None = None  # of the last update
    t_last_epoch_ns: int | None = None  # of the last epoch, with or without an update
    x: Floats = field(default_factory=lambda: np.zeros(N_CORE))
    p: Floats = field(default_factory=lambda: np.zeros((N_CORE, N_CORE)))  # that the gains are made of
    errors: Floats = field(default_factory=lambda: np.zeros((N_CORE, N_CORE)))  # covariance of the errors they leave
    arcs: Records = field(default_factory=no_arcs)
    levels: Records = field(default_factory=no_levels)
    phase_jump_m: float = 0.0  # clock jumps that the receiver applied to the code alone, summed
    covariance_enu_m2: Floats | None = None  # (3, 3) of the position after the last update
    phase_scale: float = 1.0  # how large the phases' w-statistics usually are
    code_scale: float = 1.0  # … and the codes'
    share: Share = field(default_factory=Share)  # what a degree of freedom has of the tests' statistic
    window: Window = field(default_factory=Window)  # the last epochs' statistics, over what is usual
    window_share: Share = field(default_factory=Share)
    rejected_in_a_row: int = 0  # epochs that quality control refused
    reference_position_ecef_m: tuple[float, float, float] | None = None  # adopted where settings give none
    t_converged_gps_ns: int | None = None  # when the position first reached the accuracy asked for


def initial_state() -> PppState:
    """The state before the first epoch."""
    return PppState()
