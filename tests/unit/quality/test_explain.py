"""Explanations. Oracle: made-up troubles whose cause is known, and a station that is well."""

import numpy as np

from plumbline.gps_time import NS_PER_S
from plumbline.quality.explain import explain
from plumbline.records import QualityReport, Solution, StationStatus, Status, Verdict

T0 = 1_400_000_000 * NS_PER_S


def solutions(status: Status, reason: str = "", latency_s: float = 0.5, n: int = 60, **more: float) -> list[Solution]:
    late = round(latency_s * NS_PER_S)
    return [Solution("a", T0 + k * NS_PER_S, T0 + k * NS_PER_S + late, status, reason, **more) for k in range(n)]


def report(k: int, cn0: float = 45.0, bad: tuple[int, ...] = (), azimuth_deg: float = 0.0) -> QualityReport:
    """Four codes, those in ``bad`` left out."""
    n, t = 4, T0 + k * NS_PER_S
    ones = np.ones(n)
    verdict = np.array([Verdict.OUTLIER if i in bad else Verdict.ACCEPTED for i in range(n)], np.int8)
    return QualityReport(
        "a", t, t, {"cn0_db_hz": cn0}, np.arange(n, dtype=np.int16), np.zeros(n, bool), np.zeros((n, 2), np.int16),
        ones, ones, ones, ones, ones, np.ones((n, 3)), ones, ones, np.full(n, np.radians(azimuth_deg)), verdict,
        1.0, 1.0, 1.0, 0.1, 0.1, 1e-5,
    )  # fmt: skip


def status(state: str = "receiving", reason: str = "", **counters: int) -> StationStatus:
    return StationStatus("a", T0, state, reason, T0, Status.PPP_FLOAT, 9, counters)


def causes(*arguments: object) -> list[str]:
    return [finding.cause for finding in explain(*arguments)]  # type: ignore[arg-type]


def test_a_station_that_is_well_has_nothing_to_explain() -> None:
    assert causes(solutions(Status.PPP_FLOAT), [report(k) for k in range(60)], status()) == []


def test_every_trouble_is_named_with_what_to_do() -> None:
    lost = explain(solutions(Status.NO_CORRECTIONS, "no corrections for GPS: last 45 s ago"), [], status())
    assert lost[0].cause == "no_corrections"
    assert "60 of 60" in lost[0].text
    assert "correction stream" in lost[0].advice
    assert causes([], [], None) == ["silence"]
    assert causes([], [], status("silent", "no observations for 30 s")) == ["silence"]
    assert "latency" in causes(solutions(Status.PPP_FLOAT, latency_s=5.0), [], status())
    assert "age" in causes(solutions(Status.PPP_FLOAT, correction_age_s=40.0), [], status())
    assert "line" in causes(solutions(Status.PPP_FLOAT), [], status(frames_bad_crc=12))


def test_one_satellite_one_direction_or_all_signals_at_once_are_told_apart() -> None:
    good = solutions(Status.PPP_FLOAT)
    assert "satellite" in causes(good, [report(k, bad=(2,)) for k in range(60)], status())
    reflecting = [report(k, bad=(k % 4,) if k % 3 == 0 else (), azimuth_deg=180.0) for k in range(60)]
    found = explain(good, reflecting, status())
    assert any(finding.cause == "multipath" and "south" in finding.text for finding in found)
    jammed = [report(k, cn0=45.0 if k < 50 else 30.0) for k in range(60)]
    assert "interference" in causes(good, jammed, status())
