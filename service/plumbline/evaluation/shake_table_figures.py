"""The paper's figures 4 to 8 of a run, as PNG (matplotlib, without a display)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from plumbline.evaluation.shake_table import Series, Truth, errors_along_m, lines_of
from plumbline.structure import power_spectrum

_TYPICAL: Final = ("G1", "GI1", "GI12", "GI123")
_PANELS: Final = (("G1", "G2", "G3"), ("GI1", "GI2", "GI3"), ("GI12", "GI13", "GI23"), ("G123", "GI123"))
_DPI: Final = 110


def write_figures(truth: Truth, series: Mapping[str, Series], folder: Path) -> list[Path]:
    """Displacements, errors, their histograms, spectra, amplitude errors; returns the files written."""
    from matplotlib.figure import Figure

    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, size, draw in (
        ("displacements", (11, 8), _displacements),
        ("errors", (11, 9), _errors),
        ("histograms", (9, 6), _histograms),
        ("spectra", (11, 7), _spectra),
        ("amplitudes", (9, 5), _amplitudes),
    ):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure, truth, series)
        path = folder / f"{name}.png"
        figure.savefig(path, dpi=_DPI)
        written.append(path)
    return written


def _displacements(figure: Any, truth: Truth, series: Mapping[str, Series]) -> None:
    shown = [name for name in ("G1", "G2", "G3", "GI123") if name in series]
    axes = figure.subplots(1 + len(shown), 1, sharex=True, squeeze=False)[:, 0]
    axes[0].plot(truth.since_s, 1e3 * truth.along_m, lw=0.5)
    axes[0].set_ylabel("laser, mm")
    for axis, name in zip(axes[1:], shown, strict=True):
        along = series[name].displacement_enu_m @ truth.direction_enu
        axis.plot(truth.since_s, 1e3 * (along - np.nanmean(along)), lw=0.5)
        axis.set_ylabel(f"{name}, mm")
    axes[-1].set_xlabel("s")
    figure.suptitle("Displacement along the table")


def _errors(figure: Any, truth: Truth, series: Mapping[str, Series]) -> None:
    axes = figure.subplots(len(_PANELS), 1, sharex=True, sharey=True)
    for axis, names in zip(axes, _PANELS, strict=True):
        for name in names:
            if name in series:
                axis.plot(truth.since_s, 1e3 * errors_along_m(truth, series[name]), lw=0.5, label=name)
        if axis.lines:
            axis.legend(loc="upper right", ncols=3)
        axis.set_ylabel("error, mm")
        axis.axvline(truth.rest_s, color="grey", lw=0.8)
    axes[-1].set_xlabel("s")


def _histograms(figure: Any, truth: Truth, series: Mapping[str, Series]) -> None:
    shown = [name for name in _TYPICAL if name in series]
    axes = figure.subplots(1, max(len(shown), 1), sharey=True, squeeze=False)[0]
    for axis, name in zip(axes, shown, strict=False):
        error = 1e3 * errors_along_m(truth, series[name])
        error = error[~np.isnan(error)]
        axis.hist(error, bins=np.arange(-20.0, 20.5, 0.5))
        axis.set_title(f"{name}: {error.min():.1f} … {error.max():.1f} mm", fontsize=9)
        axis.set_xlabel("error, mm")


def _spectra(figure: Any, truth: Truth, series: Mapping[str, Series]) -> None:
    axes = figure.subplots(2, 2).ravel()
    for axis, vibration in zip(axes, truth.vibrations[:4], strict=False):
        rows = slice(
            round(vibration.start_s * truth.rate_hz), round((vibration.start_s + vibration.lasting_s) * truth.rate_hz)
        )
        shown = {"laser": truth.along_m[rows]}
        shown |= {n: (series[n].displacement_enu_m @ truth.direction_enu)[rows] for n in _TYPICAL if n in series}
        for name, values in shown.items():
            spectrum = power_spectrum(1e3 * values[:, None], truth.rate_hz, vibration.lasting_s)
            if spectrum is not None:
                axis.semilogy(spectrum.frequency_hz, spectrum.density[:, 0], lw=0.8, label=name)
        axis.set_xlim(0.0, 5.0)
        axis.set_ylim(bottom=1e-6)
        axis.set_title(" + ".join(f"{frequency} Hz" for _, frequency in vibration.parts), fontsize=9)
        axis.set_xlabel("Hz")
        axis.set_ylabel("mm²/Hz")
    if axes[0].lines:
        axes[0].legend(fontsize=8)


def _amplitudes(figure: Any, truth: Truth, series: Mapping[str, Series]) -> None:
    axis = figure.subplots()
    shown = [name for name in _TYPICAL if name in series]
    for k, name in enumerate(shown):
        lines = lines_of(truth, series[name])
        at = np.arange(len(lines)) + 0.2 * (k - 0.5 * (len(shown) - 1))
        axis.bar(at, [1e3 * line.amplitude_error_m for line in lines], 0.2, label=name)
        axis.set_xticks(range(len(lines)), [f"{line.vibration + 1}: {line.frequency_hz} Hz" for line in lines])
    axis.set_ylabel("amplitude less the laser's, mm")
    axis.tick_params(axis="x", rotation=40)
    if shown:
        axis.legend()
