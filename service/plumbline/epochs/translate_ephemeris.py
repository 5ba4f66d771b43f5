"""Ephemeris messages → records, and back: full weeks, GPS time, one meaning of every sign.

Weeks: 1019, 1041 and 1044 count GPS weeks modulo 1024, 1042 BDT's weeks, 1045 and 1046 GST's; some encoders send the
GPS week in 1042, 1045 or 1046. Where the stream's own time lies in the week sent, or within a day of it, that time
decides, since toe may lie in the week after the week sent; else (a receive clock that is far off, a recording) the week
sent decides, read in the way that lies nearest.

GLONASS health is the first bit of B_n alone: receivers fill in l_n at will (``str-2018-195`` holds satellites
that one receiver's l_n calls healthy and the other's does not).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, Final

from plumbline.constants import (
    BDT_BEHIND_GPST_S,
    BDT_WEEK_BEHIND_GPS_WEEK,
    GLONASS_TIME_AHEAD_OF_UTC_S,
    GST_WEEK_BEHIND_GPS_WEEK,
)
from plumbline.errors import ContractError
from plumbline.gps_time import (
    DAY_NS,
    NS_PER_S,
    WEEK_NS,
    gps_ns_from_utc,
    nearest_ns,
    resolve_glonass_ms,
    resolve_week,
    utc_from_gps,
    utc_ns_from_gps,
    week_and_tow_ns,
)
from plumbline.records import Ephemeris, GlonassEphemeris, KeplerEphemeris
from plumbline.rtcm3.fields import Fields, Message
from plumbline.signals import System, number_of, satellite_id, system_of


@dataclass(frozen=True, slots=True)
class Rejected:
    """Why a message gave no record; counted under its reason."""

    reason: str


@dataclass(frozen=True, slots=True)
class _Kind:
    """How the weeks and satellite numbers of a Keplerian message are to be read."""

    system: System
    message: str
    week_offsets: tuple[int, ...]  # GPS week = week sent + offset; the first is the standard's
    week_modulus: int
    issue: str
    issue_clock: str
    time_offset_s: int = 0
    number_bits: int = 6


_GST: Final = (GST_WEEK_BEHIND_GPS_WEEK, 0)
KINDS: Final[Mapping[int, _Kind]] = {
    1019: _Kind(System.GPS, "LNAV", (0,), 1024, "iode", "iodc"),
    1041: _Kind(System.NAVIC, "LNAV", (GST_WEEK_BEHIND_GPS_WEEK,), 1024, "iodec", "iodec"),
    1042: _Kind(System.BEIDOU, "D1", (BDT_WEEK_BEHIND_GPS_WEEK, 0), 8192, "aode", "aodc", BDT_BEHIND_GPST_S),
    1044: _Kind(System.QZSS, "LNAV", (0,), 1024, "iode", "iodc", number_bits=4),
    1045: _Kind(System.GALILEO, "FNAV", _GST, 4096, "iodnav", "iodnav"),
    1046: _Kind(System.GALILEO, "INAV", _GST, 4096, "iodnav", "iodnav"),
}
GLONASS_NUMBER: Final = 1020
NUMBERS: Final = frozenset({*KINDS, GLONASS_NUMBER})

_ORBIT_FIELDS: Final = (
    "clock_bias_s",
    "clock_drift_s_s",
    "clock_drift_rate_s_s2",
    "sqrt_semi_major_axis_sqrt_m",
    "eccentricity",
    "mean_anomaly_rad",
    "mean_motion_difference_rad_s",
    "inclination_rad",
    "inclination_rate_rad_s",
    "ascending_node_rad",
    "ascending_node_rate_rad_s",
    "argument_of_perigee_rad",
    "cuc_rad",
    "cus_rad",
    "crc_m",
    "crs_m",
    "cic_rad",
    "cis_rad",
)
_BEIDOU_GEO_NUMBERS: Final = frozenset({*range(1, 6), *range(59, 64)})
_SQRT_A_RANGE: Final = (4500.0, 7500.0)  # medium orbits 5050…5440, geosynchronous 6493 √m
_RADIUS_RANGE_M: Final = (2.4e7, 2.7e7)  # GLONASS flies at 25,510 km
_QUARTER_MS: Final = 900_000
_FOUR_YEARS_DAYS: Final = 1461
_GLONASS_EPOCH: Final = datetime(1996, 1, 1, tzinfo=UTC)


def ephemeris_from_message(
    message: Message, t_receive_ns: int, t_near_gps_ns: int | None = None
) -> Ephemeris | Rejected:
    """Record of a 1019, 1020, 1041, 1042, 1044, 1045 or 1046.

    ``t_near_gps_ns`` is the stream's own time where it is known to differ from the receive time (a replayed recording).
    """
    near_ns = t_receive_ns if t_near_gps_ns is None else t_near_gps_ns
    if message.number == GLONASS_NUMBER:
        return _glonass(message.fields, t_receive_ns, near_ns)
    kind = KINDS.get(message.number)
    if kind is None:
        return Rejected("not_an_ephemeris")
    return _kepler(kind, message.fields, t_receive_ns, near_ns)


# --------------------------------------------------------------------------------------------- Kepler


def _kepler(kind: _Kind, f: Fields, t_receive_ns: int, near_ns: int) -> KeplerEphemeris | Rejected:
    number = f["satellite"]
    if number < 1:
        return Rejected("satellite_out_of_range")
    if not _SQRT_A_RANGE[0] < f["sqrt_semi_major_axis_sqrt_m"] < _SQRT_A_RANGE[1] or f["eccentricity"] >= 0.5:
        return Rejected("implausible_orbit")
    toe_of_week_ns = round(f["toe_s"] * NS_PER_S)
    toc_of_week_ns = round(f["toc_s"] * NS_PER_S)
    if not (toe_of_week_ns < WEEK_NS and toc_of_week_ns < WEEK_NS):
        return Rejected("time_of_week_out_of_range")
    toe_ns = _toe_gps_ns(kind, f["week"], toe_of_week_ns, near_ns)
    return KeplerEphemeris(
        satellite=satellite_id(kind.system, number),
        message="D2" if kind.system is System.BEIDOU and number in _BEIDOU_GEO_NUMBERS else kind.message,
        t_receive_ns=t_receive_ns,
        toe_gps_ns=toe_ns,
        toc_gps_ns=nearest_ns(toc_of_week_ns + kind.time_offset_s * NS_PER_S, WEEK_NS, toe_ns),
        issue=f[kind.issue],
        issue_clock=f[kind.issue_clock],
        group_delay_s=_group_delay(kind, f),
        health=_HEALTH[kind.system, kind.message](f),
        accuracy_index=f["accuracy_index"],
        fit_interval_h=_fit_interval_h(kind.system, f),
        **{name: f[name] for name in _ORBIT_FIELDS},
    )


def _toe_gps_ns(kind: _Kind, week: int, toe_of_week_ns: int, near_ns: int) -> int:
    """Reference time: by the stream's time where that lies in the week sent or within a day of it, else by the week."""
    weeks = [resolve_week(week + offset, kind.week_modulus, near_ns) for offset in kind.week_offsets]
    best = min(weeks, key=lambda candidate: abs(candidate - near_ns // WEEK_NS))
    remainder_ns = toe_of_week_ns + kind.time_offset_s * NS_PER_S
    if best in ((near_ns - DAY_NS) // WEEK_NS, near_ns // WEEK_NS, (near_ns + DAY_NS) // WEEK_NS):
        return nearest_ns(remainder_ns, WEEK_NS, near_ns)
    return best * WEEK_NS + remainder_ns


def _group_delay(kind: _Kind, f: Fields) -> tuple[float, float]:
    if kind.system is System.BEIDOU:
        return f["group_delay_1_s"], f["group_delay_2_s"]
    if kind.system is System.GALILEO:
        return f["group_delay_e5a_s"], f.get("group_delay_e5b_s", 0.0)
    return f["group_delay_s"], 0.0


_HEALTH: Final[Mapping[tuple[System, str], Callable[[Fields], int]]] = {
    (System.GPS, "LNAV"): lambda f: int(f["health"]),
    (System.QZSS, "LNAV"): lambda f: int(f["health"]),
    (System.NAVIC, "LNAV"): lambda f: f["l5_unhealthy"] << 1 | f["s_unhealthy"],
    (System.BEIDOU, "D1"): lambda f: int(f["unhealthy"]),
    (System.GALILEO, "FNAV"): lambda f: f["e5a_health"] << 1 | f["e5a_without_guarantee"],
    (System.GALILEO, "INAV"): lambda f: (
        f["e5b_health"] << 4 | f["e5b_without_guarantee"] << 3 | f["e1b_health"] << 1 | f["e1b_without_guarantee"]
    ),
}


def _fit_interval_h(system: System, f: Fields) -> float:
    """Curve fit interval (IS-GPS-200, 20.3.3.4.3.1 and table 20-XII; IS-QZSS-PNT, 5.4.3.1): the least that is meant."""
    if system is System.QZSS:
        return 4.0 if f["fit_interval_longer"] else 2.0
    if system is System.GPS:
        return 6.0 if f["fit_interval_longer"] else 4.0
    return 0.0


# --------------------------------------------------------------------------------------------- GLONASS


def _glonass(f: Fields, t_receive_ns: int, near_ns: int) -> GlonassEphemeris | Rejected:
    position_m = (f["position_x_m"], f["position_y_m"], f["position_z_m"])
    if f["satellite"] < 1:
        return Rejected("satellite_out_of_range")
    if not -7 <= f["frequency_channel"] <= 6:
        return Rejected("frequency_channel_out_of_range")
    if not _RADIUS_RANGE_M[0] < math.hypot(*position_m) < _RADIUS_RANGE_M[1]:
        return Rejected("implausible_orbit")
    if not 1 <= f["tb"] <= 95:
        return Rejected("time_of_day_out_of_range")
    return GlonassEphemeris(
        satellite=satellite_id(System.GLONASS, f["satellite"]),
        t_receive_ns=t_receive_ns,
        toe_gps_ns=resolve_glonass_ms(None, f["tb"] * _QUARTER_MS, _glonass_near_ns(f, near_ns)),
        issue=f["tb"],
        frequency_channel=f["frequency_channel"],
        position_pz90_m=position_m,
        velocity_pz90_m_s=(f["velocity_x_m_s"], f["velocity_y_m_s"], f["velocity_z_m_s"]),
        acceleration_pz90_m_s2=(f["acceleration_x_m_s2"], f["acceleration_y_m_s2"], f["acceleration_z_m_s2"]),
        clock_bias_s=-f["tau_s"],
        frequency_bias=f["gamma"],
        group_delay_s=f["delta_tau_s"],
        health=int(f["bn_unhealthy"]),
        age_days=f["age_days"],
    )


def _glonass_near_ns(f: Fields, near_ns: int) -> int:
    """The stream's time, or the frame's own date and time of day where the message has them and they are days apart."""
    if f["n4"] < 1 or not 1 <= f["nt"] <= _FOUR_YEARS_DAYS:
        return near_ns
    tk = f["tk"]
    days = (f["n4"] - 1) * _FOUR_YEARS_DAYS + f["nt"] - 1
    of_day = timedelta(hours=tk >> 7, minutes=tk >> 1 & 0x3F, seconds=-GLONASS_TIME_AHEAD_OF_UTC_S)
    own_ns = gps_ns_from_utc(_GLONASS_EPOCH + timedelta(days=days) + of_day)
    return own_ns if abs(own_ns - near_ns) > 2 * DAY_NS else near_ns


# --------------------------------------------------------------------------------------------- and back


def message_from_ephemeris(ephemeris: Ephemeris) -> Message:
    """The message that carries an ephemeris; what the record does not hold (flags, codes on L2) is zero."""
    if isinstance(ephemeris, GlonassEphemeris):
        return Message(GLONASS_NUMBER, _glonass_fields(ephemeris))
    system = system_of(ephemeris.satellite)
    for number, kind in KINDS.items():
        if kind.system is system and (system is not System.GALILEO or kind.message == ephemeris.message):
            return Message(number, _kepler_fields(kind, ephemeris))
    raise ContractError(f"no message carries {ephemeris.message} of {system.name}")


def _kepler_fields(kind: _Kind, e: KeplerEphemeris) -> dict[str, Any]:
    week, toe_ns = week_and_tow_ns(e.toe_gps_ns - kind.time_offset_s * NS_PER_S)
    toc_ns = (e.toc_gps_ns - kind.time_offset_s * NS_PER_S) % WEEK_NS
    fields: dict[str, Any] = {name: getattr(e, name) for name in _ORBIT_FIELDS}
    fields |= {
        "satellite": number_of(e.satellite),
        "week": (week - kind.week_offsets[0]) % kind.week_modulus,
        "toe_s": toe_ns / NS_PER_S,
        "toc_s": toc_ns / NS_PER_S,
        "accuracy_index": e.accuracy_index,
        kind.issue: e.issue,
        kind.issue_clock: e.issue_clock,
    }
    return fields | _wrapped_angles(e) | _FLAGS[kind.system, kind.message](e)


def _wrapped_angles(e: KeplerEphemeris) -> dict[str, float]:
    """The angles in −π … +π: RINEX files hold them in either half."""
    names = ("mean_anomaly_rad", "ascending_node_rad", "argument_of_perigee_rad", "inclination_rad")
    return {name: _wrapped(getattr(e, name)) for name in names}


def _wrapped(angle_rad: float) -> float:
    """An angle in −π ≤ angle < π that a 32-bit field can hold, unchanged where it lies there already."""
    if -math.pi <= angle_rad < math.pi - 2.0**-32:
        return angle_rad
    wrapped = math.remainder(angle_rad, 2.0 * math.pi)
    return -math.pi if wrapped >= math.pi - 2.0**-32 else wrapped


def _qzss_flags(e: KeplerEphemeris) -> dict[str, Any]:
    return {
        "group_delay_s": e.group_delay_s[0],
        "health": e.health,
        "code_on_l2": 0,
        "fit_interval_longer": e.fit_interval_h > 2.0,
    }


def _gps_flags(e: KeplerEphemeris) -> dict[str, Any]:
    return _qzss_flags(e) | {"l2_p_data_off": False, "fit_interval_longer": e.fit_interval_h > 4.0}


def _navic_flags(e: KeplerEphemeris) -> dict[str, Any]:
    return {
        "group_delay_s": e.group_delay_s[0],
        "l5_unhealthy": bool(e.health & 2),
        "s_unhealthy": bool(e.health & 1),
        "reserved": 0,
        "spare_after_idot": 0,
        "spare_after_i0": 0,
    }


def _beidou_flags(e: KeplerEphemeris) -> dict[str, Any]:
    return {
        "group_delay_1_s": e.group_delay_s[0],
        "group_delay_2_s": e.group_delay_s[1],
        "unhealthy": e.health != 0,
    }


def _fnav_flags(e: KeplerEphemeris) -> dict[str, Any]:
    return {
        "group_delay_e5a_s": e.group_delay_s[0],
        "e5a_health": e.health >> 1 & 3,
        "e5a_without_guarantee": bool(e.health & 1),
        "reserved": 0,
    }


def _inav_flags(e: KeplerEphemeris) -> dict[str, Any]:
    return {
        "group_delay_e5a_s": e.group_delay_s[0],
        "group_delay_e5b_s": e.group_delay_s[1],
        "e5b_health": e.health >> 4 & 3,
        "e5b_without_guarantee": bool(e.health & 8),
        "e1b_health": e.health >> 1 & 3,
        "e1b_without_guarantee": bool(e.health & 1),
        "reserved": 0,
    }


_FLAGS: Final[Mapping[tuple[System, str], Callable[[KeplerEphemeris], dict[str, Any]]]] = {
    (System.GPS, "LNAV"): _gps_flags,
    (System.QZSS, "LNAV"): _qzss_flags,
    (System.NAVIC, "LNAV"): _navic_flags,
    (System.BEIDOU, "D1"): _beidou_flags,
    (System.GALILEO, "FNAV"): _fnav_flags,
    (System.GALILEO, "INAV"): _inav_flags,
}


def _glonass_fields(e: GlonassEphemeris) -> dict[str, Any]:
    moscow = utc_from_gps(e.toe_gps_ns) + timedelta(seconds=GLONASS_TIME_AHEAD_OF_UTC_S)
    four_years, day = divmod((moscow - _GLONASS_EPOCH).days, _FOUR_YEARS_DAYS)
    quarters = (utc_ns_from_gps(e.toe_gps_ns) + GLONASS_TIME_AHEAD_OF_UTC_S * NS_PER_S) % DAY_NS // (900 * NS_PER_S)
    fields: dict[str, Any] = {
        "satellite": number_of(e.satellite),
        "frequency_channel": e.frequency_channel,
        "almanac_healthy": e.health == 0,
        "almanac_health_available": True,
        "tk": moscow.hour << 7 | moscow.minute << 1,
        "bn_unhealthy": e.health != 0,
        "tb": quarters,
        "gamma": e.frequency_bias,
        "ln_third_string": e.health != 0,
        "tau_s": -e.clock_bias_s,
        "delta_tau_s": e.group_delay_s,
        "age_days": e.age_days,
        "nt": day + 1,
        "n4": four_years + 1,
        "m": 1,  # GLONASS-M
    }
    for axis, position, velocity, acceleration in zip(
        "xyz", e.position_pz90_m, e.velocity_pz90_m_s, e.acceleration_pz90_m_s2, strict=True
    ):
        fields |= {
            f"position_{axis}_m": position,
            f"velocity_{axis}_m_s": velocity,
            f"acceleration_{axis}_m_s2": acceleration,
        }
    return {**fields, **_GLONASS_NOT_KEPT}


_GLONASS_NOT_KEPT: Final[Mapping[str, Any]] = {
    "p1": 0,
    "p2": False,
    "p3": True,
    "p": 0,
    "p4": False,
    "ft": 0,
    "additional_data": False,
    "na": 0,
    "tau_c_s": 0.0,
    "tau_gps_s": 0.0,
    "ln_fifth_string": False,
    "reserved": 0,
}
