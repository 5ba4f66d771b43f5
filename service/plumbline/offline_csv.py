"""The rows that `plumbline process` writes: solutions or samples of motion, one CSV for every mode."""

import csv
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from plumbline.config import Mode
from plumbline.gps_time import NS_PER_S
from plumbline.positioning.solutions import rotation_at
from plumbline.quality.report import log_line
from plumbline.records import Floats, Motion, Output, QualityReport, Solution

ATTITUDE_COLUMNS: Final = (
    "roll_deg", "pitch_deg", "heading_deg", "sigma_roll_deg", "sigma_pitch_deg", "sigma_heading_deg",
)  # fmt: skip
COLUMNS: Final = (
    "t_gps_s", "status", "n_satellites", "e_m", "n_m", "u_m", "sigma_e_m", "sigma_n_m", "sigma_u_m",
    "x_ecef_m", "y_ecef_m", "z_ecef_m", "ve_m_s", "vn_m_s", "vu_m_s", "ae_m_s2", "an_m_s2", "au_m_s2",
    "systems", "zenith_delay_m", "correction_age_s", "pdop", *ATTITUDE_COLUMNS, "reason",
)  # fmt: skip
_SAMPLED: Final = (Mode.PPP_ACCEL, Mode.RTK_IMU_LOOSE)
_WITH_IMU: Final = (Mode.RTK_IMU_LOOSE, Mode.RTK_IMU_TIGHT)


def write_csv(path: Path, outputs: Sequence[Output], mode: Mode, every_sample: bool = False) -> int:
    """Solutions, or in the modes that give motion by the sample its last revision; returns the number of rows.

    The attitude's columns are there in the modes with an IMU, and where several antennas gave one.
    """
    sampled = mode in _SAMPLED or (every_sample and mode in _WITH_IMU)
    rows = _motion_rows(outputs) if sampled else _solution_rows(outputs)
    turned = mode in _WITH_IMU or any(isinstance(o, Solution) and o.attitude_rad is not None for o in outputs)
    kept = [k for k, name in enumerate(COLUMNS) if turned or name not in ATTITUDE_COLUMNS]
    count = 0
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow([COLUMNS[k] for k in kept])
        for count, row in enumerate(rows, start=1):  # noqa: B007
            writer.writerow([row[k] for k in kept])
    return count


def write_quality_log(path: Path, outputs: Sequence[Output]) -> int:
    """Quality reports as JSON lines, one an epoch; returns their number."""
    reports = [output for output in outputs if isinstance(output, QualityReport)]
    with path.open("w", encoding="utf-8") as stream:
        stream.writelines(log_line(report) + "\n" for report in reports)
    return len(reports)


def _solutions(outputs: Sequence[Output]) -> list[Solution]:
    """The last word on each epoch, in order of time; one without a position takes none away."""
    found: dict[int, Solution] = {}
    for output in outputs:
        if isinstance(output, Solution) and (output.status.has_position or output.t_gps_ns not in found):
            found[output.t_gps_ns] = output
    return [found[t] for t in sorted(found)]


def _blocks(outputs: Sequence[Output]) -> list[Motion]:
    """The last revision of each block, in order of time."""
    found = {output.t_first_gps_ns: output for output in outputs if isinstance(output, Motion)}
    return [found[t] for t in sorted(found)]


def seconds_text(t_gps_ns: int) -> str:
    """GPS time as seconds since 1980-01-06, to the microsecond."""
    whole, fraction = divmod(t_gps_ns, NS_PER_S)
    return f"{whole}.{fraction:09d}"[:-3]


def _numbers(values: Iterable[float] | None, digits: int) -> list[str]:
    return [""] * 3 if values is None else [f"{value:.{digits}f}" for value in values]


