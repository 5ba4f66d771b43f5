"""The shaking table's figures (Dai 2024, section 3): table 3, the spectra's peaks, the amplitudes.

An error is a scheme's displacement along the table less the laser's, the mean over the whole series taken off (STDE:
the standard deviation of errors; the paper's errors have a sign and its laser has one direction, so they are along the
table). "2D" is the same of east and north together: the root of the sum of both variances.

A vibration's frequencies and amplitudes come from a Fourier transform of its minutes, laser and scheme alike: the
peak's bin has to be the laser's, and the amplitude is that of the laser's bin.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from plumbline.errors import FileFormatError
from plumbline.records import Booleans, Floats, Ints

SCHEMES: Final = ("G1", "G2", "G3", "GI1", "GI2", "GI3", "GI12", "GI13", "GI23", "G123", "GI123")
#: Means that table 3 gives, and what each is of.
MEANS: Final = {
    "mean G": ("G1", "G2", "G3"), "mean GI": ("GI1", "GI2", "GI3"), "mean GI, two": ("GI12", "GI13", "GI23"),
}  # fmt: skip
#: Table 3 of the paper: STDE of both periods, period 1, period 2, mm.
PAPER_MM: Final = {
    "G1": (3.87, 3.18, 4.10), "G2": (4.21, 3.75, 4.36), "G3": (3.57, 2.48, 3.92), "mean G": (3.88, 3.14, 4.13),
    "GI1": (3.66, 2.93, 3.89), "GI2": (4.12, 3.54, 4.22), "GI3": (3.41, 2.24, 3.77), "mean GI": (3.73, 2.90, 3.96),
    "GI12": (2.79, 2.23, 2.98), "GI13": (3.10, 2.31, 3.37), "GI23": (3.21, 2.58, 3.42),
    "mean GI, two": (3.03, 2.37, 3.26), "G123": (3.19, 2.75, 3.35), "GI123": (2.60, 2.08, 2.73),
}  # fmt: skip
_NS_PER_MS: Final = 1_000_000
_NEAR_MS: Final = 1  # a row belongs to a truth's instant when it is this near


@dataclass(frozen=True, slots=True)
class Vibration:
    """A vibration of the table: from ``start_s`` after the beginning, and its sines (amplitude m, frequency Hz)."""

    start_s: float
    lasting_s: float
    parts: tuple[tuple[float, float], ...]
    ramp_s: float


@dataclass(frozen=True, slots=True)
class Truth:
    """The laser's series and what is known of the experiment."""

    t_gps_ns: Ints  # (n,), evenly spaced
    along_m: Floats  # (n,)
    displacement_enu_m: Floats  # (n, 3)
    direction_enu: Floats  # (3,)
    rest_s: float  # period 1
    vibrations: tuple[Vibration, ...]
    rate_hz: float

    @property
    def since_s(self) -> Floats:
        """Seconds since the first row, (n,)."""
        since: Floats = (self.t_gps_ns - self.t_gps_ns[0]) * 1e-9
        return since


@dataclass(frozen=True, slots=True)
class Series:
    """A scheme's displacement at the truth's times: (n, 3) ENU, NaN where it has none; ``fixed`` (n,)."""

    name: str
    displacement_enu_m: Floats
    fixed: Booleans


@dataclass(frozen=True, slots=True)
class Scatter:
    """A row of table 3: STDE along the table of both periods, period 1, period 2, and 2D of both; m. Rows missing."""

    both_m: float
    rest_m: float
    shaking_m: float
    horizontal_m: float
    missing: int
    not_fixed: int


@dataclass(frozen=True, slots=True)
class Line:
    """A sine of a vibration as a scheme saw it."""

    vibration: int
    frequency_hz: float  # commanded
    laser_hz: float  # the bin of the laser's peak, and of the scheme's
    scheme_hz: float
    laser_m: float  # amplitudes at the laser's peak
    scheme_m: float

    @property
    def frequency_exact(self) -> bool:
        """Whether the peaks stand in one bin."""
        return self.laser_hz == self.scheme_hz

    @property
    def amplitude_error_m(self) -> float:
        """Scheme's less laser's."""
        return self.scheme_m - self.laser_m


def truth_of(description: Mapping[str, Any], rows: Floats) -> Truth:
    """From ``experiment.json`` and the columns of ``truth.csv`` (n, 5); raises FileFormatError."""
    try:
        schedule = description["schedule"]
        vibrations = tuple(
            Vibration(v["start_s"], v["lasting_s"], tuple((a, f) for a, f in v["parts"]), v["ramp_s"])
            for v in schedule["vibrations"]
        )
        direction = np.array(description["table_direction_enu"], float)
        times = np.round(rows[:, 0] * 1e3).astype(np.int64) * _NS_PER_MS
        return Truth(
            times, rows[:, 1], rows[:, 2:5], direction, schedule["rest_s"], vibrations, description["gnss_rate_hz"]
        )
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise FileFormatError(f"no shake-table experiment: {error!r}") from error


def series_at(truth: Truth, name: str, t_gps_ns: Ints, displacement_enu_m: Floats, fixed: Booleans) -> Series:
    """A scheme's rows, at whatever rate, at the truth's times."""
    out, kept = np.full((len(truth.t_gps_ns), 3), np.nan), np.zeros(len(truth.t_gps_ns), bool)
    if len(t_gps_ns):
        after = np.clip(np.searchsorted(t_gps_ns, truth.t_gps_ns), 0, len(t_gps_ns) - 1)
        before = np.maximum(after - 1, 0)
        nearer = np.abs(t_gps_ns[before] - truth.t_gps_ns) < np.abs(t_gps_ns[after] - truth.t_gps_ns)
        index = np.where(nearer, before, after)
        near = np.abs(t_gps_ns[index] - truth.t_gps_ns) <= _NEAR_MS * _NS_PER_MS
        out[near], kept[near] = displacement_enu_m[index[near]], fixed[index[near]]
    return Series(name, out, kept)


