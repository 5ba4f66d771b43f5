"""A station's facts from its settings: the files that they name are read here, once."""

from pathlib import Path

from plumbline.config import StationSettings
from plumbline.errors import ConfigurationError
from plumbline.files.antex import read_antex
from plumbline.files.blq import read_blq
from plumbline.gnss.antenna import AntennaBook, build_antenna_book, empty_antenna_book, find_receiver
from plumbline.positioning.facts import OceanLoading, StationFacts


def facts_of(settings: StationSettings, t_gps_ns: int, antenna_type: str = "") -> StationFacts:
    """Facts at a time (satellite antennas change); ``antenna_type`` is the stream's own, used if settings give none.

    Raises FileFormatError or ConfigurationError for files that cannot be used.
    """
    return StationFacts(
        station=settings.station,
        reference_position_ecef_m=settings.reference_position_ecef_m,
        antenna_offset_enu_m=(0.0, 0.0, settings.antenna_height_m),
        ocean_loading=_ocean_loading(settings),
        antennas=_antennas(settings, t_gps_ns, settings.antenna_type or antenna_type),
    )


def _ocean_loading(settings: StationSettings) -> OceanLoading | None:
    if settings.ocean_loading_blq is None:
        return None
    table = read_blq(Path(settings.ocean_loading_blq)).get(settings.station.upper())
    if table is None:
        raise ConfigurationError(f"{settings.ocean_loading_blq} has no station {settings.station}")
    return OceanLoading(table.amplitude_m, table.phase_rad)


def _antennas(settings: StationSettings, t_gps_ns: int, antenna_type: str) -> AntennaBook:
    if settings.antex is None:
        return empty_antenna_book()
    calibrations = read_antex(Path(settings.antex))
    receiver = find_receiver(calibrations, antenna_type) if antenna_type else None
    return build_antenna_book(calibrations, t_gps_ns, receiver)