def _one(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def _attitude(angles_rad: Floats | None, sigmas_rad: Floats | None) -> list[str]:
    values = np.full(6, np.nan)
    if angles_rad is not None and sigmas_rad is not None:
        values = np.degrees(np.concatenate([angles_rad, sigmas_rad]))
    return ["" if np.isnan(value) else f"{value:.5f}" for value in values]


def _solution_rows(outputs: Sequence[Output]) -> Iterator[list[str | int]]:
    """One row an epoch, its acceleration that of the sample at its instant, where there is one."""
    blocks = {block.t_first_gps_ns // NS_PER_S: block for block in _blocks(outputs)}
    for solution in _solutions(outputs):
        block = blocks.get(solution.t_gps_ns // NS_PER_S)
        yield _solution_row(solution, None if block is None else _acceleration_at(block, solution.t_gps_ns))


def _acceleration_at(block: Motion, t_gps_ns: int) -> Floats | None:
    index = round((t_gps_ns - block.t_first_gps_ns) / block.interval_ns)
    acceleration = block.acceleration_enu_m_s2
    if not 0 <= index < len(acceleration) or np.isnan(acceleration[index]).any():
        return None
    return np.asarray(acceleration[index], np.float64)


def _solution_row(solution: Solution, acceleration_enu_m_s2: Floats | None) -> list[str | int]:
    covariance = solution.covariance_enu_m2
    return [
        seconds_text(solution.t_gps_ns),
        solution.status,
        solution.n_satellites,
        *_numbers(solution.displacement_enu_m, 5),
        *_numbers(None if covariance is None else np.sqrt(np.diag(covariance)), 5),
        *_numbers(solution.position_ecef_m, 5),
        *_numbers(solution.velocity_enu_m_s, 5),
        *_numbers(acceleration_enu_m_s2, 5),
        solution.systems,
        _one(solution.zenith_delay_m, 5),
        _one(solution.correction_age_s, 3),
        _one(solution.pdop, 3),
        *_attitude(solution.attitude_rad, solution.sigma_attitude_rad),
        solution.reason,
    ]


def _motion_rows(outputs: Sequence[Output]) -> Iterator[list[str | int]]:
    """One row a sample; the facts of the position are those of the last solution at or before it."""
    solutions = _solutions(outputs)
    at, reference = -1, _reference(solutions)
    for block in _blocks(outputs):
        places = _places(block, reference)
        for i in range(len(block.displacement_enu_m)):
            t_ns = block.t_first_gps_ns + i * block.interval_ns
            while at + 1 < len(solutions) and solutions[at + 1].t_gps_ns <= t_ns:
                at += 1
            place = None if places is None else places[i]
            yield _motion_row(block, i, t_ns, place, solutions[at] if at >= 0 else None)


def _reference(solutions: Sequence[Solution]) -> Floats | None:
    """The reference position, Earth-fixed, that displacements count from, as the first solution with both tells it."""
    for solution in solutions:
        position, displacement = solution.position_ecef_m, solution.displacement_enu_m
        if position is not None and displacement is not None:
            return np.asarray(position - rotation_at(position).T @ displacement, np.float64)
    return None


def _places(block: Motion, reference: Floats | None) -> Floats | None:
    """Earth-fixed positions (n, 3) of a block's samples."""
    if reference is None:
        return None
    return np.asarray(reference + block.displacement_enu_m @ rotation_at(reference), np.float64)


def _motion_row(block: Motion, i: int, t_ns: int, place: Floats | None, solution: Solution | None) -> list[str | int]:
    return [
        seconds_text(t_ns),
        block.status,
        solution.n_satellites if solution else 0,
        *_numbers(block.displacement_enu_m[i], 5),
        *_numbers(block.sigma_displacement_enu_m[i], 5),
        *_numbers(place, 5),
        *_numbers(block.velocity_enu_m_s[i], 6),
        *_numbers(block.acceleration_enu_m_s2[i], 6),
        solution.systems if solution else "",
        _one(solution.zenith_delay_m if solution else None, 5),
        _one(solution.correction_age_s if solution else None, 3),
        _one(solution.pdop if solution else None, 3),
        *_attitude(
            None if block.attitude_rad is None else block.attitude_rad[i],
            None if block.sigma_attitude_rad is None else block.sigma_attitude_rad[i],
        ),
        block.reason or (solution.reason if solution else "no solution yet"),
    ]
