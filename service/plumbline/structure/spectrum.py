"""Frequencies that a structure moves at: Welch's power spectral density and its peaks."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import detrend, find_peaks, welch

from plumbline.records import Floats


@dataclass(frozen=True, slots=True)
class Spectrum:
    """One-sided power spectral density: frequencies (m,) Hz, density (m, c) in unit²/Hz of the samples' unit."""

    frequency_hz: Floats
    density: Floats
    resolution_hz: float  # equivalent noise bandwidth of the window: a sine of amplitude A shows as A²/2 over this


@dataclass(frozen=True, slots=True)
class Peak:
    """A line of a spectrum."""

    frequency_hz: float
    amplitude: float  # of the sine that would make it, in the samples' unit
    density: float


def power_spectrum(values: Floats, rate_hz: float, segment_s: float | None = None) -> Spectrum | None:
    """Welch's method (Welch 1967; Hann window, half overlap, trend removed) of evenly spaced samples (n, c).

    Segments last ``segment_s`` (None: a quarter of the samples, at least 256 of them). None where samples are missing
    (NaN) or too few (less than 16).
    """
    n = len(values)
    if n < 16 or np.isnan(values).any():
        return None
    wanted = max(n // 4, 256) if segment_s is None else round(segment_s * rate_hz)
    length = int(np.clip(wanted, 16, n))
    frequency, density = welch(detrend(values, axis=0), rate_hz, "hann", length, axis=0)
    return Spectrum(np.asarray(frequency, float), np.asarray(density, float), 1.5 * rate_hz / length)


def peaks(spectrum: Spectrum, component: int, count: int = 3, least_hz: float = 0.0) -> list[Peak]:
    """The ``count`` strongest peaks of a component, strongest first; frequency refined by a parabola through the
    logarithms.
    """
    density = spectrum.density[:, component]
    found, _ = find_peaks(density)
    found = found[spectrum.frequency_hz[found] >= least_hz]
    strongest = found[np.argsort(-density[found], kind="stable")][:count]
    return [_refined(spectrum, density, int(k)) for k in strongest]


def _refined(spectrum: Spectrum, density: Floats, k: int) -> Peak:
    left, middle, right = np.log(np.maximum(density[k - 1 : k + 2], np.finfo(float).tiny))
    bend = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    step_hz = float(spectrum.frequency_hz[1] - spectrum.frequency_hz[0])
    top = float(np.exp(middle - 0.25 * (left - right) * shift))
    frequency_hz = float(spectrum.frequency_hz[k]) + float(shift) * step_hz
    return Peak(frequency_hz, float(np.sqrt(2.0 * top * spectrum.resolution_hz)), top)
