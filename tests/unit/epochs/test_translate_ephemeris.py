"""Ephemeris messages ↔ records. Oracles: dates by hand from the systems' week definitions, and round trips."""

import dataclasses
import math
from datetime import UTC, datetime

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plumbline.epochs.translate_ephemeris import Rejected, ephemeris_from_message, message_from_ephemeris
from plumbline.errors import ContractError
from plumbline.gps_time import DAY_NS, NS_PER_S, WEEK_NS, gps_ns, gps_ns_from_utc
from plumbline.records import GlonassEphemeris, KeplerEphemeris
from plumbline.rtcm3 import decode, encode
from plumbline.rtcm3.fields import Message
from plumbline.signals import System, satellite_id, satellite_of_name

TOE = gps_ns(2400, 100_800.0)
YEAR_NS = 365 * DAY_NS


def kepler(name="G05", message="LNAV", toe_gps_ns=TOE, **changes):
    values = {
        "satellite": satellite_of_name(name), "message": message, "t_receive_ns": toe_gps_ns - 3600 * NS_PER_S,
        "toe_gps_ns": toe_gps_ns, "toc_gps_ns": toe_gps_ns, "issue": 17, "issue_clock": 17,
        "clock_bias_s": 2.0**-31 * 1000, "clock_drift_s_s": -(2.0**-43) * 30, "clock_drift_rate_s_s2": 0.0,
        "sqrt_semi_major_axis_sqrt_m": 5153.5, "eccentricity": 2.0**-7, "mean_anomaly_rad": math.pi / 4,
        "mean_motion_difference_rad_s": math.pi * 2.0**-43 * 12000, "inclination_rad": math.pi * 0.3125,
        "inclination_rate_rad_s": -math.pi * 2.0**-43 * 100, "ascending_node_rad": -math.pi / 2,
        "ascending_node_rate_rad_s": -math.pi * 2.0**-43 * 22000, "argument_of_perigee_rad": math.pi * 0.75,
        "cuc_rad": 2.0**-20, "cus_rad": -(2.0**-19), "crc_m": 200.5, "crs_m": -30.25, "cic_rad": 2.0**-24,
        "cis_rad": 0.0, "group_delay_s": (2.0**-28, 0.0), "health": 0, "accuracy_index": 2, "fit_interval_h": 4.0,
    }  # fmt: skip
    return KeplerEphemeris(**(values | changes))


def through_the_wire(ephemeris, t_receive_ns=None):
    payload = encode(message_from_ephemeris(ephemeris))
    return ephemeris_from_message(decode(payload), ephemeris.t_receive_ns if t_receive_ns is None else t_receive_ns)


SETS = [
    kepler(),
    kepler("G05", fit_interval_h=6.0, health=63),
    kepler("J02", fit_interval_h=2.0),
    kepler("I03", fit_interval_h=0.0, health=2, mean_motion_difference_rad_s=math.pi * 2.0**-41 * 900,
           ascending_node_rate_rad_s=-math.pi * 2.0**-41 * 800),
    kepler("E11", "INAV", group_delay_s=(2.0**-30, -(2.0**-29)), health=0b101101, issue=99, issue_clock=99,
           fit_interval_h=0.0),
    kepler("E11", "FNAV", group_delay_s=(2.0**-30, 0.0), health=0b011, issue=99, issue_clock=99, fit_interval_h=0.0),
    kepler("C20", "D1", gps_ns(2400, 100_814.0), group_delay_s=(3e-9, -4.1e-9), issue_clock=3, fit_interval_h=0.0),
    kepler("C03", "D2", gps_ns(2400, 14.0), group_delay_s=(0.0, 0.0), issue=1, fit_interval_h=0.0),
]  # fmt: skip


@pytest.mark.parametrize("ephemeris", SETS, ids=lambda e: f"{System(e.satellite // 64).name}-{e.message}-{e.health}")
def test_records_survive_the_wire(ephemeris):
    back = through_the_wire(ephemeris)
    for field in dataclasses.fields(ephemeris):
        sent, received = getattr(ephemeris, field.name), getattr(back, field.name)
        assert received == pytest.approx(sent, rel=1e-12, abs=1e-15) if isinstance(sent, float) else received == sent


def glonass(**changes):
    toe = gps_ns_from_utc(datetime(2018, 7, 14, 23, 45, tzinfo=UTC))
    values = {
        "satellite": satellite_id(System.GLONASS, 7), "t_receive_ns": toe, "toe_gps_ns": toe, "issue": 11,
        "frequency_channel": -4, "position_pz90_m": (1.5e7, -1.5e7, 1.4e7),
        "velocity_pz90_m_s": (500.0, -1500.0, 2500.0),
        "acceleration_pz90_m_s2": (0.0, 1000 * 2.0**-30, -3000 * 2.0**-30), "clock_bias_s": -3 * 2.0**-30,
        "frequency_bias": 2.0**-40, "group_delay_s": 2.0**-30, "health": 0,
    }  # fmt: skip
    return GlonassEphemeris(**(values | changes))


