"""`plumbline process --mode rtk-imu-tight` over simulated recordings of a shaken platform.

Oracle: the simulator's truth: millimetres, the platform's angles, integers from the first second on.
"""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from plumbline import cli
from plumbline.evaluation import shake_table_files as files
from plumbline_dtu.shake_table.experiment import HEADING_DEG, PITCH_DEG, ROLL_DEG, Experiment, Levels, schedule
from plumbline_dtu.shake_table.write import simulate


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten seconds of rest, then half a Hertz, without reflections."""
    path = tmp_path_factory.mktemp("table")
    whole = schedule(rest_s=10.0, minute_s=20.0)
    plan = replace(whole, vibrations=whole.vibrations[:1], duration_s=25.0)
    simulate(Experiment(2, plan, Levels(platform_reflection=0.0, base_reflection=0.0)), path)
    (path / "schemes").mkdir()
    return path


@pytest.mark.parametrize(("scheme", "limit_mm"), [("GI123", 1.5), ("GI12", 2.0), ("GI1", 3.0)])
def test_schemes(folder: Path, scheme: str, limit_mm: float) -> None:
    assert cli.main(["process", *files.process_arguments(folder, scheme)]) == 0
    truth = np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1)
    with files.result_path(folder, scheme).open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(truth)
    assert all(row["reason"] for row in rows if not row["e_m"])
    rows = [row for row in rows if row["e_m"]]
    assert len(rows) > 0.6 * len(truth)
    late = rows[40:]  # integers are held once they have been the same for a second
    assert np.mean([row["status"] == "rtk_fixed" for row in late]) > 0.95
    times = np.array([float(row["t_gps_s"]) for row in late])
    place = np.array([[float(row["e_m"]), float(row["n_m"])] for row in late])
    error = place - np.column_stack([np.interp(times, truth[:, 0], truth[:, k]) for k in (2, 3)])
    scatter_mm = 1e3 * np.sqrt((error.std(axis=0) ** 2).sum())
    print(scheme, f"{scatter_mm:.2f} mm")
    assert scatter_mm < limit_mm
    angles = np.array([[float(row[f"{name}_deg"]) for name in ("heading", "pitch", "roll")] for row in late[-100:]])
    off = np.abs(angles.mean(axis=0) - [HEADING_DEG, PITCH_DEG, ROLL_DEG])
    assert (off < ([0.2, 0.1, 0.1] if scheme == "GI123" else [2.0, 0.5, 0.5])).all(), off
    if scheme == "GI123":
        print("scatter of heading, pitch, roll:", np.round(angles.std(axis=0), 4))
        assert (angles.std(axis=0) < [0.03, 0.02, 0.02]).all()
