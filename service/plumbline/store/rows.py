"""What goes into and comes out of the store, beyond the records themselves. Times are GPS ns, units SI."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from plumbline.config import StationSettings
from plumbline.records import AlertState, Floats, Ints, Severity

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A station's pipeline state, and how far into each archived stream it has consumed."""

    station: str
    t_receive_ns: int  # of the last input that went into the state; an older checkpoint never replaces a newer
    state: bytes
    consumed: Mapping[str, int]  # archived stream → offset of the first byte not yet consumed


@dataclass(frozen=True, slots=True)
class StationRow:
    """A station as stored: its settings, and when and how often they changed."""

    settings: StationSettings
    version: int  # 1 at creation, one more at every change
    created_gps_ns: int
    changed_gps_ns: int


@dataclass(frozen=True, slots=True)
class Page(Generic[T]):
    """A part of a list; ``next`` is the cursor of the part after it, None at the end."""

    items: tuple[T, ...]
    next: str | None = None


@dataclass(frozen=True, slots=True)
class MotionSummary:
    """What is kept of an interval's samples, each (n, 9): displacement, velocity, acceleration, in ENU."""

    minimum: Floats
    maximum: Floats
    mean: Floats
    rms: Floats


@dataclass(frozen=True, slots=True)
class MotionSeries:
    """A station's motion over a span, as samples (``bucket_ns`` 0) or as a summary of every ``bucket_ns``.

    Times are those of the samples, or of the buckets' starts (whole minutes, hours, days of UTC), strictly
    ascending. Vectors are (n, 3), ENU, SI; of a bucket the mean. ``blocks`` names the blocks that samples came from,
    their arrays left out; it is empty for buckets.
    """

    station: str
    bucket_ns: int
    t_gps_ns: Ints
    count: Ints  # samples behind each point
    displacement_enu_m: Floats
    velocity_enu_m_s: Floats
    acceleration_enu_m_s2: Floats
    sigma_displacement_enu_m: Floats
    summary: MotionSummary | None = None
    blocks: tuple["BlockHead", ...] = ()
    attitude_rad: Floats | None = None  # (n, 3) roll, pitch, heading; None: no sample has one, or buckets
    sigma_attitude_rad: Floats | None = None
    next_start_gps_ns: int | None = None  # where to read on, when the span holds more than was asked for


@dataclass(frozen=True, slots=True)
class BlockHead:
    """A stored motion block without its samples."""

    t_first_gps_ns: int
    n: int
    interval_ns: int
    status: str
    revision: int
    reason: str = ""


@dataclass(frozen=True, slots=True)
class AlertNote:
    """One entry of an alert's history."""

    t_gps_ns: int  # event time for "active" and "cleared", wall clock for what people did
    kind: str  # "active", "cleared", "acknowledged", "comment"
    by: str = ""
    text: str = ""
    value: float | None = None


@dataclass(frozen=True, slots=True)
class AlertRow:
    """An alert and its life."""

    alert_id: str
    station: str
    threshold_id: str
    quantity: str
    severity: Severity
    level: float
    value: float  # at the crossing
    text: str
    t_onset_gps_ns: int
    t_active_gps_ns: int
    t_acknowledged_gps_ns: int | None = None
    acknowledged_by: str = ""
    t_cleared_gps_ns: int | None = None
    history: tuple[AlertNote, ...] = field(default=())

    @property
    def state(self) -> AlertState:
        """Cleared as soon as the quantity is back, acknowledged or not; else acknowledged or active."""
        if self.t_cleared_gps_ns is not None:
            return AlertState.CLEARED
        return AlertState.ACTIVE if self.t_acknowledged_gps_ns is None else AlertState.ACKNOWLEDGED


@dataclass(frozen=True, slots=True)
class Device:
    """A device that talked to the server and was not known, and what became of it."""

    identity: str  # the first bytes it sent, as text with \\xNN escapes: usable as a station's `registrations` entry
    address: str
    first_seen_gps_ns: int
    last_seen_gps_ns: int
    attempts: int = 1
    reason: str = ""
    station: str | None = None  # set once it is adopted
