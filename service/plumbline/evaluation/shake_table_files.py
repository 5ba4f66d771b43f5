"""Files of a shake-table experiment: what the simulator wrote, and what ``plumbline process`` made of it.

``experiment.json``, ``truth.csv`` and the streams stand in the folder itself, schemes' results in ``schemes/NAME.csv``.
"""

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from plumbline.errors import FileFormatError
from plumbline.evaluation.shake_table import SCHEMES, Series, Truth, mean_of, series_at, truth_of
from plumbline.records import Status

AVERAGED: Final = {"G123": ("G1", "G2", "G3")}  # not processed: the average of others
PHASE_SIGMA_M: Final = "0.003"  # what an operator would set on a platform beside walls: multipath, not noise
_NOT_FIXED: Final = frozenset(map(str, (Status.RTK_FLOAT, Status.CONVERGING, Status.SINGLE_POINT)))
_NS_PER_MS: Final = 1_000_000


def read_description(folder: Path) -> Mapping[str, Any]:
    """``experiment.json``; raises FileFormatError where it is none."""
    try:
        description: Mapping[str, Any] = json.loads((folder / "experiment.json").read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise FileFormatError(f"{folder / 'experiment.json'}: {error}") from error
    return description


def read_truth(folder: Path) -> Truth:
    """``truth.csv`` and the schedule; raises FileFormatError."""
    try:
        rows = np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1, ndmin=2)
    except ValueError as error:
        raise FileFormatError(f"{folder / 'truth.csv'}: {error}") from error
    return truth_of(read_description(folder), rows)


def result_path(folder: Path, scheme: str) -> Path:
    """Where a scheme's result stands."""
    return folder / "schemes" / f"{scheme}.csv"


def read_scheme(folder: Path, truth: Truth, scheme: str) -> Series:
    """A result of ``plumbline process``; rows without a position are missing. Raises FileFormatError."""
    path = result_path(folder, scheme)
    times, places, fixed = [], [], []
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            for row in csv.DictReader(stream):
                if row["e_m"]:
                    times.append(round(float(row["t_gps_s"]) * 1e3) * _NS_PER_MS)
                    places.append((float(row["e_m"]), float(row["n_m"]), float(row["u_m"])))
                    fixed.append(row["status"] not in _NOT_FIXED)
    except (KeyError, ValueError) as error:
        raise FileFormatError(f"{path}: {error!r}") from error
    return series_at(
        truth, scheme, np.array(times, np.int64), np.array(places, float).reshape(-1, 3), np.array(fixed, bool)
    )


def read_schemes(folder: Path, truth: Truth) -> dict[str, Series]:
    """All results that are there, in table 3's order, and the averages that they allow."""
    found = {s: read_scheme(folder, truth, s) for s in SCHEMES if result_path(folder, s).is_file()}
    for name, parts in AVERAGED.items():
        if name not in found and all(part in found for part in parts):
            found[name] = mean_of(name, [found[part] for part in parts])
    return {scheme: found[scheme] for scheme in SCHEMES if scheme in found}


def process_arguments(folder: Path, scheme: str) -> list[str]:
    """What ``plumbline process`` is to be given for a scheme; raises FileFormatError for an unknown one."""
    if scheme not in SCHEMES or scheme in AVERAGED:
        raise FileFormatError(f"{scheme!r} is no scheme to process: one of {[s for s in SCHEMES if s not in AVERAGED]}")
    description = read_description(folder)
    antennas = [int(digit) for digit in scheme.strip("GI")]
    rovers = [str(folder / f"antenna{k}.rtcm3") for k in antennas]
    common = [
        "--base", str(folder / "base.rtcm3"), "--base-position", _vector(description["base_ecef_m"]),
        "--systems", "GC", "--elevation-mask", "10", "--frequencies", "1", "--phase-sigma", PHASE_SIGMA_M,
        "--rover", rovers[0],
        "--output", str(result_path(folder, scheme)),
    ]  # fmt: skip
    if "I" not in scheme:
        reference = description["antennas_ecef_m"][antennas[0] - 1]
        return ["--mode", "rtk", "--reference", _vector(reference), *common]
    more = [part for k, rover in enumerate(rovers[1:], start=2) for part in (f"--rover{k}", rover)]
    return [
        "--mode", "rtk-imu-tight", "--reference", _vector(description["platform_ecef_m"]), *common, *more,
        "--imu", str(folder / "imu.rtcm3"), *_inertial_arguments(description, antennas),
    ]  # fmt: skip


def _inertial_arguments(description: Mapping[str, Any], antennas: Sequence[int]) -> list[str]:
    """Lever arms, the IMU as the paper's table 1 describes it, and the heading to align it with.

    Where one antenna alone is used, that heading is still the one that antennas have given at rest (Dai 2024, section
    2.2): half a metre of lever arm turns a degree of gyro-compassing into a centimetre.
    """
    arms = [_vector(description["lever_arms_body_m"][k - 1]) for k in antennas]
    known = (description["heading_by_antennas_deg"], description["heading_sigma_deg"]) if len(antennas) == 1 else ()
    heading = [f"{name}={value:.4f}" for name, value in zip(("--heading", "--heading-sigma"), known, strict=False)]
    return [f"--lever-arms={';'.join(arms)}", "--imu-characteristics", "atlans-c", *heading]


def _vector(values: Sequence[float]) -> str:
    return ",".join(f"{value:.5f}" for value in values)
