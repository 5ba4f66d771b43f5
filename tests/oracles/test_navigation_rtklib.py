"""Decoded ephemerides and SSR records against RTKLIB's (``pyrtklib5``), fed with the same frames."""

import math
from pathlib import Path

import pytest

from plumbline.epochs.translate_ephemeris import NUMBERS as EPHEMERIS_NUMBERS
from plumbline.epochs.translate_ephemeris import Rejected, ephemeris_from_message
from plumbline.epochs.translate_ssr import NUMBERS as SSR_NUMBERS
from plumbline.epochs.translate_ssr import SsrTranslator
from plumbline.gps_time import GPS_EPOCH_UNIX_NS, NS_PER_S, gps_ns
from plumbline.records import GlonassEphemeris, SsrClock, SsrCodeBias, SsrOrbit
from plumbline.rtcm3 import decode, frame, scan_frames
from plumbline.signals import System, number_of, signal_code, system_of

rtklib = pytest.importorskip("pyrtklib5")

SYSTEMS = {
    System.GPS: (rtklib.SYS_GPS, 0),
    System.GLONASS: (rtklib.SYS_GLO, 0),
    System.GALILEO: (rtklib.SYS_GAL, 0),
    System.QZSS: (rtklib.SYS_QZS, 192),
    System.BEIDOU: (rtklib.SYS_CMP, 0),
}
KEPLER = {
    "e": "eccentricity", "M0": "mean_anomaly_rad", "deln": "mean_motion_difference_rad_s", "i0": "inclination_rad",
    "idot": "inclination_rate_rad_s", "OMG0": "ascending_node_rad", "OMGd": "ascending_node_rate_rad_s",
    "omg": "argument_of_perigee_rad", "cuc": "cuc_rad", "cus": "cus_rad", "crc": "crc_m", "crs": "crs_m",
    "cic": "cic_rad", "cis": "cis_rad", "f0": "clock_bias_s", "f1": "clock_drift_s_s", "f2": "clock_drift_rate_s_s2",
    "iode": "issue", "sva": "accuracy_index",
}  # fmt: skip


def satellite_of(satellite: int) -> int:
    system, offset = SYSTEMS[system_of(satellite)]
    return rtklib.satno(system, number_of(satellite) + offset)


def peer(week: int, tow: float):
    decoder = rtklib.rtcm_t()
    rtklib.init_rtcm(decoder)
    decoder.time = rtklib.gpst2time(week, tow)
    return decoder


def feed(decoder, payload: bytes) -> int:
    status = 0
    for octet in frame(payload):
        status = rtklib.input_rtcm3(decoder, octet) or status
    return status


def seconds(t) -> float:
    """RTKLIB's GPS time as seconds since 1980."""
    return t.time + t.sec - GPS_EPOCH_UNIX_NS // NS_PER_S


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("file", "week", "tow", "least"),
    [
        ("str-2018-195/week-rollover-STR17.rtcm3", 2010, 0.0, 60),
        ("str-2018-195/week-rollover-STR24.rtcm3", 2010, 0.0, 70),
        ("has-idd-2023-229/idd2023229c.rtc", 2275, 352_752.0, 120),
    ],
)
def test_ephemerides(data_dir: Path, file: str, week: int, tow: float, least: int):
    """All elements, times and issues of each set that RTKLIB takes in (it answers 2 to a set that is new to it)."""
    decoder, near_ns, compared = peer(week, tow), gps_ns(week, tow), 0
    for found in scan_frames((data_dir / file).read_bytes()).frames:
        message = decode(found.payload)
        if message.number not in EPHEMERIS_NUMBERS or feed(decoder, found.payload) != 2:
            continue
        ours = ephemeris_from_message(message, near_ns)
        assert not isinstance(ours, Rejected)
        sat = satellite_of(ours.satellite)
        if isinstance(ours, GlonassEphemeris):
            _compare_glonass(decoder.nav.geph[number_of(ours.satellite) - 1], ours)
        else:
            theirs = decoder.nav.eph[sat - 1 + (rtklib.MAXSAT if decoder.ephset else 0)]
            assert theirs.sat == sat
            _compare_kepler(theirs, ours)
        compared += 1
    assert compared >= least