def test_glonass_survives_the_wire_with_moscow_time():
    """23:45 UTC is 02:45 of the next day in Moscow: t_b is the eleventh quarter of an hour, 15 July the 927th day."""
    ephemeris = glonass()
    message = message_from_ephemeris(ephemeris)
    assert (message["tb"], message["nt"], message["n4"], message["tau_s"]) == (11, 927, 6, 3 * 2.0**-30)
    back = through_the_wire(ephemeris)
    assert dataclasses.replace(back, position_pz90_m=ephemeris.position_pz90_m,
                               velocity_pz90_m_s=ephemeris.velocity_pz90_m_s) == ephemeris  # fmt: skip
    assert back.position_pz90_m == pytest.approx(ephemeris.position_pz90_m, abs=0.25)
    assert back.velocity_pz90_m_s == pytest.approx(ephemeris.velocity_pz90_m_s, abs=0.5e-3)


def test_a_glonass_recording_brings_its_own_date():
    """A message of 2018 received in 2026: the frame's date, not the receive clock, says which day."""
    assert through_the_wire(glonass(), glonass().t_receive_ns + 8 * YEAR_NS).toe_gps_ns == glonass().toe_gps_ns


@pytest.mark.parametrize("years", [-9, -3, 0, 9])
@pytest.mark.parametrize("ephemeris", SETS, ids=lambda e: f"{System(e.satellite // 64).name}-{e.message}-{e.health}")
def test_the_week_survives_a_receive_clock_that_is_years_off(ephemeris, years):
    back = through_the_wire(ephemeris, ephemeris.t_receive_ns + years * YEAR_NS)
    assert (back.toe_gps_ns, back.toc_gps_ns) == (ephemeris.toe_gps_ns, ephemeris.toc_gps_ns)


@pytest.mark.parametrize("name", ["G05", "E11", "C20", "J02", "I03"])
def test_across_the_week_the_receive_time_decides(name):
    """Ten minutes before the week's end a set for the next week is sent, and after it a set of the last."""
    edge = 2400 * WEEK_NS + (14 * NS_PER_S if name[0] == "C" else 0)
    message, modulus = {"E": ("INAV", 4096), "C": ("D1", 8192)}.get(name[0], ("LNAV", 1024))
    for toe, receive in ((edge, edge - 600 * NS_PER_S), (edge - 7200 * NS_PER_S, edge + 600 * NS_PER_S)):
        sent = message_from_ephemeris(kepler(name, message, toe))
        for week_sent in (-1, 0, 1):
            fields = {**sent.fields, "week": (sent["week"] + week_sent) % modulus}
            got = ephemeris_from_message(Message(sent.number, fields), receive)
            if week_sent == 0 or (toe == edge) == (week_sent == -1):
                assert got.toe_gps_ns == toe


@pytest.mark.parametrize(("name", "message"), [("E11", "INAV"), ("E11", "FNAV"), ("C20", "D1")])
@pytest.mark.parametrize("years", [0, 3])
def test_encoders_that_send_the_gps_week_are_understood(name, message, years):
    toe = TOE + (14 * NS_PER_S if name[0] == "C" else 0)
    sent = message_from_ephemeris(kepler(name, message, toe))
    got = ephemeris_from_message(Message(sent.number, {**sent.fields, "week": 2400}), TOE + years * YEAR_NS)
    assert got.toe_gps_ns == toe


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"satellite": 0}, "satellite_out_of_range"),
        ({"sqrt_semi_major_axis_sqrt_m": 0.0}, "implausible_orbit"),
        ({"eccentricity": 0.5}, "implausible_orbit"),
        ({"toe_s": 604_800.0}, "time_of_week_out_of_range"),
    ],
)
def test_implausible_sets_are_rejected(changes, reason):
    sent = message_from_ephemeris(kepler())
    assert ephemeris_from_message(Message(1019, {**sent.fields, **changes}), TOE) == Rejected(reason)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"satellite": 0}, "satellite_out_of_range"),
        ({"frequency_channel": 13}, "frequency_channel_out_of_range"),
        ({"position_x_m": 0.0}, "implausible_orbit"),
        ({"tb": 96}, "time_of_day_out_of_range"),
    ],
)
def test_implausible_glonass_sets_are_rejected(changes, reason):
    sent = message_from_ephemeris(glonass())
    assert ephemeris_from_message(Message(1020, {**sent.fields, **changes}), TOE) == Rejected(reason)


def test_other_messages_are_none():
    assert ephemeris_from_message(Message(1005, {}), TOE) == Rejected("not_an_ephemeris")
    with pytest.raises(ContractError, match="no message carries"):
        message_from_ephemeris(kepler("S25"))


@settings(max_examples=60, deadline=None)
@given(angle=st.floats(-2 * math.pi, 2 * math.pi))
def test_any_angle_fits_its_field(angle):
    """RINEX files write angles in 0…2π or −π…π; the wire holds −π…π, to a step of 2⁻³¹ semicircles."""
    back = through_the_wire(kepler(mean_anomaly_rad=angle))
    difference = math.remainder(back.mean_anomaly_rad - angle, 2 * math.pi)
    assert abs(difference) <= 1.01 * math.pi * 2.0**-32
