"""The file readers agree with RTKLIB's on the recordings of ESBC."""

import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from plumbline.files.rinex_clock import read_clocks
from plumbline.files.rinex_navigation import read_navigation
from plumbline.files.rinex_observation import RinexObservations
from plumbline.files.sp3 import read_sp3
from plumbline.gps_time import NS_PER_S, gps_minus_utc_s, utc_ns_from_gps
from plumbline.records import GlonassEphemeris, KeplerEphemeris
from plumbline.signals import satellite_name, signal_code

rtklib = pytest.importorskip("pyrtklib5")
pytestmark = pytest.mark.realdata
FOLDER = "esbc-2020-177"
OBSERVATIONS = "ESBC00DNK_R_20201770000_12H_30S_MO.rnx.gz"
NAVIGATION = "ESBC00DNK_R_20201770000_01D_MN.rnx.gz"
ORBITS = "GRG0MGXFIN_20201770000_01D_15M_ORB.SP3.gz"
CLOCKS = "GRG0MGXFIN_20201770000_01D_30S_CLK.CLK.gz"
GPS_EPOCH_OF_RTKLIB_S = 315_964_800  # its gtime_t counts POSIX seconds of GPS time


def unpacked(data_dir: Path, name: str, tmp_path: Path, n_lines: int | None = None) -> str:
    """The recording as a plain file, cut after ``n_lines`` if asked."""
    target = tmp_path / name.removesuffix(".gz")
    with gzip.open(data_dir / FOLDER / name, "rt") as source, target.open("w") as plain:
        plain.writelines(line for _, line in zip(range(n_lines or 10**9), source, strict=False))
    return str(target)


def rtklib_name(sat: int) -> str:
    name = rtklib.Arr1Dchar(8)
    rtklib.satno2id(sat, name)
    return f"S{int(name.ptr) - 100:02d}" if name.ptr.isdigit() else str(name.ptr)


def rtklib_read(path: str) -> tuple[object, object]:
    obs, nav, sta = rtklib.obs_t(), rtklib.nav_t(), rtklib.sta_t()
    assert rtklib.readrnx(path, 1, "", obs, nav, sta) == 1
    return obs, nav


def gps_s(time: object) -> float:
    return time.time - GPS_EPOCH_OF_RTKLIB_S + time.sec  # type: ignore[attr-defined]


def test_observations_agree(data_dir: Path, tmp_path: Path) -> None:
    """Oracle: RTKLIB's reader: code, phase, Doppler and C/N0 of every signal it keeps, digit by digit."""
    path = unpacked(data_dir, OBSERVATIONS, tmp_path, 3000)
    ours = {}
    for epoch in RinexObservations(path):
        for k in range(len(epoch.satellite)):
            key = epoch.t_gps_ns, satellite_name(int(epoch.satellite[k])), signal_code(int(epoch.signal[k]))
            ours[key] = (
                epoch.pseudorange_m[k], epoch.carrier_phase_cycles[k], epoch.doppler_hz[k], epoch.cn0_db_hz[k],
            )  # fmt: skip
    obs, _ = rtklib_read(path)
    compared = 0
    for k in range(obs.n):
        row = obs.data[k]
        t_ns = round(gps_s(row.time) * NS_PER_S)
        name = rtklib_name(row.sat)
        for slot in range(2):  # the bindings hold two frequencies
            if not row.code[slot] or (row.P[slot] == 0.0 and row.L[slot] == 0.0):
                continue
            key = t_ns, name, rtklib.code2obs(row.code[slot])
            theirs = row.P[slot], row.L[slot], row.D[slot], row.SNR[slot]
            if key[2] == "3Q":  # a signal that MSM does not know
                continue
            mine = np.nan_to_num(ours[key])
            assert (mine[0], mine[1]) == pytest.approx(theirs[:2], rel=3e-15)
            assert (mine[2], mine[3]) == pytest.approx(theirs[2:], rel=6e-8)  # single precision there
            compared += 1
    assert compared > 5000


