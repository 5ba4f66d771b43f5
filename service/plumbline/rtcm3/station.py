"""What a station says of itself: 1005–1008, 1013, 1029, 1033, 1230 as tables, and the description they add up to."""

from dataclasses import replace
from typing import Final

from plumbline.records import AntennaDescription
from plumbline.rtcm3.fields import (
    Fields,
    Group,
    Item,
    Message,
    Table,
    Text,
    Values,
    flag,
    register,
    reserved,
    signed,
    text,
    unsigned,
)

_STATION = unsigned("DF003", "station", 12)
_POSITION: tuple[Item, ...] = (
    _STATION,
    unsigned("DF021", "itrf_realization_year", 6),
    flag("DF022", "gps"),
    flag("DF023", "glonass"),
    flag("DF024", "galileo"),
    flag("DF141", "reference_station"),
    signed("DF025", "x_ecef_m", 38, 1e-4),
    flag("DF142", "single_oscillator"),
    reserved(1),
    signed("DF026", "y_ecef_m", 38, 1e-4),
    unsigned("DF364", "quarter_cycle", 2),
    signed("DF027", "z_ecef_m", 38, 1e-4),
)
_ANTENNA: tuple[Item, ...] = (_STATION, text("DF030", "antenna_type"), unsigned("DF031", "antenna_setup", 8))
_ANTENNA_WITH_SERIAL: tuple[Item, ...] = (*_ANTENNA, text("DF033", "antenna_serial"))

#: RINEX codes of the GLONASS signals of 1230, from the mask's (DF422) highest bit down.
GLONASS_BIAS_CODES: Final = ("1C", "1P", "2C", "2P")


def _n_biases(fields: Fields) -> int:
    return int(fields["signal_mask"]).bit_count()


TABLES: Final = (
    Table(1005, "antenna reference point", _POSITION),
    Table(1006, "antenna reference point and height", (*_POSITION, unsigned("DF028", "antenna_height_m", 16, 1e-4))),
    Table(1007, "antenna descriptor", _ANTENNA),
    Table(1008, "antenna descriptor and serial number", _ANTENNA_WITH_SERIAL),
    Table(
        1013,
        "system parameters",
        (
            _STATION,
            unsigned("DF051", "modified_julian_day", 16),
            unsigned("DF052", "second_of_day", 17),
            unsigned("DF053", "n_announcements", 5),
            unsigned("DF054", "leap_seconds", 8),
            Group(
                "announcements",
                "n_announcements",
                (
                    unsigned("DF055", "message", 12),
                    flag("DF056", "synchronous"),
                    unsigned("DF057", "interval_s", 16, 0.1),
                ),
            ),
        ),
    ),
    Table(
        1029,
        "text",
        (
            _STATION,
            unsigned("DF051", "modified_julian_day", 16),
            unsigned("DF052", "second_of_day", 17),
            unsigned("DF138", "n_characters", 7),
            Text("DF140", "text", "utf-8"),
        ),
    ),
    Table(
        1033,
        "receiver and antenna descriptors",
        (
            *_ANTENNA_WITH_SERIAL,
            text("DF228", "receiver_type"),
            text("DF230", "receiver_firmware"),
            text("DF232", "receiver_serial"),
        ),
    ),
    Table(
        1230,
        "GLONASS code-phase biases",
        (
            _STATION,
            flag("DF421", "aligned"),
            reserved(3),
            unsigned("DF422", "signal_mask", 4),
            Values("biases_m", _n_biases, signed("DF423", "", 16, 0.02, sentinel=-(1 << 15))),
        ),
    ),
)
register(*TABLES)


def glonass_code_biases_m(message: Message) -> dict[str, float]:
    """Code-phase biases of a 1230, metres by RINEX code; signals without a valid bias are left out."""
    named = [code for i, code in enumerate(GLONASS_BIAS_CODES) if message["signal_mask"] & (8 >> i)]
    return {code: bias for code, bias in zip(named, message["biases_m"], strict=True) if bias is not None}


def describe(known: AntennaDescription, message: Message) -> AntennaDescription:
    """What is known of an antenna after one more message of its station (1005–1008, 1033; others add nothing)."""
    fields = message.fields
    if "x_ecef_m" in fields:
        position = (fields["x_ecef_m"], fields["y_ecef_m"], fields["z_ecef_m"])
        if any(position):
            known = replace(known, position_ecef_m=position)
    for name in ("antenna_height_m", "antenna_type", "antenna_serial", "receiver_type"):
        if fields.get(name) not in (None, ""):
            known = replace(known, **{name: fields[name]})
    return known
