"""Broadcast ephemerides (RTCM 10403.3): 1019 GPS, 1020 GLONASS, 1041 NavIC, 1042 BeiDou, 1044 QZSS, 1045, 1046 Galileo.

Semicircles are scaled to radians here, kilometres (GLONASS) to metres; week numbers and times of week stay as the
message has them: :mod:`plumbline.epochs.translate_ephemeris` resolves them.
"""

import math
from typing import Final

from plumbline.rtcm3.fields import Item, Table, flag, register, sign_magnitude, signed, unsigned

_SEMICIRCLE: Final = math.pi
_KM: Final = 1000.0


def _p2(exponent: int) -> float:
    return 2.0**exponent


def _angle(df: str, name: str, bits: int, exponent: int) -> Item:
    return signed(df, name, bits, _p2(exponent) * _SEMICIRCLE)


GPS: Final = Table(
    1019,
    "GPS ephemeris",
    (
        unsigned("DF009", "satellite", 6),
        unsigned("DF076", "week", 10),
        unsigned("DF077", "accuracy_index", 4),
        unsigned("DF078", "code_on_l2", 2),
        _angle("DF079", "inclination_rate_rad_s", 14, -43),
        unsigned("DF071", "iode", 8),
        unsigned("DF081", "toc_s", 16, 16.0),
        signed("DF082", "clock_drift_rate_s_s2", 8, _p2(-55)),
        signed("DF083", "clock_drift_s_s", 16, _p2(-43)),
        signed("DF084", "clock_bias_s", 22, _p2(-31)),
        unsigned("DF085", "iodc", 10),
        signed("DF086", "crs_m", 16, _p2(-5)),
        _angle("DF087", "mean_motion_difference_rad_s", 16, -43),
        _angle("DF088", "mean_anomaly_rad", 32, -31),
        signed("DF089", "cuc_rad", 16, _p2(-29)),
        unsigned("DF090", "eccentricity", 32, _p2(-33)),
        signed("DF091", "cus_rad", 16, _p2(-29)),
        unsigned("DF092", "sqrt_semi_major_axis_sqrt_m", 32, _p2(-19)),
        unsigned("DF093", "toe_s", 16, 16.0),
        signed("DF094", "cic_rad", 16, _p2(-29)),
        _angle("DF095", "ascending_node_rad", 32, -31),
        signed("DF096", "cis_rad", 16, _p2(-29)),
        _angle("DF097", "inclination_rad", 32, -31),
        signed("DF098", "crc_m", 16, _p2(-5)),
        _angle("DF099", "argument_of_perigee_rad", 32, -31),
        _angle("DF100", "ascending_node_rate_rad_s", 24, -43),
        signed("DF101", "group_delay_s", 8, _p2(-31)),
        unsigned("DF102", "health", 6),
        flag("DF103", "l2_p_data_off"),
        flag("DF137", "fit_interval_longer"),
    ),
)

GLONASS: Final = Table(
    1020,
    "GLONASS ephemeris",
    (
        unsigned("DF038", "satellite", 6),
        unsigned("DF040", "frequency_channel", 5, offset=-7),
        flag("DF104", "almanac_healthy"),
        flag("DF105", "almanac_health_available"),
        unsigned("DF106", "p1", 2),
        unsigned("DF107", "tk", 12),  # 5 bits hours, 6 bits minutes, 1 bit half minute
        flag("DF108", "bn_unhealthy"),
        flag("DF109", "p2"),
        unsigned("DF110", "tb", 7),  # quarters of an hour of the day in UTC + 3 h
        sign_magnitude("DF111", "velocity_x_m_s", 24, _KM * _p2(-20)),
        sign_magnitude("DF112", "position_x_m", 27, _KM * _p2(-11)),
        sign_magnitude("DF113", "acceleration_x_m_s2", 5, _KM * _p2(-30)),
        sign_magnitude("DF114", "velocity_y_m_s", 24, _KM * _p2(-20)),
        sign_magnitude("DF115", "position_y_m", 27, _KM * _p2(-11)),
        sign_magnitude("DF116", "acceleration_y_m_s2", 5, _KM * _p2(-30)),
        sign_magnitude("DF117", "velocity_z_m_s", 24, _KM * _p2(-20)),
        sign_magnitude("DF118", "position_z_m", 27, _KM * _p2(-11)),
        sign_magnitude("DF119", "acceleration_z_m_s2", 5, _KM * _p2(-30)),
        flag("DF120", "p3"),
        sign_magnitude("DF121", "gamma", 11, _p2(-40)),
        unsigned("DF122", "p", 2),
        flag("DF123", "ln_third_string"),
        sign_magnitude("DF124", "tau_s", 22, _p2(-30)),
        sign_magnitude("DF125", "delta_tau_s", 5, _p2(-30)),
        unsigned("DF126", "age_days", 5),
        flag("DF127", "p4"),
        unsigned("DF128", "ft", 4),
        unsigned("DF129", "nt", 11),  # day within the four-year interval, 1 = 1 January of the leap year
        unsigned("DF130", "m", 2),
        flag("DF131", "additional_data"),
        unsigned("DF132", "na", 11),
        sign_magnitude("DF133", "tau_c_s", 32, _p2(-31)),
        unsigned("DF134", "n4", 5),  # number of the four-year interval, 1 = 1996
        sign_magnitude("DF135", "tau_gps_s", 22, _p2(-30)),
        flag("DF136", "ln_fifth_string"),
        unsigned("DF001", "reserved", 7),
    ),
)