def _compare_kepler(theirs, ours) -> None:
    assert math.sqrt(theirs.A) == pytest.approx(ours.sqrt_semi_major_axis_sqrt_m, rel=1e-14)
    for name, own in KEPLER.items():
        if not (name == "iode" and system_of(ours.satellite) is System.BEIDOU):  # EX puts its own issue there
            assert getattr(theirs, name) == pytest.approx(getattr(ours, own), rel=1e-12, abs=1e-30), name
    assert seconds(theirs.toc) == pytest.approx(ours.toc_gps_ns / NS_PER_S, abs=1e-6)
    if abs(seconds(theirs.toe) - ours.toe_gps_ns / NS_PER_S) > 1e-6:  # RTKLIB has it in the week of transmission
        assert abs(seconds(theirs.toe) - ours.toe_gps_ns / NS_PER_S) == pytest.approx(604_800.0)
    delays = [theirs.tgd[k] for k in range(2)]
    assert delays[0] == pytest.approx(ours.group_delay_s[0], abs=1e-18)
    assert (theirs.svh != 0) == (ours.health != 0)


def _compare_glonass(theirs, ours: GlonassEphemeris) -> None:
    for k in range(3):
        assert theirs.pos[k] == pytest.approx(ours.position_pz90_m[k], rel=1e-13)
        assert theirs.vel[k] == pytest.approx(ours.velocity_pz90_m_s[k], rel=1e-13)
        assert theirs.acc[k] == pytest.approx(ours.acceleration_pz90_m_s2[k], abs=1e-18)
    assert -theirs.taun == pytest.approx(ours.clock_bias_s, abs=1e-20)
    assert theirs.gamn == pytest.approx(ours.frequency_bias, abs=1e-22)
    assert (theirs.iode, theirs.frq) == (ours.issue, ours.frequency_channel)
    assert seconds(theirs.toe) == pytest.approx(ours.toe_gps_ns / NS_PER_S, abs=1e-3)


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("file", "week", "tow", "numbers"),
    [
        ("has-idd-2023-229/idd2023229c.rtc", 2275, 352_752.0, (1059, 1060, 1242, 1243)),
        ("sc134-2026-037/SSRTEST_20260206_CORR.bin", 2404, 504_040.0, (1057, 1058, 1059, 1063, 1064, 1240, 1241, 1242)),
        ("madoca-2025-091/madocalib_2025091A.204.rtcm3", 2360, 172_835.0, (1057, 1058, 1240, 1241, 1258, 1259)),
    ],
)
def test_ssr(data_dir: Path, file: str, week: int, tow: float, numbers: tuple[int, ...]):
    """Corrections of the first hundred frames of each type: satellite, epoch, issue, values."""
    decoder, translator = peer(week, tow), SsrTranslator()
    seen = dict.fromkeys(numbers, 0)
    compared = 0
    for found in scan_frames((data_dir / file).read_bytes()).frames:
        message = decode(found.payload)
        if message.number not in seen or message.number not in SSR_NUMBERS or seen[message.number] >= 100:
            continue
        seen[message.number] += 1
        feed(decoder, found.payload)
        records = translator.translate(message, gps_ns(week, tow))
        assert not isinstance(records, Rejected)
        for record in records:
            for k, satellite in enumerate(record.satellite.tolist()):
                compared += 1
                _compare_ssr(decoder.ssr[satellite_of(satellite) - 1], record, k, message.number == 1258)
    assert min(seen.values()) >= 100
    assert compared > 1000


def _compare_ssr(theirs, record, k: int, beidou: bool) -> None:
    if isinstance(record, SsrOrbit):
        assert theirs.iode == record.issue[k]
        assert beidou or theirs.iod[0] == record.header.iod_ssr
        for axis in range(3):
            assert theirs.deph[axis] == pytest.approx(record.delta_rac_m[k, axis], abs=1e-12)
            assert theirs.ddeph[axis] == pytest.approx(record.delta_rate_rac_m_s[k, axis], abs=1e-12)
        assert seconds(theirs.t0[0]) == record.header.t_gps_ns / NS_PER_S
    elif isinstance(record, SsrClock):
        for power in range(3):
            assert theirs.dclk[power] == pytest.approx(record.polynomial_m[k, power], abs=1e-12)
        assert seconds(theirs.t0[1]) == record.header.t_gps_ns / NS_PER_S
    elif isinstance(record, SsrCodeBias):
        code = rtklib.obs2code(signal_code(int(record.signal[k])))
        assert theirs.cbias[code - 1] == pytest.approx(record.bias_m[k], abs=1e-6)
