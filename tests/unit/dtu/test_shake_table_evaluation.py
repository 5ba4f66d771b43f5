"""The evaluation of the shaking table, on series whose errors are known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from plumbline import cli
from plumbline.errors import ConfigurationError, FileFormatError
from plumbline.evaluation import shake_table_files as files
from plumbline.evaluation.command import _schemes
from plumbline.evaluation.shake_table import (
    MEANS,
    PAPER_MM,
    SCHEMES,
    Scatter,
    Series,
    Truth,
    improvements,
    in_the_papers_order,
    lines_of,
    mean_of,
    scatter_of,
    series_at,
)
from plumbline.evaluation.shake_table_figures import write_figures
from plumbline.evaluation.shake_table_report import report
from plumbline_dtu.shake_table.experiment import Experiment, schedule, table_direction_enu
from plumbline_dtu.shake_table.write import _write_description, _write_truth

SHORT = Experiment(schedule=schedule(rest_s=60.0, minute_s=30.0, pause_s=5.0, between_s=20.0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("table")
    _write_description(SHORT, path / "experiment.json")
    _write_truth(SHORT, path / "truth.csv")
    return path


@pytest.fixture(scope="module")
def truth(folder: Path) -> Truth:
    return files.read_truth(folder)


def with_error(truth: Truth, name: str, along_m: np.ndarray) -> Series:
    direction = table_direction_enu()
    return Series(name, truth.displacement_enu_m + np.outer(along_m, direction), np.ones(len(along_m), bool))


def test_truth_is_read_as_written(truth: Truth) -> None:
    """Oracle: the experiment itself."""
    assert truth.rate_hz == 20
    assert truth.rest_s == 60.0
    assert [v.parts for v in truth.vibrations] == [v.parts for v in SHORT.schedule.vibrations]
    np.testing.assert_allclose(truth.displacement_enu_m @ truth.direction_enu, truth.along_m, atol=2e-6)
    assert np.all(np.diff(truth.t_gps_ns) == 50_000_000)


def test_scatter_by_period(truth: Truth) -> None:
    """Oracle: the scatter that was put in, 3 mm at rest and 5 mm after; a constant offset counts for nothing."""
    error = np.random.default_rng(1).normal(0.0, 1.0, len(truth.t_gps_ns)) * 3e-3
    error[truth.since_s >= truth.rest_s] *= 5.0 / 3.0
    series = with_error(truth, "G1", error + 0.1)
    across = np.random.default_rng(2).normal(0.0, 0.004, len(error))
    sideways = series.displacement_enu_m + np.outer(across, [truth.direction_enu[1], -truth.direction_enu[0], 0.0])
    found = scatter_of(truth, replace(series, displacement_enu_m=sideways))
    assert found.rest_m == pytest.approx(3e-3, rel=0.1)
    assert found.shaking_m == pytest.approx(5e-3, rel=0.05)
    assert found.both_m == pytest.approx(np.std(error), rel=1e-3)
    assert found.horizontal_m == pytest.approx(np.hypot(np.std(error), np.std(across)), rel=1e-3)
    assert (found.missing, found.not_fixed) == (0, 0)


def test_rows_at_another_rate(truth: Truth) -> None:
    """Oracle: a hundred-hertz copy of a ramp, half of it missing, one row float."""
    t_ns = truth.t_gps_ns[0] + 10_000_000 * np.arange(5 * len(truth.t_gps_ns) // 2, dtype=np.int64)
    ramp = np.outer((t_ns - t_ns[0]) * 1e-9, [1.0, 2.0, 3.0])
    fixed = np.ones(len(t_ns), bool)
    fixed[5] = False
    series = series_at(truth, "GI1", t_ns, ramp, fixed)
    half = len(truth.t_gps_ns) // 2
    np.testing.assert_allclose(series.displacement_enu_m[:half, 1], 2.0 * truth.since_s[:half], atol=1e-9)
    assert np.isnan(series.displacement_enu_m[half:]).all()
    found = scatter_of(truth, series)
    assert (found.missing, found.not_fixed) == (len(truth.t_gps_ns) - half, 1)
    assert np.isnan(scatter_of(truth, series_at(truth, "G1", t_ns[:0], ramp[:0], fixed[:0])).both_m)


def test_average_of_three(truth: Truth) -> None:
    """Oracle: independent errors of equal size fall by the root of three; one that is missing makes it missing."""
    random = np.random.default_rng(5)
    parts = [with_error(truth, f"G{k}", random.normal(0.0, 3e-3, len(truth.t_gps_ns))) for k in (1, 2, 3)]
    assert scatter_of(truth, mean_of("G123", parts)).both_m == pytest.approx(3e-3 / np.sqrt(3.0), rel=0.05)
    holed = parts[2].displacement_enu_m.copy()
    holed[7] = np.nan
    assert scatter_of(truth, mean_of("G123", [*parts[:2], Series("G3", holed, parts[2].fixed)])).missing == 1


def test_lines(truth: Truth) -> None:
    """Oracle: the sines that the table was told; a scheme 2 mm short says so; a false frequency is seen."""
    lines = lines_of(truth, with_error(truth, "G1", np.zeros(len(truth.t_gps_ns))))
    assert [line.frequency_hz for line in lines] == [0.50, 0.67, 0.11, 0.34, 0.80] * 2
    assert all(line.frequency_exact and line.amplitude_error_m == pytest.approx(0.0, abs=1e-5) for line in lines)
    assert all(abs(line.laser_hz - line.frequency_hz) <= 0.5 / 30.0 + 1e-9 for line in lines)
    assert lines[0].laser_m == pytest.approx(0.019, abs=1e-4)
    short = lines_of(truth, with_error(truth, "G1", -truth.along_m * 2.0 / 19.0))
    assert short[0].amplitude_error_m == pytest.approx(-2e-3, rel=0.01)
    wobble = 0.05 * np.sin(2.0 * np.pi * 0.6 * truth.since_s)
    assert not lines_of(truth, with_error(truth, "G1", wobble))[0].frequency_exact


def paper() -> dict[str, Scatter]:
    return {s: Scatter(*(1e-3 * value for value in PAPER_MM[s]), np.nan, 0, 0) for s in SCHEMES}


def test_the_papers_own_table() -> None:
    """Oracle: the percentages, means and sentences of Dai 2024, section 3, from its table 3."""
    gains = improvements(paper())
    assert gains == pytest.approx({"mean G": 0.3299, "mean GI": 0.3029, "mean GI, two": 0.1419}, abs=2e-3)
    assert all(in_the_papers_order(paper()).values())
    for name, schemes in MEANS.items():
        assert np.mean([PAPER_MM[scheme][0] for scheme in schemes]) == pytest.approx(PAPER_MM[name][0], abs=0.006)
    worse = paper() | {"GI123": paper()["G2"]}
    assert [s for s, holds in in_the_papers_order(worse).items() if not holds] == [
        "three are better than two", "the IMU improves on averaging",
    ]  # fmt: skip


def test_files_report_and_figures(folder: Path, truth: Truth) -> None:
    """Oracle: series written as `plumbline process` writes them come back; every figure is a PNG."""
    random = np.random.default_rng(9)
    (folder / "schemes").mkdir(exist_ok=True)
    for scheme in ("G1", "G2", "G3", "GI123"):
        series = with_error(truth, scheme, random.normal(0.0, 2e-3, len(truth.t_gps_ns)))
        lines = ["t_gps_s,status,e_m,n_m,u_m"]
        for t_ns, (e, n, u) in zip(truth.t_gps_ns, series.displacement_enu_m, strict=True):
            lines.append(f"{t_ns / 1e9:.6f},rtk_fixed,{e:.5f},{n:.5f},{u:.5f}")
        lines[5] = lines[5].split(",")[0] + ",no_base,,,"
        files.result_path(folder, scheme).write_text("\n".join(lines) + "\n", encoding="utf-8")
    found = files.read_schemes(folder, truth)
    assert list(found) == ["G1", "G2", "G3", "G123", "GI123"]
    text = report(truth, found)
    assert "every peak in the laser's bin: yes" in text
    g1 = next(line for line in text.splitlines() if line.startswith("G1 "))
    assert float(g1.split()[1]) == pytest.approx(2.0, abs=0.1)
    assert "(3.87)" in g1
    assert g1.split()[-2:] == ["1", "0"]
    figures = write_figures(truth, found, folder / "figures")
    assert len(figures) == 5
    assert all(path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n" for path in figures)


def test_arguments_are_those_of_the_command_line(folder: Path) -> None:
    """Oracle: the command line's own parser; what is no scheme is refused in words."""
    options = cli._parser().parse_args(["process", *cli._with_joined_vectors(files.process_arguments(folder, "G2"))])
    assert options.mode == "rtk"
    assert options.rover == [folder / "antenna2.rtcm3"]
    assert np.linalg.norm(np.subtract(options.base_position, options.reference)) == pytest.approx(50.0, abs=1.5)
    for name in ("G4", "G123", "GI", ""):
        with pytest.raises(FileFormatError):
            files.process_arguments(folder, name)
    assert _schemes(["G123,GI1"]) == ["G1", "G2", "G3", "GI1"]
    assert len(_schemes(["all"])) == 10
    with pytest.raises(ConfigurationError, match="G4"):
        _schemes(["G4"])


def test_folders_that_are_none(tmp_path: Path) -> None:
    """Oracle: the message names the file."""
    (tmp_path / "experiment.json").write_text("{}")
    (tmp_path / "truth.csv").write_text("t\nx\n")
    with pytest.raises(FileFormatError, match=r"truth\.csv"):
        files.read_truth(tmp_path)
    (tmp_path / "truth.csv").write_text("t_gps_s,along_m,e_m,n_m,u_m\n1,2,3,4,5\n")
    with pytest.raises(FileFormatError, match="schedule"):
        files.read_truth(tmp_path)
