"""What the loose filter keeps, takes and answers with."""

from dataclasses import dataclass, field
from typing import Final

from plumbline.fusion.timeline import Node, Rows, Timeline, empty_timeline
from plumbline.fusion.zupt import Standstill
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, Status

VELOCITY_SIGMAS: Final = ("sigma_ve_m_s", "sigma_vn_m_s", "sigma_vu_m_s")  # extras of a solution that carries them


@dataclass(frozen=True, slots=True)
class Fix:
    """A GNSS position, a velocity, or both, as the filter takes them."""

    t_gps_ns: int  # by the samples' stamps
    geodetic: Floats | None  # (3,) latitude rad, longitude rad, height m
    velocity_enu_m_s: Floats | None  # (3,)
    covariance: Floats  # (6, 6) m², (m/s)²; east, north, up
    status: Status
    t_true_ns: int  # by its own clock
    rank: int = 0


@dataclass(frozen=True, slots=True)
class Innovation:
    """What a fix said beyond what was expected of it; ENU, at the antenna."""

    t_gps_ns: int
    value: Floats  # (6,) position m, velocity m/s; NaN where the fix has none
    sigma: Floats  # (6,) expected
    left: Floats  # (6,) of it after the update
    used: bool


@dataclass(frozen=True, slots=True)
class SampleClock:
    """How late the true time is against the samples' stamps: ``t_true = stamp + offset_s`` at ``t_gps_ns``."""

    t_gps_ns: int
    offset_s: float = 0.0
    drift: float = 0.0  # s/s

    def offset_at(self, t_gps_ns: int) -> float:
        """The offset at another time, s."""
        return self.offset_s + self.drift * (t_gps_ns - self.t_gps_ns) / NS_PER_S

    def stamp_of(self, t_true_ns: int) -> int:
        """Where a true time lies among the stamps, ns."""
        return t_true_ns - round(self.offset_at(t_true_ns) * NS_PER_S)


@dataclass(frozen=True, slots=True)
class LooseExtra:
    """What goes with the navigation state."""

    refusals: int = 0  # fixes in a row that were refused
    t_fix_gps_ns: int | None = None  # of the last fix used
    status: Status = Status.NO_OBSERVATIONS  # of that fix
    innovation: Innovation | None = None
    clock: SampleClock | None = None  # None: the stamps are right


LooseTimeline = Timeline[Fix | Standstill, LooseExtra]
LooseNode = Node[LooseExtra]


@dataclass(frozen=True, slots=True)
class LooseState:
    """A station's filter. Frozen: every function answers with a new one."""

    station: str
    timeline: LooseTimeline = field(default_factory=empty_timeline)
    t_window_ns: int = 0  # standstills up to here have been looked for
    t_aligned_try_ns: int = 0
    aligned: str = ""  # how, in words; empty while not


@dataclass(frozen=True, slots=True)
class LooseResult:
    """The new state, the samples' rows (again, after something late) and the innovations met."""

    state: LooseState
    rows: Rows
    innovations: tuple[Innovation, ...] = ()


def initial_loose_state(station: str) -> LooseState:
    """Before the first input."""
    return LooseState(station)
