"""Readers of IMU tables and of position logs.

Oracles: numbers written into the files, unit conversions by hand, the straight line that jittered stamps scatter about,
and the recorded files' own text.
"""

import gzip
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from plumbline.errors import FileFormatError
from plumbline.files.imu import even_times, read_imu
from plumbline.files.position_log import read_position_log
from plumbline.gnss.earth_frames import geodetic_from_ecef
from plumbline.gps_time import gps_ns_from_calendar, gps_ns_from_utc
from plumbline.records import Status

HEAD = (
    "%  GPST            latitude(deg) longitude(deg) height(m) Q ns sdn(m) sde(m) sdu(m) sdne(m) sdeu(m) sdun(m) age(s)"
    " ratio vn(m/s) ve(m/s) vu(m/s) sdvn sdve sdvu sdvne sdveu sdvun\n"
)
ROW = "40.0966268 -105.1474483 1601.474 1 21 0.01 0.02 0.03 -0.001 0.002 0 0 0 0.5 -0.25 0.125 0.05 0.06 0.07 0 0 0\n"


def test_plain_table(tmp_path: Path) -> None:
    """POSIX seconds, g and rad/s; the eighth column on is left alone; gzip as well."""
    text = "1752003261.85,0.5,-0.25,1,0.1,-0.2,0.3,9,9\n1752003261.86,0,0,1,0,0,0,9,9\n"
    path = tmp_path / "imu.csv.gz"
    path.write_bytes(gzip.compress(text.encode()))
    series = read_imu(path)
    assert series.t_gps_ns[0] == gps_ns_from_utc(datetime(2025, 7, 8, 19, 34, 21, 850_000, UTC))
    np.testing.assert_allclose(series.specific_force_m_s2[0], np.array([0.5, -0.25, 1.0]) * 9.80665)
    np.testing.assert_allclose(series.angular_rate_rad_s[0], [0.1, -0.2, 0.3])
    assert series.interval_s == pytest.approx(0.01)
    as_gps = read_imu(path, "plain-gps")
    assert series.t_gps_ns[0] - as_gps.t_gps_ns[0] == 18_000_000_000


def test_named_table(tmp_path: Path) -> None:
    """Columns by name, degrees and milli-g by their unit."""
    path = tmp_path / "imu.csv"
    path.write_text("t_gps_s,gyr_x[deg/s],gyr_y[deg/s],gyr_z[deg/s],acc_x[mg],acc_y[mg],acc_z[mg]\n1e0,180,0,0,0,0,1000\n"
                    .replace("1e0", "1400000000.5") + "1400000000.6,0,0,90,0,0,1000\n")  # fmt: skip
    series = read_imu(path)
    assert series.t_gps_ns[0] == 1_400_000_000_500_000_000
    np.testing.assert_allclose(series.angular_rate_rad_s, [[np.pi, 0, 0], [0, 0, np.pi / 2]])
    np.testing.assert_allclose(series.specific_force_m_s2[:, 2], 9.80665)


def test_dot_table(tmp_path: Path) -> None:
    """Movella DOT: header lines, a counter at 120 Hz (with a sample lost), degrees a second."""
    path = tmp_path / "dot.csv"
    path.write_text("sep=,\nDeviceTag:,x\n\nPacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z\n"
                    "7,1,0,0,9.8,0,0,180\n9,3,0,0,9.8,0,0,0\n")  # fmt: skip
    series = read_imu(path)
    assert series.t_gps_ns.tolist() == [0, 2 * (1_000_000_000 // 120)]
    assert series.angular_rate_rad_s[0, 2] == pytest.approx(np.pi)


@pytest.mark.parametrize(
    "text", ["", "a,b\n1,2\n", "acc_x,acc_y,acc_z\n1,2,3\n", "1,2,3,4,5,6,x\n", "2,0,0,1,0,0,0\n1,0,0,1,0,0,0\n"]
)
def test_other_tables_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "imu.csv"
    path.write_text(text)
    with pytest.raises(FileFormatError):
        read_imu(path)


def test_stamps_are_evened_out() -> None:
    """Oracle: the even, slightly drifting times that read-out jitter was added to; a gap stays a gap."""
    rng = np.random.default_rng(0)
    true = (np.arange(6000) * 10_002_000).astype(np.int64)
    true[3000:] += 500_000_000
    stamps = true + rng.integers(-1_000_000, 1_000_000, true.size)
    found = even_times(np.sort(stamps))
    assert np.abs(found - true).std() < 0.15e6
    assert (found[3000] - found[2999]) == pytest.approx(510_002_000, abs=1_000_000)
    assert (np.diff(found) > 0).all()


def test_position_log(tmp_path: Path) -> None:
    path = tmp_path / "log.pos"
    path.write_text("% program: x\n" + HEAD + "2025/07/08 19:34:18.499 " + ROW)
    (solution,) = read_position_log(path)
    assert solution.t_gps_ns == gps_ns_from_calendar(2025, 7, 8, 19, 34, 18_499_000_000)
    assert solution.status is Status.RTK_FIXED
    assert solution.n_satellites == 21
    assert solution.position_ecef_m is not None
    place = geodetic_from_ecef(solution.position_ecef_m)
    np.testing.assert_allclose(np.degrees(place[:2]), [40.0966268, -105.1474483], atol=1e-12)
    assert place[2] == pytest.approx(1601.474, abs=1e-6)
    np.testing.assert_allclose(
        solution.covariance_enu_m2, [[4e-4, -1e-6, 4e-6], [-1e-6, 1e-4, 0], [4e-6, 0, 9e-4]], atol=1e-12
    )
    np.testing.assert_allclose(solution.velocity_enu_m_s, [-0.25, 0.5, 0.125])
    assert solution.extras == {"sigma_ve_m_s": 0.06, "sigma_vn_m_s": 0.05, "sigma_vu_m_s": 0.07}


def test_position_log_by_week_and_in_utc(tmp_path: Path) -> None:
    path = tmp_path / "log.pos"
    path.write_text(HEAD + "2374 243258.499 " + ROW)
    assert read_position_log(path)[0].t_gps_ns == gps_ns_from_calendar(2025, 7, 8, 19, 34, 18_499_000_000)
    path.write_text(HEAD.replace("GPST", "UTC ") + "2025/07/08 19:34:00.499 " + ROW)
    assert read_position_log(path)[0].t_gps_ns == gps_ns_from_calendar(2025, 7, 8, 19, 34, 18_499_000_000)


@pytest.mark.parametrize(
    "text", ["2025/07/08 19:34:18.499 1 2 3\n", HEAD + "2025/07/08 x 1 2 3\n", HEAD + "2025/07/08\n"]
)
def test_other_logs_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "log.pos"
    path.write_text(text)
    with pytest.raises(FileFormatError):
        read_position_log(path)
