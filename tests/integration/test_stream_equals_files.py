"""A station's day as RTCM streams and as files. Oracle: the same positions; RTCM's quantisation is all that may differ.

Phases are sent to 0.14 mm (0.4 mm ionosphere-free), orbits to 0.1 mm radially and 0.4 mm along and across.
"""

import csv
from pathlib import Path

import numpy as np
import pytest

from plumbline import cli
from plumbline_dtu.convert import Conversion, convert

pytestmark = pytest.mark.realdata
THREE_HOURS, ALL = 360, 1440  # epochs
SETTLED_S = 3600
COMMON = ["--mode", "ppp", "--kinematic", "--systems", "GE", "--reference", "3582104.7628,532590.1800,5232755.1333"]
COMMON += ["--antenna-height", "0.2160"]


def processed(output: Path, *arguments: str) -> dict[int, np.ndarray]:
    """East, north, up, mm, by second, as `plumbline process` writes them."""
    assert cli.main(["process", *COMMON, *arguments, "--output", str(output)]) == 0
    with output.open() as file:
        rows = [row for row in csv.DictReader(file) if row["e_m"]]
    return {round(float(row["t_gps_s"])): 1e3 * np.array([float(row[f"{c}_m"]) for c in "enu"]) for row in rows}


@pytest.mark.parametrize(
    ("antex", "n_epochs"),
    [(False, THREE_HOURS), (True, THREE_HOURS), pytest.param(True, ALL, marks=pytest.mark.soak)],
)
def test_positions_from_streams_are_those_from_files(
    data_dir: Path, tmp_path: Path, antex: bool, n_epochs: int
) -> None:
    folder = data_dir / "esbc-2020-177"
    obs, nav = sorted(folder.glob("*_MO.rnx.gz")), sorted(folder.glob("*_MN.rnx.gz"))
    sp3, clk = sorted(folder.glob("*.SP3.gz")), sorted(folder.glob("*.CLK.gz"))
    atx = folder / "approx-igs14.atx" if antex else None
    convert(Conversion(obs, nav, tmp_path, sp3, clk, max_epochs=n_epochs, systems="GE", antex=atx))
    calibrations = ["--antex", str(atx)] if antex else []
    inputs = ["--obs", *obs, "--nav", *nav, "--sp3", *sp3, "--clk", *clk]
    files = processed(tmp_path / "files.csv", *map(str, inputs), *calibrations)
    inputs = ["--obs", tmp_path / "observations.rtcm3", "--ssr", tmp_path / "corrections.rtcm3"]
    streams = processed(tmp_path / "streams.csv", *map(str, inputs), *calibrations)
    start = min(streams)
    assert len(streams) == n_epochs
    settled = [t for t in streams if t - start >= SETTLED_S]
    difference = np.array([streams[t] - files[t] for t in settled])
    size = np.abs(difference)
    print("rms, 99 %, max mm", np.sqrt((size**2).mean(axis=0)), np.quantile(size, 0.99, axis=0), size.max(axis=0))
    assert (np.sqrt((size**2).mean(axis=0)) <= [0.2, 0.2, 0.4]).all()
    assert size.max() <= 1.0
