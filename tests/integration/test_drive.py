"""A car's recorded drive through `plumbline process --mode rtk-imu-loose`: receiver's positions and a MEMS IMU.

Oracles: the receiver's own post-processed positions (one-step predictions are made before they are seen); positions
withheld; the car's course against its heading; and, for the stamps of the IMU, whose clock runs away by a tenth of a
second, the receiver's course against the turns that the gyroscope saw, minute by minute.
"""

import csv
from pathlib import Path

import numpy as np
import pytest

from plumbline import cli
from plumbline.files.imu import even_times, read_imu
from plumbline.files.position_log import read_position_log
from plumbline.gnss.earth_frames import geodetic_from_ecef, rotation_enu_from_ecef
from plumbline.gps_time import NS_PER_S

pytestmark = pytest.mark.realdata
POSITIONS, IMU = "gnss_1934_sf.pos", "imu_1934_sf.csv.gz"
LENGTH_S = 15.0
STARTS_S = [85.0 + 45.0 * k for k in range(10)]


@pytest.fixture(scope="module")
def folder(data_dir: Path) -> Path:
    """The recording."""
    path = data_dir / "drive-0708"
    for name in (POSITIONS, IMU):
        if not (path / name).is_file():
            pytest.skip(f"no {path / name}")
    return path


def process(folder: Path, positions: Path, output: Path, *more: str) -> int:
    """The command, as a user who knows the sensor and how it sits gives it: no time offset, no age of velocities."""
    return cli.main(
        ["process", "--mode", "rtk-imu-loose", "--positions", str(positions), "--imu", str(folder / IMU),
         "--imu-format", "plain-gps", "--imu-characteristics", "icm-45686", "--imu-axes=+y,-x,+z",
         "--lever-arms=-0.05,0,0", "--output", str(output), *more]
    )  # fmt: skip


def rows_of(path: Path) -> dict[str, np.ndarray]:
    """Columns of a CSV that hold numbers."""
    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    return {
        name: np.array([float(r[name] or "nan") for r in rows]) for name in rows[0] if name not in ("status", "reason")
    }


def medians(printed: str) -> dict[str, float]:
    """Medians of the outages' errors that the command printed."""
    lines = [line.split(": median ") for line in printed.splitlines() if ": median " in line]
    return {name.strip(): float(rest.split()[0]) for name, rest in lines}