NAVIC: Final = Table(
    1041,
    "NavIC ephemeris",
    (
        unsigned("DF516", "satellite", 6),
        unsigned("DF517", "week", 10),
        signed("DF518", "clock_bias_s", 22, _p2(-31)),
        signed("DF519", "clock_drift_s_s", 16, _p2(-43)),
        signed("DF520", "clock_drift_rate_s_s2", 8, _p2(-55)),
        unsigned("DF521", "accuracy_index", 4),
        unsigned("DF522", "toc_s", 16, 16.0),
        signed("DF523", "group_delay_s", 8, _p2(-31)),
        _angle("DF524", "mean_motion_difference_rad_s", 22, -41),
        unsigned("DF525", "iodec", 8),
        unsigned("DF526", "reserved", 10),
        flag("DF527", "l5_unhealthy"),
        flag("DF528", "s_unhealthy"),
        signed("DF529", "cuc_rad", 15, _p2(-28)),
        signed("DF530", "cus_rad", 15, _p2(-28)),
        signed("DF531", "cic_rad", 15, _p2(-28)),
        signed("DF532", "cis_rad", 15, _p2(-28)),
        signed("DF533", "crc_m", 15, _p2(-4)),
        signed("DF534", "crs_m", 15, _p2(-4)),
        _angle("DF535", "inclination_rate_rad_s", 14, -43),
        _angle("DF536", "mean_anomaly_rad", 32, -31),
        unsigned("DF537", "toe_s", 16, 16.0),
        unsigned("DF538", "eccentricity", 32, _p2(-33)),
        unsigned("DF539", "sqrt_semi_major_axis_sqrt_m", 32, _p2(-19)),
        _angle("DF540", "ascending_node_rad", 32, -31),
        _angle("DF541", "argument_of_perigee_rad", 32, -31),
        _angle("DF542", "ascending_node_rate_rad_s", 22, -41),
        _angle("DF543", "inclination_rad", 32, -31),
        unsigned("DF544", "spare_after_idot", 2),
        unsigned("DF545", "spare_after_i0", 2),
    ),
)

BEIDOU: Final = Table(
    1042,
    "BeiDou ephemeris",
    (
        unsigned("DF488", "satellite", 6),
        unsigned("DF489", "week", 13),
        unsigned("DF490", "accuracy_index", 4),
        _angle("DF491", "inclination_rate_rad_s", 14, -43),
        unsigned("DF492", "aode", 5),
        unsigned("DF493", "toc_s", 17, 8.0),
        signed("DF494", "clock_drift_rate_s_s2", 11, _p2(-66)),
        signed("DF495", "clock_drift_s_s", 22, _p2(-50)),
        signed("DF496", "clock_bias_s", 24, _p2(-33)),
        unsigned("DF497", "aodc", 5),
        signed("DF498", "crs_m", 18, _p2(-6)),
        _angle("DF499", "mean_motion_difference_rad_s", 16, -43),
        _angle("DF500", "mean_anomaly_rad", 32, -31),
        signed("DF501", "cuc_rad", 18, _p2(-31)),
        unsigned("DF502", "eccentricity", 32, _p2(-33)),
        signed("DF503", "cus_rad", 18, _p2(-31)),
        unsigned("DF504", "sqrt_semi_major_axis_sqrt_m", 32, _p2(-19)),
        unsigned("DF505", "toe_s", 17, 8.0),
        signed("DF506", "cic_rad", 18, _p2(-31)),
        _angle("DF507", "ascending_node_rad", 32, -31),
        signed("DF508", "cis_rad", 18, _p2(-31)),
        _angle("DF509", "inclination_rad", 32, -31),
        signed("DF510", "crc_m", 18, _p2(-6)),
        _angle("DF511", "argument_of_perigee_rad", 32, -31),
        _angle("DF512", "ascending_node_rate_rad_s", 24, -43),
        signed("DF513", "group_delay_1_s", 10, 1e-10),
        signed("DF514", "group_delay_2_s", 10, 1e-10),
        flag("DF515", "unhealthy"),
    ),
)

