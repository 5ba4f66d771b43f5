"""What requests and responses look like: millimetres, degrees, ISO 8601 UTC, as their names say."""

from typing import Annotated, Generic, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, model_validator

from plumbline.config import DeviceSettings, StationId, StationSettings
from plumbline.records import AlertState, Severity, Status

T = TypeVar("T")

IsoTime = Annotated[str, Field(json_schema_extra={"format": "date-time"}, examples=["2026-01-01T00:00:00.000Z"])]
Text500 = Annotated[str, Field(max_length=500)]
Text100 = Annotated[str, Field(max_length=100)]
Coordinate = Annotated[float, Field(ge=-1e8, le=1e8)]
Level = Annotated[float, Field(ge=-1e9, le=1e9)]
Delay = Annotated[float, Field(ge=0, le=1e7)]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Listing(BaseModel, Generic[T]):
    """A part of a list."""

    items: list[T]
    next: str | None = Field(None, description="give it as `cursor` for the part after this; null at the end")


# --------------------------------------------------------------------------------------------- stations


class StatusOut(BaseModel):
    """A station's health in one look."""

    station: str
    state: Literal["waiting", "receiving", "silent"] = Field(description="receiving: epochs are being decoded")
    reason: str = Field(description="empty when all is well; else what a user can act on")
    time: IsoTime | None = Field(None, description="receive time of the last input behind this")
    last_epoch: IsoTime | None = None
    solution_status: Status | None = None
    n_satellites: int = 0
    counters: dict[str, int] = Field({}, description="messages and rejected bytes by reason")


class StationCreate(StationSettings):
    """A station's settings; its reference position Earth-fixed, or in degrees and ellipsoidal height (WGS 84)."""

    reference_position_ecef_m: tuple[Coordinate, Coordinate, Coordinate] | None = None
    latitude_deg: float | None = Field(None, ge=-90, le=90)
    longitude_deg: float | None = Field(None, ge=-180, le=360)
    height_m: float | None = Field(None, ge=-1e6, le=1e8)

    @model_validator(mode="after")
    def _one_position(self) -> Self:
        given = [value is not None for value in (self.latitude_deg, self.longitude_deg, self.height_m)]
        if any(given) and not all(given):
            raise ValueError("latitude_deg, longitude_deg and height_m go together")
        if any(given) and self.reference_position_ecef_m is not None:
            raise ValueError("give the position in degrees or Earth-fixed, not both")
        return self


class DeviceOut(DeviceSettings):
    """A device's settings; the token itself is never shown."""

    token: None = None
    has_token: bool


class StationOut(StationSettings):
    """A station, its position in both forms, and its status."""

    device: DeviceOut
    latitude_deg: float | None
    longitude_deg: float | None
    height_m: float | None = Field(description="above the WGS 84 ellipsoid")
    version: int = Field(description="one more at every change; also the ETag")
    created: IsoTime
    changed: IsoTime
    status: StatusOut


# --------------------------------------------------------------------------------------------- series


class SolutionOut(BaseModel):
    """The position of a station at one epoch, or the reason why there is none."""

    station: str
    time: IsoTime
    status: Status
    reason: str
    n_satellites: int
    systems: str = Field(description="letters of the systems used: GREJCI")
    east_mm: float | None = Field(description="displacement from the reference position")
    north_mm: float | None
    up_mm: float | None
    sigma_east_mm: float | None
    sigma_north_mm: float | None
    sigma_up_mm: float | None
    velocity_east_mm_s: float | None
    velocity_north_mm_s: float | None
    velocity_up_mm_s: float | None
    latitude_deg: float | None
    longitude_deg: float | None
    height_m: float | None
    zenith_delay_mm: float | None
    receiver_clock_ns: float | None
    correction_age_s: float | None
    pdop: float | None
    roll_deg: float | None = Field(None, description="right side down; of a platform with several antennas or an IMU")
    pitch_deg: float | None = Field(None, description="forward axis above the horizon")
    heading_deg: float | None = Field(None, description="of the forward axis, clockwise from north, 0 to 360")
    sigma_roll_deg: float | None = None
    sigma_pitch_deg: float | None = None
    sigma_heading_deg: float | None = None
    extras: dict[str, float | None] = {}


class BlockOut(BaseModel):
    """A block of samples as it was computed; a higher revision has replaced the lower."""

    time: IsoTime
    n: int
    interval_s: float
    status: Status
    reason: str
    revision: int


Column = list[float | None]


