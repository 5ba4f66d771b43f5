"""What is known of a station beyond its settings: where it is meant to be and what stands on it."""

from dataclasses import dataclass, field

from plumbline.gnss.antenna import AntennaBook, empty_antenna_book
from plumbline.records import Floats

Vector3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class OceanLoading:
    """A BLQ table as :mod:`plumbline.files.blq` reads it: amplitudes (3, 11), m, and phase lags (3, 11), rad."""

    amplitude_m: Floats
    phase_rad: Floats


@dataclass(frozen=True, slots=True)
class StationFacts:
    """Facts of one antenna, given by settings, files or the stream itself."""

    station: str
    reference_position_ecef_m: Vector3 | None = None  # of the marker; None: the first converged position becomes it
    antenna_offset_enu_m: Vector3 = (0.0, 0.0, 0.0)  # antenna reference point from the marker, east, north, up
    ocean_loading: OceanLoading | None = None
    antennas: AntennaBook = field(default_factory=empty_antenna_book)  # satellites' and the receiver's phase centres
