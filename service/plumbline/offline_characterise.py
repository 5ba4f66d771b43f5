"""`plumbline characterise`: noise parameters of a static record, or how a sensor is mounted."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plumbline.errors import ConfigurationError
from plumbline.files.seismic import read_components
from plumbline.gps_time import NS_PER_S
from plumbline.offline_imu_recording import series_of
from plumbline.records import Ints
from plumbline.structure.allan import Characteristics, allan_curve, characteristics_of
from plumbline.structure.misalignment import mounting_of

Bools = NDArray[np.bool_]
_GAP = 1.8  # intervals
_UNITS = {"accelerometer": ("m/s²/√Hz", "m/s²"), "gyroscope": ("rad/s/√Hz", "rad/s")}


def characterise(path: Path, form: str, begin_s: float, end_s: float | None, output: Path | None) -> str:
    """Read a static record's noise, write it as TOML where asked, and return it in words."""
    series = series_of(path, form)
    since_s = (series.t_gps_ns - series.t_gps_ns[0]) / NS_PER_S
    part = (since_s >= begin_s) & (since_s <= (since_s[-1] if end_s is None else end_s))
    part &= _longest_stretch(series.t_gps_ns, part)
    if not np.isfinite(series.specific_force_m_s2[part]).all() or part.sum() < 2:
        raise ConfigurationError(f"{path}: nothing usable between {begin_s:g} and {end_s} s")
    times = series.t_gps_ns[part]
    rate = (times.size - 1) * NS_PER_S / float(times[-1] - times[0])
    lines = [f"{path}: {part.sum() / rate:.0f} s at {rate:.2f} Hz"]
    settings: dict[str, float] = {}
    for name, samples in (
        ("accelerometer", series.specific_force_m_s2[part]),
        ("gyroscope", series.angular_rate_rad_s[part]),
    ):
        if np.isfinite(samples).all():
            found = characteristics_of(allan_curve(samples, rate))
            lines += _words(name, found)
            settings |= _settings(name, found)
    if output is not None:
        text = f"# {path.name}, plumbline characterise\n" + "".join(f"{k} = {v:.6e}\n" for k, v in settings.items())
        output.write_text(text, encoding="utf-8")
    return "\n".join(lines)


def _longest_stretch(t_gps_ns: Ints, part: Bools) -> Bools:
    """The samples (n,) of the longest time without gaps among those of ``part`` (n,)."""
    out = np.zeros(part.size, np.bool_)
    index = np.flatnonzero(part)
    steps = np.diff(t_gps_ns[index])
    cuts = np.flatnonzero(steps > _GAP * np.median(steps)) + 1 if steps.size else np.zeros(0, np.int64)
    out[max(np.split(index, cuts), key=len)] = True
    return out


def _words(name: str, found: Characteristics) -> list[str]:
    density, unit = _UNITS[name]
    lines = [f"{name}: axis, white noise {density}, bias instability {unit}, at τ s, Gauss-Markov σ {unit}, T s"]
    for k, axis in enumerate("xyz"):
        bound = "≤ " if found.at_most[k] else ""
        lines.append(
            f"  {axis}  {found.density[k]:.3e}  {bound}{found.instability[k]:.3e}  {found.instability_at_s[k]:.1f}  "
            f"{found.markov_sigma[k]:.3e}  {found.markov_time_s[k]:.1f}"
        )
    return lines


def _settings(name: str, found: Characteristics) -> dict[str, float]:
    """The worst axis, as the filters' settings name it."""
    unit, bias = ("m_s2", "accelerometer_bias") if name == "accelerometer" else ("rad_s", "gyroscope_bias")
    return {
        f"{name}_noise_{unit}_sqrt_hz": float(found.density.max()),
        f"{bias}_sigma_{unit}": float(found.markov_sigma.max()),
        f"{bias}_time_s": float(np.median(found.markov_time_s)),
    }


def propose_mounting(
    accel: Sequence[Path], pole_zero: Sequence[Path], displacement: Sequence[Path], band_hz: tuple[float, float]
) -> str:
    """Compare an accelerometer's files with a displacement's; returns the proposal in words."""
    samples = read_components(tuple(accel), tuple(pole_zero))
    gnss = read_components(tuple(displacement))
    proposal = mounting_of(
        gnss.t_gps_ns, gnss.values, samples.t_first_gps_ns, samples.interval_ns, samples.values, band_hz
    )
    return proposal.describe()
