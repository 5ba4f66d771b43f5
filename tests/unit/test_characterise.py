"""`plumbline characterise` on a device's own recording.

Oracle: the same samples as a table, and the densities that they were made with.
"""

import csv
from pathlib import Path

import numpy as np
import pytest

from plumbline import cli
from plumbline.offline_characterise import characterise
from plumbline.offline_imu_recording import recorded_series
from plumbline.rtcm3 import InertialMessage, frame
from plumbline.rtcm3.inertial import encode_inertial

N, PER_MESSAGE, INTERVAL_US = 12_000, 50, 10_000
FORCE_DENSITY, RATE_DENSITY = 2e-3, 1e-4


def samples() -> np.ndarray:
    """Two minutes at rest, 100 Hz, white noise."""
    rng, root_rate = np.random.default_rng(3), 10.0
    noise = rng.normal(size=(N, 6)) * np.repeat([FORCE_DENSITY, RATE_DENSITY], 3) * root_rate
    return noise + np.array([0.0, 0.0, 9.81, 0.0, 0.0, 0.0])


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """The samples as a device sends them; ten seconds after the first one are missing."""
    values, data = samples(), b""
    for first in range(0, N, PER_MESSAGE):
        if 100 <= first < 1100:
            continue
        part = values[first : first + PER_MESSAGE]
        tow_ms = 345_600_000 + first * INTERVAL_US // 1000
        message = InertialMessage(4001, 1, 0, tow_ms, 0, INTERVAL_US, None, part[:, :3], part[:, 3:])
        data += frame(encode_inertial(message))
    path = tmp_path / "rest.rtcm3"
    path.write_bytes(data)
    return path


def test_the_recording_is_read(recording: Path) -> None:
    """Oracle: the samples, to the message's resolution; the interval and the gap of the stamps."""
    series, values = recorded_series(recording), np.delete(samples(), slice(100, 1100), axis=0)
    np.testing.assert_allclose(series.specific_force_m_s2, values[:, :3], atol=1e-5)
    np.testing.assert_allclose(series.angular_rate_rad_s, values[:, 3:], atol=1e-6)
    steps = np.unique(np.diff(series.t_gps_ns))
    np.testing.assert_array_equal(steps, [10_000_000, 10_010_000_000])


def test_densities(recording: Path, tmp_path: Path) -> None:
    """Oracle: the densities of the noise; what is written is taken by the filter's settings."""
    words = characterise(recording, "auto", 0.0, None, tmp_path / "noise.toml")
    assert words.splitlines()[0].endswith("109 s at 100.00 Hz")
    lines = (tmp_path / "noise.toml").read_text(encoding="utf-8").splitlines()
    found = {name.strip(): float(value) for name, _, value in (line.partition("=") for line in lines[1:])}
    assert found["accelerometer_noise_m_s2_sqrt_hz"] == pytest.approx(FORCE_DENSITY, rel=0.1)
    assert found["gyroscope_noise_rad_s_sqrt_hz"] == pytest.approx(RATE_DENSITY, rel=0.1)


def test_a_table_says_the_same(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the same samples through the other reader, and the command."""
    series = recorded_series(recording)
    with (tmp_path / "rest.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["t_s", "acc_x", "acc_y", "acc_z", "gyr_x", "gyr_y", "gyr_z"])
        for t_ns, force, rate in zip(
            series.t_gps_ns - series.t_gps_ns[0], series.specific_force_m_s2, series.angular_rate_rad_s, strict=True
        ):
            writer.writerow([f"{t_ns / 1e9:.3f}", *(f"{value:.7f}" for value in (*force, *rate))])
    assert cli.main(["characterise", str(recording)]) == 0
    of_recording = capsys.readouterr().out
    assert cli.main(["characterise", str(tmp_path / "rest.csv")]) == 0
    assert capsys.readouterr().out.splitlines()[2:4] == of_recording.splitlines()[2:4]