def mean_of(name: str, parts: Sequence[Series]) -> Series:
    """The average of several solutions (the paper's G123); missing where any is."""
    displacement = np.mean([part.displacement_enu_m for part in parts], axis=0)
    return Series(name, displacement, np.logical_and.reduce([part.fixed for part in parts]))


def errors_along_m(truth: Truth, series: Series) -> Floats:
    """Errors along the table (n,), the mean taken off; NaN where the scheme has nothing, or has not fixed its integers.

    The paper's solutions all have: a start that has yet to converge is another question, and is counted.
    """
    error: Floats = np.where(series.fixed, series.displacement_enu_m @ truth.direction_enu - truth.along_m, np.nan)
    if not np.isnan(error).all():
        error = error - np.nanmean(error)
    return error


def scatter_of(truth: Truth, series: Series) -> Scatter:
    """A scheme's row of table 3."""
    error = errors_along_m(truth, series)
    plane = (series.displacement_enu_m - truth.displacement_enu_m)[:, :2]
    known = ~np.isnan(error)
    there = ~np.isnan(series.displacement_enu_m[:, 0])
    counts = int(np.sum(~there)), int(np.sum(there & ~series.fixed))
    if not known.any():
        return Scatter(np.nan, np.nan, np.nan, np.nan, *counts)
    resting = truth.since_s < truth.rest_s

    def spread(rows: Booleans) -> float:
        return float(np.std(error[rows & known])) if (rows & known).any() else float("nan")

    return Scatter(
        spread(known),
        spread(resting),
        spread(~resting),
        float(np.sqrt(np.sum(np.var(plane[known], axis=0)))),
        *counts,
    )


def lines_of(truth: Truth, series: Series) -> list[Line]:
    """Frequencies and amplitudes of every sine of every vibration; one that has rows missing is left out."""
    along = series.displacement_enu_m @ truth.direction_enu
    lines = []
    for number, vibration in enumerate(truth.vibrations):
        rows = _rows_of(truth, vibration)
        if np.isnan(along[rows]).any():
            continue
        frequency, laser = amplitude_spectrum(truth.along_m[rows], truth.rate_hz)
        _, scheme = amplitude_spectrum(along[rows], truth.rate_hz)
        for _, commanded in vibration.parts:
            around = np.flatnonzero(np.abs(frequency - commanded) < _reach_hz(vibration, commanded))
            k, j = around[np.argmax(laser[around])], around[np.argmax(scheme[around])]
            lines.append(
                Line(number, commanded, float(frequency[k]), float(frequency[j]), float(laser[k]), float(scheme[k]))
            )
    return lines


def amplitude_spectrum(values_m: Floats, rate_hz: float) -> tuple[Floats, Floats]:
    """Frequencies and one-sided amplitudes of samples (n,): a sine of amplitude A in a bin's middle shows as A.

    Hann's window, trend taken off; bins are 1/T apart.
    """
    n = len(values_m)
    line = np.polynomial.Polynomial.fit(np.arange(n), values_m, 1)(np.arange(n))
    window = np.hanning(n + 1)[:n]
    spectrum = np.abs(np.fft.rfft((values_m - line) * window)) * 2.0 / window.sum()
    return np.asarray(np.fft.rfftfreq(n, 1.0 / rate_hz), float), np.asarray(spectrum, float)


def _rows_of(truth: Truth, vibration: Vibration) -> slice:
    """The vibration's rows: whole minutes, so that 0.67 Hz does not stand half-way between two bins."""
    first, last = vibration.start_s, vibration.start_s + vibration.lasting_s
    return slice(round(first * truth.rate_hz), round(last * truth.rate_hz))


def _reach_hz(vibration: Vibration, commanded_hz: float) -> float:
    """How far from a commanded frequency its peak is looked for: half-way to the next sine, or to nothing."""
    others = [abs(f - commanded_hz) for _, f in vibration.parts if f != commanded_hz]
    return 0.5 * min([commanded_hz, *others])


def improvements(scatters: Mapping[str, Scatter]) -> dict[str, float]:
    """By how much GI123 is better than the means of single G, single GI and dual GI, as fractions."""
    best = scatters["GI123"].both_m
    return {
        name: 1.0 - best / float(np.mean([scatters[scheme].both_m for scheme in schemes]))
        for name, schemes in MEANS.items()
        if all(scheme in scatters for scheme in schemes)
    }


def in_the_papers_order(scatters: Mapping[str, Scatter]) -> dict[str, bool]:
    """What the paper's table 3 says of its schemes, sentence by sentence (section 3), and whether it holds here."""

    def mean(name: str) -> float:
        return float(np.mean([scatters[scheme].both_m for scheme in MEANS[name]]))

    def of(scheme: str) -> float:
        return scatters[scheme].both_m

    return {
        "the IMU improves every antenna": all(of(f"GI{k}") < of(f"G{k}") for k in "123"),
        "two antennas are better than one": mean("mean GI, two") < mean("mean GI"),
        "three are better than two": of("GI123") < min(of(scheme) for scheme in MEANS["mean GI, two"]),
        "antenna 2 is the worst": of("G2") > max(of("G1"), of("G3")) and of("GI2") > max(of("GI1"), of("GI3")),
        "averaging improves on single antennas": of("G123") < min(of(scheme) for scheme in MEANS["mean G"]),
        "averaging three stands behind two with the IMU": of("G123") > mean("mean GI, two"),
        "the IMU improves on averaging": of("GI123") < of("G123"),
    }
