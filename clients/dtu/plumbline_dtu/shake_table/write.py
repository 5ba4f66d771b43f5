"""The experiment's files: five streams, the truth, and what a processing needs to know."""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np

from plumbline.gps_time import NS_PER_S
from plumbline_dtu.shake_table import imu, receiver
from plumbline_dtu.shake_table.experiment import (
    GNSS_RATE_HZ,
    HEADING_DEG,
    HEADING_SIGMA_DEG,
    IMU_RATE_HZ,
    PITCH_DEG,
    ROLL_DEG,
    START_GPS_NS,
    Experiment,
    lever_arms_body_m,
    table_direction_enu,
    table_motion,
)

STREAMS = ("base", "antenna1", "antenna2", "antenna3")


def simulate(experiment: Experiment, out: Path, report: Callable[[float], None] = lambda fraction: None) -> None:
    """Write ``base``, ``antenna1`` … ``antenna3`` and ``imu`` as ``.rtcm3``, ``truth.csv`` and ``experiment.json``.

    ``report`` hears what fraction is done.
    """
    out.mkdir(parents=True, exist_ok=True)
    _write_description(experiment, out / "experiment.json")
    _write_truth(experiment, out / "truth.csv")
    n_epochs = round(experiment.schedule.duration_s) * GNSS_RATE_HZ
    for station, name in enumerate(STREAMS):
        with (out / f"{name}.rtcm3").open("wb") as stream:
            for k, (_, data) in enumerate(receiver.receive(experiment, station)):
                stream.write(data)
                if k % (10 * GNSS_RATE_HZ) == 0:
                    report((station + k / n_epochs) / len(STREAMS))
    with (out / "imu.rtcm3").open("wb") as stream:
        for _, data in imu.sample(experiment):
            stream.write(data)
    report(1.0)


def _write_description(experiment: Experiment, path: Path) -> None:
    rest = [receiver.antenna_ecef_m(experiment, station).tolist() for station in (1, 2, 3)]
    description = {
        "seed": experiment.seed,
        "start_gps_s": START_GPS_NS // NS_PER_S,
        "gnss_rate_hz": GNSS_RATE_HZ,
        "imu_rate_hz": IMU_RATE_HZ,
        "base_ecef_m": experiment.base_ecef_m.tolist(),
        "platform_ecef_m": experiment.platform_ecef_m.tolist(),
        "antennas_ecef_m": rest,
        "lever_arms_body_m": lever_arms_body_m().tolist(),
        "attitude_deg": {"roll": ROLL_DEG, "pitch": PITCH_DEG, "heading": HEADING_DEG},
        "heading_by_antennas_deg": HEADING_DEG
        + HEADING_SIGMA_DEG * np.random.default_rng([experiment.seed, 41]).normal(),
        "heading_sigma_deg": HEADING_SIGMA_DEG,
        "table_direction_enu": table_direction_enu().tolist(),
        "schedule": asdict(experiment.schedule),
        "levels": asdict(experiment.levels),
        "imu": asdict(experiment.imu),
    }
    path.write_text(json.dumps(description, indent=1) + "\n", encoding="utf-8")


def _write_truth(experiment: Experiment, path: Path) -> None:
    """What the laser would have said: displacement along the table and ENU, m, at the GNSS epochs."""
    n = round(experiment.schedule.duration_s) * GNSS_RATE_HZ
    times = START_GPS_NS + NS_PER_S // GNSS_RATE_HZ * np.arange(n, dtype=np.int64)
    displacement = table_motion(experiment.schedule, times).displacement_m
    along = displacement @ table_direction_enu()
    with path.open("w", encoding="ascii") as file:
        file.write("t_gps_s,along_m,e_m,n_m,u_m\n")
        for t_ns, laser_m, (east, north, up) in zip(times.tolist(), along.tolist(), displacement.tolist(), strict=True):
            whole, rest = divmod(t_ns, NS_PER_S)
            file.write(f"{whole}.{rest // 1000:06d},{laser_m:.6f},{east:.6f},{north:.6f},{up:.6f}\n")
