"""Ephemerides to test with: plausible numbers, every harmonic and rate different from zero."""

from plumbline.records import GlonassEphemeris, KeplerEphemeris
from plumbline.signals import satellite_of_name

T_NS = 1_277_100_000 * 1_000_000_000


def kepler(name: str = "G05", **changes: object) -> KeplerEphemeris:
    """A medium-orbit satellite (GEO and IGSO radius for BeiDou's low numbers)."""
    values: dict[str, object] = {
        "satellite": satellite_of_name(name), "message": "LNAV", "t_receive_ns": T_NS, "toe_gps_ns": T_NS,
        "toc_gps_ns": T_NS, "issue": 1, "issue_clock": 1, "clock_bias_s": 1.2e-4, "clock_drift_s_s": -3.1e-12,
        "clock_drift_rate_s_s2": 1e-18, "sqrt_semi_major_axis_sqrt_m": 5153.7, "eccentricity": 0.012,
        "mean_anomaly_rad": 0.7, "mean_motion_difference_rad_s": 4.5e-9, "inclination_rad": 0.96,
        "inclination_rate_rad_s": 2e-10, "ascending_node_rad": 1.9, "ascending_node_rate_rad_s": -8e-9,
        "argument_of_perigee_rad": -1.1, "cuc_rad": 3e-6, "cus_rad": 7e-6, "crc_m": 240.0, "crs_m": -55.0,
        "cic_rad": 1.5e-7, "cis_rad": -9e-8, "group_delay_s": (-5.6e-9, 0.0), "health": 0, "accuracy_index": 0,
    }  # fmt: skip
    return KeplerEphemeris(**(values | changes))  # type: ignore[arg-type]


def glonass(**changes: object) -> GlonassEphemeris:
    """A GLONASS state vector on a circular orbit of 25,500 km, 64.8° inclined."""
    values: dict[str, object] = {
        "satellite": satellite_of_name("R05"), "t_receive_ns": T_NS, "toe_gps_ns": T_NS, "issue": 3,
        "frequency_channel": 1, "position_pz90_m": (1.9e7, 1.2e7, 1.2e7),
        "velocity_pz90_m_s": (-1.3e3, 3.0e2, 1.75e3), "acceleration_pz90_m_s2": (9e-7, -2.8e-6, 1.9e-6),
        "clock_bias_s": -3.3e-5, "frequency_bias": 9e-13, "group_delay_s": 2.8e-9, "health": 0,
    }  # fmt: skip
    return GlonassEphemeris(**(values | changes))  # type: ignore[arg-type]
