"""What the multirate filter remembers of a station: the filter itself, and the last seconds to go back into.

All records are frozen and picklable; a checkpoint is about 8 KB a second of ``late_limit_s`` at 100 Hz.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from plumbline.epochs.time_matching import NO_TAIL, SampleTail
from plumbline.estimation.dia_window import Window
from plumbline.fusion.gravity import gravity_at_m_s2
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, Motion, Status

N_STATES: Final = 9
DISPLACEMENT: Final = slice(0, 3)  # m, ENU
VELOCITY: Final = slice(3, 6)  # m/s, ENU
BASELINE: Final = slice(6, 9)  # m/s², ENU: what the accelerometer reads at rest, gravity taken off


@dataclass(frozen=True, slots=True)
class Node:
    """The filter at one instant.

    Until the first solution (``t_solution_gps_ns`` None) the structure is taken to stand still: the baseline is the
    mean of the samples, ``baseline_samples`` counts them (0: no baseline known), and displacement, velocity and ``p``
    mean nothing.
    """

    t_gps_ns: int | None
    x: Floats  # (9,) displacement, velocity, baseline
    p: Floats  # (9, 9)
    last_acceleration_m_s2: Floats  # (3,) ENU, gravity taken off, of the sample at t_gps_ns; NaN: none
    baseline_samples: int = 0
    baseline_scatter_m2_s4: Floats = field(default_factory=lambda: np.zeros(3))  # variance of those samples
    t_baseline_gps_ns: int | None = None  # since when there have been samples to learn the baseline from
    t_solution_gps_ns: int | None = None  # of the last solution that was applied
    solution_status: Status = Status.NO_OBSERVATIONS
    solution_variance_m2: Floats = field(default_factory=lambda: np.zeros(3))  # of the same, ENU
    refusals: int = 0  # solutions in a row that were refused
    refusal: str = ""  # the last one, in words
    off: tuple[tuple[int, Floats], ...] = ()  # of those refused in a row: time, and how far off (3,) m
    note: str = ""  # what a new start rests on, in words …
    t_note_gps_ns: int = 0  # … and since when
    window: Window = field(default_factory=Window)  # the global tests of the last solutions


@dataclass(frozen=True, slots=True)
class Measurement:
    """A solution's displacement waiting for its instant, or kept to be applied again."""

    t_gps_ns: int
    t_receive_ns: int
    displacement_enu_m: Floats  # (3,)
    covariance_enu_m2: Floats  # (3, 3) of the part that is new in this epoch: what the update weighs it by
    variance_enu_m2: Floats  # (3,) of all of its error
    status: Status
    processed: bool = False  # its innovation has been reported

    @property
    def second(self) -> int:
        """The GPS second whose run it is part of."""
        return self.t_gps_ns // NS_PER_S


@dataclass(frozen=True, slots=True)
class Second:
    """One GPS second of inertial samples, or (``rate`` 0) of GNSS alone, and the filter as it enters it."""

    second: int  # of GPS time since 1980-01-06
    rate: int
    entry: Node  # the filter after the last sample before this second
    acceleration_m_s2: Floats  # (rate, 3) ENU, gravity taken off, NaN missing
    filled: int  # samples up to here are in or given up
    t_receive_ns: int
    revision: int = 0  # of the next block of this second


@dataclass(frozen=True, slots=True)
class Innovation:
    """One-step prediction error of a solution: what the filter's consistency is judged by."""

    t_gps_ns: int
    innovation_enu_m: Floats  # (3,) measured − predicted
    whitened: Floats  # (3,) inverse Cholesky factor of its covariance × innovation: independent, unit variance
    variance_enu_m2: Floats  # (3,) diagonal of its covariance
    applied: bool
    mdb_enu_m: Floats  # (3,) error of one component that the gate finds with the power stated
    reason: str = ""
    cause: str = ""  # plumbline.fusion.control.Cause, where it did not fit
    window: Window = field(default_factory=Window)  # of this and the solutions before it

    @property
    def nis(self) -> float:
        """Normalised innovation squared: χ² with three degrees of freedom where model and data agree."""
        return float(self.whitened @ self.whitened)


@dataclass(frozen=True, slots=True)
class FusionState:
    """A station's fusion between two inputs."""

    station: str
    gravity_m_s2: float
    head: Node  # the filter after all that is in
    seconds: tuple[Second, ...] = ()  # in time order, the last late_limit_s of them
    measurements: tuple[Measurement, ...] = ()  # in time order, from the first of `seconds` on
    rate: int = 0  # of the sensor's grid, samples a second; 0 before the first sample
    sensor: int | None = None  # whose samples drive the filter: the first that was heard
    tail: SampleTail = NO_TAIL
    t_samples_end_gps_ns: int | None = None  # of the last inertial sample
    stale_from: int | None = None  # first second whose emitted block is older than the filter's knowledge of it
    first_revision: int = 0  # of every block
    late_in_a_row: int = 0  # inputs that came too late, since one that did not
    last_innovation: Innovation | None = None
    no_solution: str = ""  # why the last solution had no displacement to use
    counters: Mapping[str, int] = field(default_factory=dict)  # inputs not used, by reason


class FusionResult(NamedTuple):
    """State, blocks to publish (a higher revision replaces a lower), innovations of solutions used for the first
    time.
    """

    state: FusionState
    motions: list[Motion]
    innovations: list[Innovation]


def initial_state(
    station: str, reference_position_ecef_m: Floats | tuple[float, float, float] | None = None
) -> FusionState:
    """A station's fusion before any input; gravity is the normal gravity at the reference position, if known."""
    return FusionState(station, gravity_at_m_s2(reference_position_ecef_m), unknown_node())


def unknown_node() -> Node:
    """The filter that has seen nothing."""
    return Node(None, np.zeros(N_STATES), np.zeros((N_STATES, N_STATES)), np.full(3, np.nan))
