"""The command line's words for an IMU: options, data sheets, axes, lever arms."""

import argparse
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from pydantic import ValidationError

from plumbline.config import InertialSettings
from plumbline.constants import STANDARD_GRAVITY_M_S2
from plumbline.errors import ConfigurationError
from plumbline.files.imu import FORMATS

_G: Final = STANDARD_GRAVITY_M_S2
_OFFSET_SIGMA_S: Final = 0.2  # of a logger's stamps
_LOGGER_SHEET: Final = "icm-45686"
_AXES: Final = {"x": 0, "y": 1, "z": 2}

#: Characteristics by name; sources as noted. Biases at switching on are what a sheet calls repeatability.
SHEETS: Final[Mapping[str, Mapping[str, float]]] = {
    "atlans-c": {  # Dai 2024, table 1; switching on: ten times the instability
        "accelerometer_noise_m_s2_sqrt_hz": 0.046e-3 * _G,
        "gyroscope_noise_rad_s_sqrt_hz": math.radians(0.0035) / 60.0,
        "accelerometer_bias_sigma_m_s2": 0.0241e-3 * _G,
        "gyroscope_bias_sigma_rad_s": math.radians(0.0084) / 3600.0,
        "accelerometer_bias_time_s": 1000.0,
        "gyroscope_bias_time_s": 1000.0,
        "initial_accelerometer_bias_sigma_m_s2": 0.241e-3 * _G,
        "initial_gyroscope_bias_sigma_rad_s": math.radians(0.084) / 3600.0,
    },
    "adis16495": {  # de Alteriis 2022, section 2
        "accelerometer_noise_m_s2_sqrt_hz": 0.008 / 60.0,
        "gyroscope_noise_rad_s_sqrt_hz": math.radians(0.09) / 60.0,
        "accelerometer_bias_sigma_m_s2": 3.2e-6 * _G,
        "gyroscope_bias_sigma_rad_s": math.radians(0.8) / 3600.0,
        "accelerometer_bias_time_s": 300.0,
        "gyroscope_bias_time_s": 300.0,
        "initial_accelerometer_bias_sigma_m_s2": 3.5e-3 * _G,
        "initial_gyroscope_bias_sigma_rad_s": math.radians(0.2),
    },
    "icm-45686": {  # TDK's sheet (70 µg/√Hz, 0.0038 °/s/√Hz), ten times as noisy: what shakes it is sampled with it
        "accelerometer_noise_m_s2_sqrt_hz": 700e-6 * _G,
        "gyroscope_noise_rad_s_sqrt_hz": math.radians(0.038),
        "accelerometer_bias_sigma_m_s2": 0.02,
        "gyroscope_bias_sigma_rad_s": 2e-4,
        "accelerometer_bias_time_s": 600.0,
        "gyroscope_bias_time_s": 600.0,
        "initial_accelerometer_bias_sigma_m_s2": 0.1,
        "initial_gyroscope_bias_sigma_rad_s": math.radians(0.1),
        "standstill_force_sigma_m_s2": 0.05,
        "standstill_rate_sigma_rad_s": 0.005,
        "standstill_bias_sigma_rad_s": 2e-4,
    },
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the modes rtk-imu-loose and rtk-imu-tight."""
    group = parser.add_argument_group("modes rtk-imu-loose and rtk-imu-tight; several antennas also in mode rtk")
    group.add_argument("--imu", type=Path, metavar="FILE", help="samples: RTCM3 or a table")
    group.add_argument("--imu-format", choices=FORMATS, default="auto", help="of a table; plain-gps: GPS time")
    group.add_argument("--imu-characteristics", metavar="NAME|FILE",
                       help=f"a sheet ({', '.join(SHEETS)}), or what `plumbline characterise` wrote")  # fmt: skip
    group.add_argument("--imu-axes", metavar="RIGHT,FORWARD,UP", default="+x,+y,+z",
                       help="the sensor's axes that point right, forward, up: --imu-axes=+y,-x,+z")  # fmt: skip
    group.add_argument("--imu-time-offset", type=float, metavar="S", help="added to the samples' stamps")
    group.add_argument("--imu-time-offset-sigma", type=float, metavar="S",
                       help="loose: of that offset, estimated with its drift (with --positions 0.2)")  # fmt: skip
    group.add_argument("--lever-arms", metavar="R,F,U;...",
                       help="IMU to each antenna, m, right, forward, up: --lever-arms=0.3,0.5,0.8;...")  # fmt: skip
    for number in (2, 3, 4):
        group.add_argument(f"--rover{number}", type=Path, metavar="FILE", help=f"antenna {number} of the platform")
    group.add_argument("--station-ids", metavar="ID,ID,…",
                       help="several antennas in one recording: their station ids, as --lever-arms")  # fmt: skip
    group.add_argument("--positions", type=Path, metavar="FILE", help="loose: a receiver's positions, RTKLIB's .pos")
    group.add_argument("--velocity-delay", type=float, metavar="S",
                       help="loose: how old the positions' velocities are (default: found in --positions)")  # fmt: skip
    group.add_argument("--forward", action="store_true", help="loose: what the filter said at the time, not smoothed")
    group.add_argument("--outages", default="", metavar="START,LENGTH;...",
                       help="loose: withhold positions, s after the first, and print what that costs")  # fmt: skip
    group.add_argument("--heading", type=float, metavar="DEG", help="known heading of the forward axis at the start")
    group.add_argument("--heading-sigma", type=float, metavar="DEG")
    group.add_argument("--phase-correlation", type=float, metavar="S", help="tight: how long a phase's multipath lasts")
    group.add_argument("--every-sample", action="store_true", help="tight: a row a sample, not one an epoch")


def inertial_settings(options: argparse.Namespace, *, of_a_logger: bool = False) -> InertialSettings:
    """Settings of the filters; raises ConfigurationError saying what is wrong.

    A logger's stamps are not trusted, unless the options say so; those of a device of ours are. A logger's sensor is
    taken for a common one where its characteristics are not given.
    """
    values: dict[str, object] = {"inertial_time_offset_sigma_s": _OFFSET_SIGMA_S} if of_a_logger else {}
    values |= characteristics(options.imu_characteristics or (_LOGGER_SHEET if of_a_logger else None))
    given = {
        "inertial_time_offset_s": options.imu_time_offset,
        "inertial_time_offset_sigma_s": options.imu_time_offset_sigma,
        "velocity_delay_s": options.velocity_delay,
        "phase_correlation_s": options.phase_correlation,
        "heading_deg": options.heading,
        "heading_sigma_deg": options.heading_sigma,
        "lever_arms_body_m": None if options.lever_arms is None else lever_arms(options.lever_arms),
        "rotation_body_from_sensor": axes(options.imu_axes),
    }
    values |= {key: value for key, value in given.items() if value is not None}
    try:
        return InertialSettings.model_validate(values)
    except ValidationError as error:
        raise ConfigurationError(f"IMU settings: {error}") from error


def further_antennas(options: argparse.Namespace) -> tuple[Path, ...]:
    """Recordings of the second antenna and the ones after it."""
    return tuple(path for path in (options.rover2, options.rover3, options.rover4) if path is not None)


def platform_settings(options: argparse.Namespace) -> dict[str, object]:
    """A station's settings that several antennas and an IMU want; raises ConfigurationError saying what is wrong."""
    inertial, ids, further = inertial_settings(options), _station_ids(options.station_ids), further_antennas(options)
    arms, n = len(inertial.lever_arms_body_m), max(len(ids), 1) + len(further)
    if n > 1 and arms != n:
        given = "none given" if options.lever_arms is None else f"{arms} given"
        raise ConfigurationError(f"{n} antennas want --lever-arms with as many vectors, {given}")
    if arms > n:
        raise ConfigurationError(
            f"--lever-arms gives {arms} vectors for {n} antenna: give the others' recordings (--rover2 …) or, where "
            "all are in one, --station-ids"
        )
    streams = [f"antenna-{number}" for number in range(n - len(further) + 1, n + 1)]
    return {"inertial": inertial, "antenna_streams": streams, "device": {"rtcm_station_ids": ids},
            "inertial_stream": "imu" if options.imu is not None else None}  # fmt: skip


def _station_ids(text: str | None) -> tuple[int, ...]:
    try:
        return () if text is None else tuple(int(part) for part in text.split(","))
    except ValueError as error:
        raise ConfigurationError(f"--station-ids wants numbers, 1,2,3: {error}") from error


def characteristics(name: str | None) -> Mapping[str, float]:
    """Values of a sheet by name, or of a file; none without a name."""
    if name is None:
        return {}
    if name.lower() in SHEETS:
        return SHEETS[name.lower()]
    try:
        return tomllib.loads(Path(name).read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigurationError(f"{name}: neither a file nor one of {', '.join(SHEETS)}") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(f"{name}: {error}") from error


def lever_arms(text: str) -> list[tuple[float, ...]]:
    """Vectors of ``x,y,z;x,y,z``."""
    try:
        arms = [tuple(float(part) for part in arm.split(",")) for arm in text.split(";")]
    except ValueError as error:
        raise ConfigurationError(f"--lever-arms: {error}") from error
    if any(len(arm) != 3 for arm in arms):
        raise ConfigurationError("--lever-arms wants three numbers an antenna: R,F,U;R,F,U")
    return arms


def axes(text: str) -> tuple[tuple[float, ...], ...]:
    """Rotation, body (right, forward, up) from sensor, of words such as ``+y,-x,+z``."""
    rows = []
    for word in text.lower().split(","):
        if word.strip("+-") not in _AXES or len(word) > 2:
            raise ConfigurationError(f"--imu-axes: {word!r} is no axis; want for example +y,-x,+z")
        row = [0.0, 0.0, 0.0]
        row[_AXES[word[-1]]] = -1.0 if word.startswith("-") else 1.0
        rows.append(tuple(row))
    determinant = (
        sum(
            rows[0][i] * (rows[1][(i + 1) % 3] * rows[2][(i + 2) % 3] - rows[1][(i + 2) % 3] * rows[2][(i + 1) % 3])
            for i in range(3)
        )
        if len(rows) == 3
        else 0.0
    )
    if determinant != 1.0:
        raise ConfigurationError("--imu-axes wants three different axes that make a right-handed frame")
    return tuple(rows)
