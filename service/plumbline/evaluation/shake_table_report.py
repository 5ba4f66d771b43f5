"""The shaking table's figures in words."""

from collections.abc import Mapping
from typing import Final

import numpy as np

from plumbline.evaluation.shake_table import (
    MEANS,
    PAPER_MM,
    Line,
    Scatter,
    Series,
    Truth,
    improvements,
    in_the_papers_order,
    lines_of,
    scatter_of,
)

_IMPROVED_PAPER: Final = {"mean G": 0.330, "mean GI": 0.303, "mean GI, two": 0.142}
_AFTER: Final = {schemes[-1]: name for name, schemes in MEANS.items()}


def report(truth: Truth, series: Mapping[str, Series]) -> str:
    """Table 3 beside the paper's, what it says of the schemes, and the vibrations' peaks and amplitudes."""
    scatters = {name: scatter_of(truth, one) for name, one in series.items()}
    parts = [_table(scatters)]
    if all(scheme in scatters for schemes in MEANS.values() for scheme in schemes) and "GI123" in scatters:
        parts += [_sentences(scatters)]
    parts += [_lines({name: lines_of(truth, one) for name, one in series.items()})]
    return "\n\n".join(part for part in parts if part)


def _table(scatters: Mapping[str, Scatter]) -> str:
    head = "errors of displacement along the table, standard deviation, mm (in brackets: Dai 2024, table 3)"
    rows = [
        head,
        f"{'scheme':14}{'both periods':>16}{'period 1':>16}{'period 2':>16}{'2D':>8}{'missing':>9}{'float':>7}",
    ]
    for name, one in scatters.items():
        rows.append(
            _row(name, (one.both_m, one.rest_m, one.shaking_m)) + f"{one.horizontal_m * 1e3:8.2f}"
            f"{one.missing:9d}" + (f"{one.not_fixed:7d}" if not name.startswith("GI") else f"{'':>7}")
        )
        group = _AFTER.get(name)
        if group and all(scheme in scatters for scheme in MEANS[group]):
            members = [scatters[scheme] for scheme in MEANS[group]]
            means = np.mean([(m.both_m, m.rest_m, m.shaking_m) for m in members], axis=0)
            rows.append(_row(group, means.tolist()))
    return "\n".join(rows)


def _row(name: str, values_m: "tuple[float, ...] | list[float]") -> str:
    paper = PAPER_MM[name]
    return f"{name:14}" + "".join(
        f"{1e3 * v:8.2f} ({p:.2f})"[:16].rjust(16) for v, p in zip(values_m, paper, strict=True)
    )


def _sentences(scatters: Mapping[str, Scatter]) -> str:
    gains = improvements(scatters)
    rows = [f"GI123 better than {name}: {100 * gain:.1f} % (paper: {100 * _IMPROVED_PAPER[name]:.1f} %)"
            for name, gain in gains.items()]  # fmt: skip
    rows += [f"{'yes' if holds else 'NO':4}{sentence}" for sentence, holds in in_the_papers_order(scatters).items()]
    return "\n".join(rows)


def _lines(lines: Mapping[str, list[Line]]) -> str:
    if not any(lines.values()):
        return ""
    rows = ["peaks, Hz, and amplitudes less the laser's, mm, by scheme; ! where the bin is not the laser's"]
    first = next(found for found in lines.values() if found)
    rows.append(f"{'':8}" + "".join(f"{line.vibration + 1}: {line.laser_hz:.3f}".rjust(14) for line in first))
    rows.append(f"{'laser':8}" + "".join(f"{line.laser_m * 1e3:14.2f}" for line in first))
    for name, found in lines.items():
        cells = [
            f"{line.amplitude_error_m * 1e3:+.2f}{' ' if line.frequency_exact else '!'}".rjust(14) for line in found
        ]
        rows.append(f"{name:8}" + "".join(cells))
    worst = {name: max(abs(line.amplitude_error_m) for line in found) for name, found in lines.items() if found}
    exact = all(line.frequency_exact for found in lines.values() for line in found)
    rows.append(f"every peak in the laser's bin: {'yes' if exact else 'NO'}; worst amplitude error, mm: "
                + ", ".join(f"{name} {1e3 * value:.2f}" for name, value in worst.items()))  # fmt: skip
    return "\n".join(rows)
