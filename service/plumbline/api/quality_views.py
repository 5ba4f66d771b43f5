"""Quality reports, availability and explanations in the forms of the API."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from plumbline.api.quality_schemas import AvailabilityOut, ExplainOut, FindingOut, GapOut
from plumbline.api.units import iso, scaled
from plumbline.quality.availability import Availability
from plumbline.quality.explain import Finding
from plumbline.quality.report_texts import REASONS, names_of_signals
from plumbline.records import QualityReport, Verdict
from plumbline.signals import satellite_name

_AXES: Final = ("east", "north", "up")


def _observation(report: QualityReport, i: int) -> dict[str, Any]:
    verdict = Verdict(int(report.verdict[i]))
    external = zip(_AXES, report.external_enu_m[i].tolist(), strict=True)
    return {
        "satellite": satellite_name(int(report.satellite[i])),
        "kind": "phase" if report.is_phase[i] else "code",
        "signals": names_of_signals(report, i),
        "residual_mm": scaled(float(report.residual_m[i]), 1e3, 2),
        "sigma_mm": scaled(float(report.sigma_m[i]), 1e3, 2),
        "redundancy": scaled(float(report.redundancy[i]), 1.0, 4),
        "mdb_mm": scaled(float(report.mdb_m[i]), 1e3, 1),
        "w": scaled(float(report.w[i]), 1.0, 3),
        "qdop": scaled(float(report.qdop[i]), 1.0, 4),
        "elevation_deg": scaled(float(np.degrees(report.elevation_rad[i])), 1.0, 1),
        "azimuth_deg": scaled(float(np.degrees(report.azimuth_rad[i])), 1.0, 1),
        **{f"external_{axis}_mm": scaled(value, 1e3, 2) for axis, value in external},
        "rejected": verdict is not Verdict.ACCEPTED,
        "reason": REASONS[verdict],
    }


def quality_view(report: QualityReport) -> dict[str, Any]:
    """A report as :class:`quality_schemas.QualityOut`'s fields."""
    return {
        "station": report.station,
        "time": iso(report.t_gps_ns),
        "tests": {name: scaled(value, 1.0, 6) for name, value in sorted(report.tests.items())},
        "hdop": scaled(report.hdop, 1.0, 3),
        "vdop": scaled(report.vdop, 1.0, 3),
        "pdop": scaled(report.pdop, 1.0, 3),
        "protection_horizontal_mm": scaled(report.protection_horizontal_m, 1e3, 1),
        "protection_vertical_mm": scaled(report.protection_vertical_m, 1e3, 1),
        "integrity_risk": report.integrity_risk,
        "events": list(report.events),
        "observations": [_observation(report, i) for i in range(report.satellite.size)],
    }


def availability_view(station: str, made: Availability) -> AvailabilityOut:
    """A day's availability."""
    return AvailabilityOut(
        station=station,
        start=iso(made.t_first_gps_ns),
        end=iso(made.t_end_gps_ns),
        interval_s=made.interval_s,
        expected=made.expected,
        received=made.received,
        solved=made.solved,
        converged=made.converged,
        fixed=made.fixed,
        loss=dict(sorted(made.loss.items(), key=lambda item: (-item[1], item[0]))),
        gaps=[
            GapOut(start=iso(gap.t_first_gps_ns), end=iso(gap.t_last_gps_ns), epochs=gap.epochs, reason=gap.reason)
            for gap in made.gaps
        ],
        latency_s={f"p{percentile}": scaled(value, 1.0, 3) for percentile, value in made.latency_s.items()},
    )


def explain_view(station: str, epochs: int, findings: Sequence[Finding]) -> ExplainOut:
    """Findings in words."""
    items = [
        FindingOut(cause=finding.cause, text=finding.text, advice=finding.advice, share=round(finding.share, 3))
        for finding in findings
    ]
    return ExplainOut(station=station, epochs=epochs, findings=items)
