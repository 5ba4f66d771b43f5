"""From SI, radians and GPS nanoseconds to what people read: millimetres, degrees, ISO 8601 UTC; and back."""

import math
from datetime import UTC, datetime
from typing import Annotated, Final

import numpy as np
from pydantic import AfterValidator, AwareDatetime

from plumbline.alerts.quantities import unit_of
from plumbline.config import Vector3
from plumbline.gnss.earth_frames import ecef_from_geodetic, geodetic_from_ecef
from plumbline.gps_time import GPS_EPOCH_UTC, gps_ns_from_utc, unix_ns_from_gps, utc_from_gps
from plumbline.records import Floats, Ints

_LATEST: Final = datetime(2200, 1, 1, tzinfo=UTC)  # 64 bits of nanoseconds reach a little further

_SCALES: Final = {"m": (1e3, "mm"), "m/s": (1e3, "mm/s"), "m/s²": (1e3, "mm/s²")}


def _in_range(moment: datetime) -> datetime:
    moment = moment.astimezone(UTC)
    if not GPS_EPOCH_UTC <= moment < _LATEST:
        raise ValueError(f"times lie between {GPS_EPOCH_UTC.year} and {_LATEST.year}")
    return moment


#: A time as a request gives it: ISO 8601 with its zone.
Moment = Annotated[AwareDatetime, AfterValidator(_in_range)]


def iso(t_gps_ns: int) -> str:
    """ISO 8601 UTC of a GPS time, to the microsecond, without needless zeros."""
    moment = utc_from_gps(t_gps_ns)
    text = moment.isoformat(timespec="milliseconds" if moment.microsecond % 1000 == 0 else "microseconds")
    return text.replace("+00:00", "Z")


def iso_or_none(t_gps_ns: int | None) -> str | None:
    """:func:`iso`, None for None."""
    return None if t_gps_ns is None else iso(t_gps_ns)


def iso_all(t_gps_ns: Ints) -> list[str]:
    """:func:`iso` of many ascending times; quick where no leap second lies between."""
    if not len(t_gps_ns):
        return []
    shift = unix_ns_from_gps(int(t_gps_ns[0])) - int(t_gps_ns[0])
    if unix_ns_from_gps(int(t_gps_ns[-1])) - int(t_gps_ns[-1]) != shift:
        return [iso(int(t)) for t in t_gps_ns]
    microseconds = (t_gps_ns + shift + 500) // 1000
    moments = microseconds.astype("datetime64[us]")
    texts: list[str] = np.datetime_as_string(moments, unit="ms" if not np.any(microseconds % 1000) else "us").tolist()
    return [text + "Z" for text in texts]


def gps_ns(moment: datetime | None) -> int | None:
    """GPS time of a request's time."""
    return None if moment is None else gps_ns_from_utc(moment)


def scaled(value: float | None, scale: float = 1.0, digits: int = 3) -> float | None:
    """A number in another unit, rounded; None for what is missing or not finite."""
    if value is None or not math.isfinite(value):
        return None
    return round(value * scale, digits)


def column(values: Floats, scale: float = 1e3, digits: int = 2) -> list[float | None]:
    """An array (n,) in another unit (metres to millimetres), rounded; None where not finite."""
    numbers: list[float | None] = np.round(values * scale, digits).tolist()
    for i in np.flatnonzero(~np.isfinite(values)):
        numbers[i] = None
    return numbers


def degrees_and_height(position_ecef_m: Vector3) -> tuple[float, float, float]:
    """Latitude and longitude, degrees, and ellipsoidal height, m, of an Earth-fixed position."""
    latitude, longitude, height_m = geodetic_from_ecef(np.array(position_ecef_m)).tolist()
    return round(math.degrees(latitude), 10), round(math.degrees(longitude), 10), round(height_m, 5)


def ecef_of_degrees(latitude_deg: float, longitude_deg: float, height_m: float) -> Vector3:
    """Earth-fixed position, m, of degrees and ellipsoidal height."""
    position = ecef_from_geodetic(math.radians(latitude_deg), math.radians(longitude_deg), height_m)
    x, y, z = (round(number, 5) for number in position.tolist())
    return x, y, z


def warm_up() -> None:
    """Load the compiled kernels before the first request waits for them."""
    degrees_and_height(ecef_of_degrees(0.0, 0.0, 0.0))


def unit_of_quantity(quantity: str) -> tuple[float, str]:
    """The factor from SI and the unit in which the API gives a threshold's quantity (unknown: as it is)."""
    unit = unit_of(quantity)
    return _SCALES.get(unit, (1.0, unit))


def from_si(quantity: str, value: float) -> float:
    """A threshold's value in the API's unit, free of the rounding of the scaling."""
    scale, _ = unit_of_quantity(quantity)
    return value if scale == 1.0 or not math.isfinite(value) else float(f"{value * scale:.12g}")


def to_si(quantity: str, value: float) -> float:
    """Inverse of :func:`from_si`."""
    return value / unit_of_quantity(quantity)[0]
