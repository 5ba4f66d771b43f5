"""What is known of a station beyond its settings: where it is meant to be and what stands on it."""

from dataclasses import dataclass

from plumbline.records import AntennaCalibration

Vector3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class StationFacts:
    """Facts of one antenna, given by settings, files or the stream itself."""

    station: str
    reference_position_ecef_m: Vector3 | None = None  # of the marker; None: displacements are not given
    antenna_offset_enu_m: Vector3 = (0.0, 0.0, 0.0)  # antenna reference point from the marker, east, north, up
    antenna: AntennaCalibration | None = None  # None: phase centre taken as the antenna reference point
    ocean_loading_blq: str | None = None  # path of a BLQ file; None: no ocean loading
