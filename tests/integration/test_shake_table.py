"""The shaking table from end to end: simulated streams, `plumbline process`, `plumbline evaluate`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from plumbline import cli
from plumbline.evaluation import shake_table_files as files
from plumbline.evaluation.shake_table import lines_of, scatter_of
from plumbline_dtu.shake_table.experiment import Experiment, Levels, schedule
from plumbline_dtu.shake_table.write import simulate

_WHOLE = schedule(rest_s=20.0, minute_s=14.0, pause_s=2.0, between_s=2.0)
_PLAN = replace(_WHOLE, vibrations=_WHOLE.vibrations[:2], duration_s=54.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first two vibrations, a minute in all, among milder reflections than the paper's."""
    path = tmp_path_factory.mktemp("table")
    simulate(Experiment(3, _PLAN, Levels(platform_reflection=0.15)), path)
    (path / "schemes").mkdir()
    return path


def process(folder: Path, scheme: str) -> None:
    assert cli.main(["process", *files.process_arguments(folder, scheme)]) == 0


def test_single_antennas_and_their_average(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the simulator's truth: millimetres, the table's frequencies, and the average better than its parts."""
    for scheme in ("G1", "G2", "G3"):
        process(folder, scheme)
    truth = files.read_truth(folder)
    found = files.read_schemes(folder, truth)
    scatters = {name: scatter_of(truth, series) for name, series in found.items()}
    assert list(found) == ["G1", "G2", "G3", "G123"]
    for scheme in ("G1", "G2", "G3"):
        assert scatters[scheme].missing == 0
        assert scatters[scheme].not_fixed < 0.5 * len(truth.t_gps_ns)
        assert scatters[scheme].both_m < 3e-3
    assert scatters["G123"].both_m < min(scatters[s].both_m for s in ("G1", "G2", "G3"))
    lines = lines_of(truth, found["G1"])
    assert [line.frequency_hz for line in lines] == [0.50, 0.67]
    assert all(line.frequency_exact for line in lines)
    assert max(abs(line.amplitude_error_m) for line in lines) < 1.5e-3
    capsys.readouterr()
    assert cli.main(["evaluate", "shake-table", str(folder)]) == 0
    printed = capsys.readouterr().out
    assert "every peak in the laser's bin: yes" in printed
    assert printed.count(".png") == 5


def test_antennas_with_the_imu(folder: Path) -> None:
    """Oracle: the simulator's truth: three antennas with the IMU are better than one, and follow every vibration."""
    for scheme in ("GI1", "GI123"):
        process(folder, scheme)
    truth = files.read_truth(folder)
    one, three = (files.read_scheme(folder, truth, scheme) for scheme in ("GI1", "GI123"))
    assert scatter_of(truth, three).both_m < min(scatter_of(truth, one).both_m, 2e-3)
    assert scatter_of(truth, three).missing < 20 * truth.rest_s
    lines = lines_of(truth, three)
    assert [line.frequency_hz for line in lines] == [0.50, 0.67]
    assert all(line.frequency_exact for line in lines)
    assert max(abs(line.amplitude_error_m) for line in lines) < 1.5e-3


def test_the_command_simulates(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: the files that it says it writes; a scheme that there is not is refused before anything is made."""
    from plumbline_dtu.shake_table import experiment

    brief = replace(_PLAN, duration_s=2.0)
    monkeypatch.setattr(experiment, "Experiment", lambda seed: Experiment(seed, brief))
    assert cli.main(["simulate", "shake-table", "--seed", "4", "--out", str(tmp_path / "a"), "--schemes", "G9"]) == 2
    assert "G9" in capsys.readouterr().err
    assert not (tmp_path / "a").exists()
    assert cli.main(["simulate", "shake-table", "--seed", "4", "--out", str(tmp_path / "a"), "--schemes", "G2"]) == 0
    names = {path.name for path in (tmp_path / "a").iterdir()}
    assert names == {"base.rtcm3", "antenna1.rtcm3", "antenna2.rtcm3", "antenna3.rtcm3", "imu.rtcm3", "truth.csv",
                     "experiment.json", "schemes"}  # fmt: skip
    assert np.loadtxt(tmp_path / "a" / "truth.csv", delimiter=",", skiprows=1).shape == (40, 5)
    assert len((tmp_path / "a" / "schemes" / "G2.csv").read_text().splitlines()) == 41
