"""What quality, availability and explanations look like in responses."""

from typing import Literal

from pydantic import BaseModel, Field

from plumbline.api.schemas import IsoTime


class ObservationQualityOut(BaseModel):
    """One observation of an epoch."""

    satellite: str = Field(examples=["G05"])
    kind: Literal["code", "phase"]
    signals: list[str] = Field(examples=[["C1C", "C2W"]])
    residual_mm: float | None = Field(description="measured less predicted")
    sigma_mm: float | None
    redundancy: float | None = Field(description="0: nothing checks it, 1: all of an error shows")
    mdb_mm: float | None = Field(description="minimal detectable bias")
    w: float | None = Field(description="w-test, standard normal without an error")
    qdop: float | None
    elevation_deg: float | None
    azimuth_deg: float | None
    external_east_mm: float | None = Field(description="what an error of the MDB does to the position")
    external_north_mm: float | None
    external_up_mm: float | None
    rejected: bool
    reason: str


class QualityOut(BaseModel):
    """What an epoch's solution is worth."""

    station: str
    time: IsoTime
    tests: dict[str, float | None]
    hdop: float | None
    vdop: float | None
    pdop: float | None
    protection_horizontal_mm: float | None = Field(description="bounds the position's error at the integrity risk")
    protection_vertical_mm: float | None
    integrity_risk: float
    events: list[str]
    observations: list[ObservationQualityOut]


class GapOut(BaseModel):
    """Epochs that lack, and why."""

    start: IsoTime
    end: IsoTime
    epochs: int
    reason: str


class AvailabilityOut(BaseModel):
    """How much of a UTC day (or the part of it asked for) a station delivered."""

    station: str
    start: IsoTime
    end: IsoTime
    interval_s: float
    expected: int
    received: int
    solved: int
    converged: int
    fixed: int
    loss: dict[str, int] = Field(description="epochs without a converged solution, by reason")
    gaps: list[GapOut]
    latency_s: dict[str, float | None] = Field(description="percentiles")


class FindingOut(BaseModel):
    """One cause of lost or poor epochs."""

    cause: str
    text: str
    advice: str
    share: float = Field(description="of the epochs looked at")


class ExplainOut(BaseModel):
    """Why the last epochs have no solution or a poor one; no findings: all is well."""

    station: str
    epochs: int = Field(description="looked at")
    findings: list[FindingOut]