QZSS: Final = Table(
    1044,
    "QZSS ephemeris",
    (
        unsigned("DF429", "satellite", 4),
        unsigned("DF430", "toc_s", 16, 16.0),
        signed("DF431", "clock_drift_rate_s_s2", 8, _p2(-55)),
        signed("DF432", "clock_drift_s_s", 16, _p2(-43)),
        signed("DF433", "clock_bias_s", 22, _p2(-31)),
        unsigned("DF434", "iode", 8),
        signed("DF435", "crs_m", 16, _p2(-5)),
        _angle("DF436", "mean_motion_difference_rad_s", 16, -43),
        _angle("DF437", "mean_anomaly_rad", 32, -31),
        signed("DF438", "cuc_rad", 16, _p2(-29)),
        unsigned("DF439", "eccentricity", 32, _p2(-33)),
        signed("DF440", "cus_rad", 16, _p2(-29)),
        unsigned("DF441", "sqrt_semi_major_axis_sqrt_m", 32, _p2(-19)),
        unsigned("DF442", "toe_s", 16, 16.0),
        signed("DF443", "cic_rad", 16, _p2(-29)),
        _angle("DF444", "ascending_node_rad", 32, -31),
        signed("DF445", "cis_rad", 16, _p2(-29)),
        _angle("DF446", "inclination_rad", 32, -31),
        signed("DF447", "crc_m", 16, _p2(-5)),
        _angle("DF448", "argument_of_perigee_rad", 32, -31),
        _angle("DF449", "ascending_node_rate_rad_s", 24, -43),
        _angle("DF450", "inclination_rate_rad_s", 14, -43),
        unsigned("DF451", "code_on_l2", 2),
        unsigned("DF452", "week", 10),
        unsigned("DF453", "accuracy_index", 4),
        unsigned("DF454", "health", 6),
        signed("DF455", "group_delay_s", 8, _p2(-31)),
        unsigned("DF456", "iodc", 10),
        flag("DF457", "fit_interval_longer"),
    ),
)


def _galileo_rows(accuracy_df: str) -> tuple[Item, ...]:
    """What 1045 and 1046 have in common, up to the first group delay."""
    return (
        unsigned("DF252", "satellite", 6),
        unsigned("DF289", "week", 12),
        unsigned("DF290", "iodnav", 10),
        unsigned(accuracy_df, "accuracy_index", 8),
        _angle("DF292", "inclination_rate_rad_s", 14, -43),
        unsigned("DF293", "toc_s", 14, 60.0),
        signed("DF294", "clock_drift_rate_s_s2", 6, _p2(-59)),
        signed("DF295", "clock_drift_s_s", 21, _p2(-46)),
        signed("DF296", "clock_bias_s", 31, _p2(-34)),
        signed("DF297", "crs_m", 16, _p2(-5)),
        _angle("DF298", "mean_motion_difference_rad_s", 16, -43),
        _angle("DF299", "mean_anomaly_rad", 32, -31),
        signed("DF300", "cuc_rad", 16, _p2(-29)),
        unsigned("DF301", "eccentricity", 32, _p2(-33)),
        signed("DF302", "cus_rad", 16, _p2(-29)),
        unsigned("DF303", "sqrt_semi_major_axis_sqrt_m", 32, _p2(-19)),
        unsigned("DF304", "toe_s", 14, 60.0),
        signed("DF305", "cic_rad", 16, _p2(-29)),
        _angle("DF306", "ascending_node_rad", 32, -31),
        signed("DF307", "cis_rad", 16, _p2(-29)),
        _angle("DF308", "inclination_rad", 32, -31),
        signed("DF309", "crc_m", 16, _p2(-5)),
        _angle("DF310", "argument_of_perigee_rad", 32, -31),
        _angle("DF311", "ascending_node_rate_rad_s", 24, -43),
        signed("DF312", "group_delay_e5a_s", 10, _p2(-32)),
    )


GALILEO_FNAV: Final = Table(
    1045,
    "Galileo F/NAV ephemeris",
    (
        *_galileo_rows("DF291"),
        unsigned("DF314", "e5a_health", 2),
        flag("DF315", "e5a_without_guarantee"),
        unsigned("DF001", "reserved", 7),
    ),
)

GALILEO_INAV: Final = Table(
    1046,
    "Galileo I/NAV ephemeris",
    (
        *_galileo_rows("DF286"),
        signed("DF313", "group_delay_e5b_s", 10, _p2(-32)),
        unsigned("DF316", "e5b_health", 2),
        flag("DF317", "e5b_without_guarantee"),
        unsigned("DF287", "e1b_health", 2),
        flag("DF288", "e1b_without_guarantee"),
        unsigned("DF001", "reserved", 2),
    ),
)

register(GPS, GLONASS, NAVIC, BEIDOU, QZSS, GALILEO_FNAV, GALILEO_INAV)