class MotionOut(BaseModel):
    """Motion in columns. With `bucket_s` 0 samples; else means, and `*_min_*`, `*_max_*`, `*_rms_*` beside each.

    Samples of a platform with an IMU have its attitude in further columns: `roll_deg`, `pitch_deg`, `heading_deg`,
    `sigma_roll_deg`, `sigma_pitch_deg`, `sigma_heading_deg`.
    """

    model_config = ConfigDict(extra="allow")

    station: str
    bucket_s: float = Field(description="0: samples; else the length of the interval that each point sums up")
    next_start: IsoTime | None = Field(description="where to read on when the span holds more than was asked for")
    time: list[IsoTime] = Field(description="of the sample, or of the interval's start")
    count: list[int] = Field(description="samples behind each point")
    east_mm: Column
    north_mm: Column
    up_mm: Column
    velocity_east_mm_s: Column
    velocity_north_mm_s: Column
    velocity_up_mm_s: Column
    acceleration_east_mm_s2: Column
    acceleration_north_mm_s2: Column
    acceleration_up_mm_s2: Column
    sigma_east_mm: Column
    sigma_north_mm: Column
    sigma_up_mm: Column
    blocks: list[BlockOut] = Field(description="where samples came from; empty for intervals")


# --------------------------------------------------------------------------------------------- thresholds, alerts


class ThresholdCreate(_Body):
    """When a quantity of a station is alarming. `level` and `dead_band` are in `unit`, which may be left out."""

    threshold_id: StationId
    station: StationId
    quantity: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$", examples=["displacement_horizontal"])]
    level: Level
    unit: str | None = Field(None, description="mm, mm/s or mm/s² by quantity; SI is refused", examples=["mm"])
    severity: Severity = Severity.ALARM
    on_delay_s: Delay = 0.0
    off_delay_s: Delay = 0.0
    dead_band: Annotated[float, Field(ge=0, le=1e9)] = 0.0
    enabled: bool = True


class ThresholdChange(_Body):
    """The fields of a threshold to change."""

    quantity: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")] | None = None
    level: Level | None = None
    unit: str | None = None
    severity: Severity | None = None
    on_delay_s: Delay | None = None
    off_delay_s: Delay | None = None
    dead_band: Annotated[float, Field(ge=0, le=1e9)] | None = None
    enabled: bool | None = None


class ThresholdOut(ThresholdCreate):
    """A threshold."""

    unit: str
    quantity: str
    level: float
    dead_band: float
    on_delay_s: float
    off_delay_s: float


class NoteOut(BaseModel):
    """One entry of an alert's history."""

    time: IsoTime
    kind: Literal["active", "acknowledged", "cleared", "comment"]
    by: str
    text: str
    value: float | None


AlertKind = Literal["motion", "data"]


class AlertOut(BaseModel):
    """An alert and its life, in event time."""

    alert_id: str
    station: str
    threshold_id: str
    kind: AlertKind = Field(description="motion: of the structure; data: of the station's data, not the structure's")
    quantity: str
    unit: str
    severity: Severity
    state: AlertState
    level: float
    value: float | None = Field(description="at the crossing")
    text: str
    onset: IsoTime = Field(description="when the quantity crossed the level; the on-delay begins here")
    active_since: IsoTime
    acknowledged_at: IsoTime | None
    acknowledged_by: str
    cleared_at: IsoTime | None
    history: list[NoteOut] = []


class AlertEventOut(BaseModel):
    """An alert becomes active or is cleared, as it happens."""

    alert_id: str
    station: str
    threshold_id: str
    kind: AlertKind = Field(description="motion: of the structure; data: of the station's data, not the structure's")
    quantity: str
    unit: str
    severity: Severity
    state: AlertState
    level: float
    value: float | None
    text: str
    time: IsoTime
    onset: IsoTime


class Acknowledgement(_Body):
    """Who has seen an alert."""

    by: Text100 = ""
    comment: Text500 = ""


class Comment(_Body):
    """What somebody says of an alert."""

    by: Text100 = ""
    text: Annotated[str, Field(min_length=1, max_length=2000)]


# --------------------------------------------------------------------------------------------- devices, operations


class UnknownDevice(BaseModel):
    """A device that talked to the server without being known, and whose it became."""

    device_id: str = Field(description="a short name of the identity, for addresses")
    identity: str = Field(description="its first bytes, `\\xNN` for what is not printable")
    address: str
    first_seen: IsoTime
    last_seen: IsoTime
    attempts: int
    reason: str
    station: str | None = Field(description="the station that it was adopted for")


class Adoption(_Body):
    """The station that a device is to belong to; it must exist."""

    station: StationId


class Health(BaseModel):
    """The server answers."""

    status: Literal["alive", "ready"]