def test_ephemerides_agree(data_dir: Path, tmp_path: Path) -> None:
    """Oracle: RTKLIB's reader: each set it keeps has our element values, reference times and issue."""
    navigation = read_navigation(data_dir / FOLDER / NAVIGATION)
    _, nav = rtklib_read(unpacked(data_dir, NAVIGATION, tmp_path))
    kepler = [e for e in navigation.ephemerides if isinstance(e, KeplerEphemeris)]
    ours = {(satellite_name(e.satellite), e.issue, e.toe_gps_ns, e.message): e for e in kepler}
    assert nav.n == len(kepler)  # RTKLIB keeps every record here
    for k in range(nav.n):
        theirs = nav.eph[k]
        name = rtklib_name(theirs.sat)
        message = {"E": "FNAV" if theirs.code & (1 << 8) else "INAV", "C": None}.get(name[0], "LNAV")
        if message is None:
            message = "D2" if int(name[1:]) in (1, 2, 3, 4, 5, 59, 60, 61, 62, 63) else "D1"
        mine = ours[name, theirs.iode, round(gps_s(theirs.toe) * NS_PER_S), message]
        assert mine.toc_gps_ns == round(gps_s(theirs.toc) * NS_PER_S)
        assert math.isclose(mine.sqrt_semi_major_axis_sqrt_m**2, theirs.A, rel_tol=1e-14)
        assert (mine.eccentricity, mine.mean_anomaly_rad, mine.inclination_rad) == (theirs.e, theirs.M0, theirs.i0)
        assert (mine.ascending_node_rad, mine.argument_of_perigee_rad) == (theirs.OMG0, theirs.omg)
        assert (mine.ascending_node_rate_rad_s, mine.inclination_rate_rad_s) == (theirs.OMGd, theirs.idot)
        assert (mine.crc_m, mine.crs_m, mine.cuc_rad) == (theirs.crc, theirs.crs, theirs.cuc)
        assert (mine.cus_rad, mine.cic_rad, mine.cis_rad) == (theirs.cus, theirs.cic, theirs.cis)
        assert (mine.clock_bias_s, mine.clock_drift_s_s) == (theirs.f0, theirs.f1)
        assert mine.group_delay_s[0] == theirs.tgd[0]


def test_glonass_agrees(data_dir: Path, tmp_path: Path) -> None:
    """Oracle: RTKLIB's reader: positions, clocks, reference times and channels of every GLONASS set."""
    navigation = read_navigation(data_dir / FOLDER / NAVIGATION)
    _, nav = rtklib_read(unpacked(data_dir, NAVIGATION, tmp_path))
    ours = {
        (satellite_name(e.satellite), e.toe_gps_ns): e
        for e in navigation.ephemerides
        if isinstance(e, GlonassEphemeris)
    }
    assert nav.ng == len(ours) == 510
    for k in range(nav.ng):
        theirs = nav.geph[k]
        mine = ours[rtklib_name(theirs.sat), round(gps_s(theirs.toe) * NS_PER_S)]
        assert mine.position_pz90_m == pytest.approx([theirs.pos[i] for i in range(3)], abs=1e-6)
        assert mine.velocity_pz90_m_s == pytest.approx([theirs.vel[i] for i in range(3)], abs=1e-9)
        assert mine.clock_bias_s == pytest.approx(-theirs.taun, abs=1e-20)
        assert (mine.frequency_channel, mine.issue) == (theirs.frq, theirs.iode)
        assert abs(mine.t_receive_ns - gps_s(theirs.tof) * NS_PER_S) < NS_PER_S
        assert utc_ns_from_gps(mine.toe_gps_ns) % (900 * NS_PER_S) == 0
        assert gps_minus_utc_s(mine.toe_gps_ns) == 18


def test_precise_products_agree(data_dir: Path, tmp_path: Path) -> None:
    """Oracle: RTKLIB's SP3 reader for positions; the clock file's lines, counted, and SP3's clocks."""
    orbits, sp3_clocks = read_sp3([data_dir / FOLDER / ORBITS])
    nav = rtklib.nav_t()
    rtklib.readsp3(unpacked(data_dir, ORBITS, tmp_path), nav, 0)
    assert nav.ne == len(orbits.t_gps_ns) == 96
    for epoch in (0, 50, 95):
        for column, satellite in enumerate(orbits.satellite):
            theirs = nav.peph[epoch].pos
            sat = rtklib.satid2no(satellite_name(int(satellite)))
            assert orbits.position_ecef_m[epoch, column] == pytest.approx(
                [theirs[sat - 1, k] for k in range(3)], abs=1e-6
            )
    files = read_clocks([data_dir / FOLDER / CLOCKS])
    assert np.isfinite(files.clocks.clock_s).sum() == 215_999
    assert len(files.wide_lane_cycles) == 66
    assert (files.clocks.satellite == sp3_clocks.satellite).all()
    common = np.isin(files.clocks.t_gps_ns, sp3_clocks.t_gps_ns)
    difference_s = files.clocks.clock_s[common] - sp3_clocks.clock_s
    assert np.nanmax(np.abs(difference_s)) < 1e-12  # SP3 prints clocks to the picosecond