def test_the_whole_drive(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Horizontal RMS against the receiver, before each position is used, at most 5.4 cm; attitude; the clock."""
    assert process(folder, folder / POSITIONS, tmp_path / "drive.csv", "--forward") == 0
    printed = capsys.readouterr().err
    print(printed)
    predicted, filtered = (
        [float(word) for word in line.partition(":")[2].split()[:2]]
        for line in printed.splitlines()
        if "against GNSS" in line
    )
    assert np.hypot(*predicted) < 0.054
    assert np.hypot(*filtered) < 0.02
    rows = rows_of(tmp_path / "drive.csv")
    assert rows["t_gps_s"].size > 49_000
    assert (np.diff(rows["t_gps_s"]) > 0).all()
    fast = rows["ve_m_s"] ** 2 + rows["vn_m_s"] ** 2 > 64.0
    course = np.degrees(np.arctan2(rows["ve_m_s"], rows["vn_m_s"]))[fast]
    offset = (rows["heading_deg"][fast] - course + 180.0) % 360.0 - 180.0
    assert np.median(offset) == pytest.approx(5.35, abs=1.0)  # the sensor's own misalignment, found by its owner
    assert np.percentile(np.abs(offset - np.median(offset)), 90) < 3.0  # a car does not slide
    clock = next(line for line in printed.splitlines() if line.startswith("samples' clock"))
    assert float(clock.split()[2]) == pytest.approx(late_s(folder, 480.0, 540.0), abs=0.02)
    assert late_s(folder, 60.0, 120.0) - late_s(folder, 480.0, 540.0) > 0.1


def late_s(folder: Path, begin_s: float, end_s: float) -> float:
    """Offset of the stamps at which the gyroscope's turns fit the receiver's course best, over a part of the drive."""
    series, solutions = read_imu(folder / IMU, "plain-gps"), read_position_log(folder / POSITIONS)
    origin = solutions[0].t_gps_ns
    t_s = (even_times(series.t_gps_ns) - origin) / NS_PER_S
    still = (t_s > 8.0) & (t_s < 33.0)
    turned = (
        -np.cumsum(series.angular_rate_rad_s[:, 2] - series.angular_rate_rad_s[still, 2].mean()) * series.interval_s
    )
    turned = np.convolve(turned, np.full(50, 0.02), "same")  # over half a second, as the course below
    first = np.asarray(solutions[0].position_ecef_m)
    place = geodetic_from_ecef(first)
    enu = np.array([s.position_ecef_m for s in solutions]) @ rotation_enu_from_ecef(place[0], place[1]).T
    at_s = np.array([s.t_gps_ns - origin for s in solutions])[1:-1] / NS_PER_S
    step = (enu[2:] - enu[:-2])[:, :2]
    course = np.unwrap(np.arctan2(step[:, 0], step[:, 1]))
    used = (at_s > begin_s) & (at_s < end_s) & (np.hypot(*step.T) > 1.0)

    def misfit(offset_s: float) -> float:
        there = np.interp(at_s[used], t_s + offset_s, turned)
        return float(np.std(np.diff(course[used] - there)))

    return float(min(np.arange(-0.5, 0.2, 0.005), key=misfit))


def test_withheld_rows_are_bridged(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Ten gaps of 15 s in the file itself: the series goes through them at the sensor's rate, and says how sure it is.

    At the end of the gaps within 0.30 m, and at their worst (medians); errors within three of the sigmas stated.
    """
    lines = (folder / POSITIONS).read_text(encoding="ascii").splitlines(keepends=True)
    truth = read_position_log(folder / POSITIONS)
    kept = [
        line for k, line in enumerate(lines) if not any(start <= (k - 1) / 4 < start + LENGTH_S for start in STARTS_S)
    ]
    (tmp_path / "gaps.pos").write_text("".join(kept), encoding="ascii")
    assert process(folder, tmp_path / "gaps.pos", tmp_path / "out.csv") == 0
    rows, first = rows_of(tmp_path / "out.csv"), np.asarray(truth[0].position_ecef_m)
    place = geodetic_from_ecef(first)
    turn = rotation_enu_from_ecef(place[0], place[1])
    ends, worst, sure = [], [], []
    for start in STARTS_S:
        gone = [s for k, s in enumerate(truth) if start <= k / 4 < start + LENGTH_S]
        times = np.array([s.t_gps_ns / NS_PER_S for s in gone])
        inside = (rows["t_gps_s"] > times[0]) & (rows["t_gps_s"] < times[-1])
        assert inside.sum() > 95 * (LENGTH_S - 0.5)
        enu = np.array([s.position_ecef_m for s in gone]) @ turn.T - turn @ first
        errors = [np.interp(times, rows["t_gps_s"], rows[f"{axis}_m"]) - enu[:, k] for k, axis in enumerate("en")]
        sigmas = [np.interp(times, rows["t_gps_s"], rows[f"sigma_{axis}_m"]) for axis in "en"]
        horizontal = np.hypot(*errors)
        ends.append(horizontal[-1])
        worst.append(horizontal.max())
        sure.append(np.mean(np.abs(errors) < 3.0 * np.array(sigmas)))
        middle, edge = sigmas[0][len(times) // 2], sigmas[0][0]
        assert middle > 2.0 * edge
    print(
        "at the end, m:", np.round(ends, 3), "at the worst:", np.round(worst, 3), "within 3 sigma:", np.round(sure, 2)
    )
    assert np.median(ends) < 0.30
    assert np.median(worst) < 0.30
    assert np.mean(sure) > 0.9


@pytest.mark.soak
def test_outages_of_the_command(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What the command prints of two short outages: the filter alone, and better, smoothed; its sigma grows alone."""
    spans = "85,5;130,5"
    assert process(folder, folder / POSITIONS, tmp_path / "out.csv", "--forward", "--outages", spans) == 0
    found = medians(capsys.readouterr().err)
    assert found["filter alone, at their end"] < 1.0
    rows = rows_of(tmp_path / "out.csv")
    start_s = read_position_log(folder / POSITIONS)[0].t_gps_ns / NS_PER_S + 85.0
    sigma = [np.interp(start_s + s, rows["t_gps_s"], rows["sigma_e_m"]) for s in (0.5, 1.5, 3.0, 4.7)]
    assert (np.diff(sigma) > 0).all()
