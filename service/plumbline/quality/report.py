"""An epoch's quality as a record, from what the position filter's control found; and as a line of the quality log."""

import json
from typing import Any, Final

import numpy as np

from plumbline.config import PositioningSettings
from plumbline.estimation.dia_tables import global_critical_of_ratio, noncentrality, w_critical
from plumbline.estimation.dia_window import equivalent
from plumbline.positioning.control import TAIL
from plumbline.positioning.cycle_slip import BEGAN_GEOMETRY_FREE, BEGAN_REFUSED, BEGAN_TOLD
from plumbline.positioning.ppp import EpochQuality
from plumbline.positioning.ppp_noise import levels_of
from plumbline.positioning.solutions import rotation_at
from plumbline.positioning.state import POSITION, PppState
from plumbline.quality.reliability import Integrity, factors, geometry, measures
from plumbline.quality.report_texts import REASONS, names_of_signals
from plumbline.records import Floats, QualityReport, Solution, Verdict
from plumbline.signals import satellite_name

_WHY_ANEW: Final = {
    BEGAN_TOLD: "the receiver or the corrections say that its ambiguity is another",
    BEGAN_GEOMETRY_FREE: "its geometry-free phase stayed where it had jumped to",
    BEGAN_REFUSED: "its phase stayed off by the same amount",
}


def quality_report(
    solution: Solution, state: PppState, found: EpochQuality, settings: PositioningSettings
) -> QualityReport:
    """The report of an epoch; ``state`` is the filter's after it."""
    control, kind = found.control, found.kind
    levels, pair = levels_of(settings), found.kind // 2
    integrity = Integrity(risk=settings.integrity_risk)
    is_phase = kind % 2 == 1
    usual, used = np.where(is_phase, state.phase_scale, 1.0), found.used
    rotation = rotation_at(state.x[POSITION])
    made = measures(
        control.sigma_error_m, control.variance_m2, used, found.design, found.variance_m2,
        np.ascontiguousarray(state.p[POSITION]), rotation, factors(levels, integrity, TAIL), usual,
    )  # fmt: skip
    seen = np.zeros(found.pairs.size, np.bool_)
    seen[pair[used]] = True
    sky = geometry(found.rows["line"], found.pairs["system"].astype(np.int64), seen, rotation)
    return QualityReport(
        station=solution.station,
        t_gps_ns=solution.t_gps_ns,
        t_receive_ns=solution.t_receive_ns,
        tests=_tests(state, found, settings),
        satellite=found.pairs["satellite"][pair],
        is_phase=is_phase,
        signals=_signals(found, is_phase),
        residual_m=control.misclosure_m,
        sigma_m=np.sqrt(control.variance_m2),
        redundancy=made.redundancy,
        mdb_m=made.mdb,
        w=control.w / usual,
        external_enu_m=made.external,
        qdop=sky.qdop[pair],
        elevation_rad=np.arcsin(np.clip(found.rows["sine"], -1.0, 1.0))[pair],
        azimuth_rad=_azimuths(found, rotation)[pair],
        verdict=control.verdict if control.agrees else np.full(kind.size, Verdict.EPOCH, np.int8),
        hdop=sky.hdop,
        vdop=sky.vdop,
        pdop=sky.pdop,
        protection_horizontal_m=made.protection_horizontal,
        protection_vertical_m=made.protection_vertical,
        integrity_risk=integrity.risk,
        events=_events(found),
    )


def _azimuths(found: EpochQuality, rotation: Floats) -> Floats:
    enu = found.rows["line"] @ rotation.T
    azimuth: Floats = np.arctan2(enu[:, 0], enu[:, 1]) % (2.0 * np.pi)
    return azimuth


def _signals(found: EpochQuality, is_phase: Any) -> Any:
    """Signal ids (m, 2) of each observation's combination."""
    pair, signals = found.kind // 2, np.empty((found.kind.size, 2), np.int16)
    for k, (phase, code) in enumerate((("signal_1", "code_1"), ("signal_2", "code_2"))):
        signals[:, k] = np.where(is_phase, found.pairs[phase][pair], found.pairs[code][pair])
    return signals


