"""`plumbline process --mode fuse`: a displacement series and an accelerometer's, through the multirate filter."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from tqdm import tqdm

from plumbline.config import FusionSettings
from plumbline.errors import ConfigurationError
from plumbline.files.seismic import Series, read_components
from plumbline.fusion.offline import FusedSeries, fuse_series
from plumbline.gps_time import NS_PER_S
from plumbline.offline import rotation_about_up
from plumbline.offline_csv import seconds_text
from plumbline.records import Floats

COLUMNS: Final = (
    "t_gps_s", "status", "n_satellites", "e_m", "n_m", "u_m", "sigma_e_m", "sigma_n_m", "sigma_u_m",
    "ve_m_s", "vn_m_s", "vu_m_s", "ae_m_s2", "an_m_s2", "au_m_s2",
)  # fmt: skip
_AT_REST_M_S2: Final = 5.0  # a vertical axis whose mean is below this has had gravity taken off


def run(
    displacement: Sequence[Path],
    accel: Sequence[Path],
    pole_zero: Sequence[Path],
    rotation_deg: float,
    use_every: int,
    output: Path,
) -> str:
    """Fuse the files (east, north, up), write the CSV and return the figures of the run in words."""
    gnss = _three(read_components(tuple(displacement)), "--displacement")
    samples = _three(read_components(tuple(accel), tuple(pole_zero)), "--accel")
    settings = FusionSettings.model_validate({"rotation_enu_from_sensor": rotation_about_up(rotation_deg)})
    withheld = np.arange(len(gnss.values)) % use_every != 0
    with tqdm(total=len(samples.values) * samples.interval_ns // NS_PER_S, unit="s", disable=None) as bar:
        fused = fuse_series(
            gnss.t_gps_ns,
            gnss.values,
            samples.t_first_gps_ns,
            samples.interval_ns,
            samples.values,
            settings,
            withheld=withheld,
            gravity_removed=abs(float(np.nanmean(samples.values[:, 2]))) < _AT_REST_M_S2,
            progress=bar.update,
        )
    _write(output, fused)
    return _figures(fused, gnss, withheld)


def _three(series: Series, option: str) -> Series:
    if series.values.shape[1] != 3:
        raise ConfigurationError(f"{option} wants east, north and up, not {series.values.shape[1]} components")
    return series


def _figures(fused: FusedSeries, gnss: Series, withheld: "np.ndarray[tuple[int], np.dtype[np.bool_]]") -> str:
    innovations = np.array([innovation.innovation_enu_m for innovation in fused.innovations])
    lines = [f"one-step innovation RMS E N U: {_millimetres(_rms(innovations))} mm ({len(innovations)} epochs)"]
    if withheld.any():
        error = fused.displacement_at(gnss.t_gps_ns[withheld]) - gnss.values[withheld]
        error = error[np.isfinite(error).all(axis=1)]
        lines.append(f"error at withheld epochs, RMS E N U: {_millimetres(_rms(error))} mm ({len(error)} epochs)")
    return "\n".join(lines)


def _rms(values: Floats) -> Floats:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)), float)


def _millimetres(values: Floats) -> str:
    return " ".join(f"{1e3 * value:.2f}" for value in values)


def _write(path: Path, fused: FusedSeries) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        columns = (
            fused.displacement_enu_m,
            fused.sigma_displacement_enu_m,
            fused.velocity_enu_m_s,
            fused.acceleration_enu_m_s2,
        )
        for i, t_ns in enumerate(fused.t_gps_ns):
            numbers = (f"{value:.6f}" for column in columns for value in column[i])
            writer.writerow((seconds_text(int(t_ns)), fused.status[i], 0, *numbers))