def _tests(state: PppState, found: EpochQuality, settings: PositioningSettings) -> dict[str, float]:
    levels, control = levels_of(settings), found.control
    freedom = found.degrees_of_freedom
    freedom_after = max(freedom - int(np.count_nonzero(~found.used)), 0)
    window, window_freedom = equivalent(state.window)
    factor, excess = state.share.mean, state.share.excess(freedom_after)
    window_excess = state.window_share.excess(window_freedom)
    return {
        "statistic": control.statistic / factor,
        "degrees_of_freedom": float(freedom),
        "critical_value": global_critical_of_ratio(levels, freedom, excess),
        "statistic_after": control.statistic_after / factor,
        "degrees_of_freedom_after": float(freedom_after),
        "critical_value_after": global_critical_of_ratio(levels, freedom_after, excess),
        "window_statistic": window / state.window_share.mean,
        "window_degrees_of_freedom": window_freedom,
        "window_critical_value": global_critical_of_ratio(levels, round(window_freedom), window_excess),
        "variance_factor": control.statistic_after / freedom_after if freedom_after else float("nan"),
        "usual_variance_factor": factor,
        "significance": levels.significance,
        "power": levels.power,
        "w_significance": levels.w_significance,
        "w_critical": w_critical(levels) * TAIL,
        "noncentrality": noncentrality(levels),
        "reinstated": float(control.taken_back),
        "cn0_db_hz": _median(found.pairs["cn0_db_hz"]),
    }


def _median(values: Floats) -> float:
    """Middle one of the finite values; NaN without any."""
    finite = np.sort(values)[: np.count_nonzero(np.isfinite(values))]  # NaN is sorted last
    return float(finite[finite.size // 2]) if finite.size else float("nan")


def _events(found: EpochQuality) -> tuple[str, ...]:
    events = [f"cycle slip of {satellite_name(satellite)}: {_WHY_ANEW[why]}" for satellite, why in found.slips]
    moved = found.control.moved_m
    if np.isfinite(moved).all():
        events.append(f"the antenna moved by {np.linalg.norm(moved) * 1e3:.0f} mm: the position was let go")
    return tuple(events)


# --------------------------------------------------------------------------------------------- the log


def _number(value: float, digits: int = 6) -> float | None:
    return float(f"{value:.{digits}g}") if np.isfinite(value) else None


def _vector(values: Floats) -> list[float | None]:
    return [_number(value) for value in values.tolist()]


def observation_view(report: QualityReport, i: int) -> dict[str, Any]:
    """One observation of a report, in SI units."""
    verdict = Verdict(int(report.verdict[i]))
    return {
        "satellite": satellite_name(int(report.satellite[i])),
        "kind": "phase" if report.is_phase[i] else "code",
        "signals": names_of_signals(report, i),
        "residual_m": _number(report.residual_m[i]),
        "sigma_m": _number(report.sigma_m[i]),
        "redundancy": _number(report.redundancy[i]),
        "mdb_m": _number(report.mdb_m[i]),
        "w": _number(report.w[i]),
        "rejected": verdict is not Verdict.ACCEPTED,
        "reason": REASONS[verdict],
        "external_enu_m": _vector(report.external_enu_m[i]),
        "qdop": _number(report.qdop[i]),
        "elevation_deg": _number(np.degrees(report.elevation_rad[i]), 4),
        "azimuth_deg": _number(np.degrees(report.azimuth_rad[i]), 4),
    }


def report_view(report: QualityReport) -> dict[str, Any]:
    """A report in SI units, ready for JSON."""
    return {
        "t_gps_s": report.t_gps_ns / 1e9,
        "tests": {name: _number(value, 9) for name, value in report.tests.items()},
        "hdop": _number(report.hdop),
        "vdop": _number(report.vdop),
        "pdop": _number(report.pdop),
        "protection_horizontal_m": _number(report.protection_horizontal_m),
        "protection_vertical_m": _number(report.protection_vertical_m),
        "integrity_risk": report.integrity_risk,
        "events": list(report.events),
        "observations": [observation_view(report, i) for i in range(report.satellite.size)],
    }


def log_line(report: QualityReport) -> str:
    """A report as one line of JSON."""
    return json.dumps(report_view(report), separators=(",", ":"), allow_nan=False)
