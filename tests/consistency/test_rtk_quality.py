"""Quality reports of positions against a base. Oracles: identities of the adjustment, and errors put in."""

from dataclasses import replace

import numpy as np
import pytest

from plumbline.positioning import rtk
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.rtk_state import BaseView, RtkState
from plumbline.quality.relative_report import relative_report
from plumbline.quality.report import report_view
from plumbline.records import Epoch, QualityReport, Solution, Status, Verdict

from .rtk_world import BASE_ECEF_M, ENU, T_NS, antenna, noisy, settings_of, sine_of, source_of

SETTINGS = settings_of()
SOURCE = source_of(SETTINGS)
FACTS = StationFacts("rover")
OFFSET_ENU_M = np.array([40.0, -25.0, 6.0])
SECOND = 1_000_000_000


def _pairs(n: int) -> list[tuple[Epoch, Epoch]]:
    base, rover, rng = antenna(np.zeros(3), 1), antenna(OFFSET_ENU_M, 2), np.random.default_rng(8)
    pairs = [(rover.epoch(T_NS + k * SECOND), base.epoch(T_NS + k * SECOND)) for k in range(n)]
    return [(noisy(r, sine_of(r), rng), noisy(b, sine_of(b), rng)) for r, b in pairs]


PAIRS = _pairs(12)


def _step(state: RtkState, rover: Epoch, base: Epoch) -> tuple[RtkState, Solution, QualityReport]:
    state, solution, seen = rtk.step(state, rover, BaseView("b", base, BASE_ECEF_M), SOURCE, SETTINGS, FACTS)
    assert seen is not None
    report = relative_report(solution, state, seen, SETTINGS)
    assert report is not None
    return state, solution, report


def _warm(n: int) -> RtkState:
    state = rtk.initial_state()
    for rover, base in PAIRS[:n]:
        state, _, _ = _step(state, rover, base)
    return state


def test_a_report_is_the_adjustment_it_comes_from() -> None:
    """With all integers known: redundancy numbers add up to the redundancy, and w is residual/(σ √redundancy).

    The codes of arcs that go on enter the filter with 121 times their variance (``rtk_lasting``), so that the position
    knows a trifle less than an adjustment of this epoch alone would: a part in a hundred thousand of the redundancy.
    """
    _, solution, report = _step(_warm(10), *PAIRS[10])
    assert solution.status is Status.RTK_FIXED
    clocks = {(int(s), bool(p)) for s, p in zip(report.signals[:, 0], report.is_phase, strict=True)}
    assert report.redundancy.sum() == pytest.approx(report.satellite.size - len(clocks) - 3, rel=1e-5)
    checked = report.redundancy > 1e-3
    np.testing.assert_allclose(
        report.w[checked], (report.residual_m / (report.sigma_m * np.sqrt(report.redundancy)))[checked], atol=1e-9
    )
    assert (report.verdict == Verdict.ACCEPTED).all()
    sigma_h = np.sqrt(np.linalg.eigvalsh(solution.covariance_enu_m2[:2, :2])[-1])
    assert report.protection_horizontal_m > 4.7 * sigma_h
    assert report.protection_horizontal_m < 0.1
    assert report.tests["degrees_of_freedom"] > 0
    assert set(report_view(report)["observations"][0]) >= {"satellite", "kind", "signals", "residual_m", "mdb_m", "w"}


def test_an_error_of_the_mdb_moves_the_position_by_its_external_reliability() -> None:
    """Put into one phase, tests off: the fixed position moves by what the report says, east, north and up."""
    state, (rover, base) = _warm(10), PAIRS[10]
    _, before, report = _step(state, rover, base)
    off = SETTINGS.model_copy(
        update={"positioning": SETTINGS.positioning.model_copy(update={"quality_control": "off"})}
    )
    for i in np.flatnonzero(report.is_phase)[[0, 7, 15]]:
        row = (rover.satellite == report.satellite[i]) & (rover.signal == report.signals[i, 0])
        wavelength_m = 299_792_458.0 / _frequency_hz(int(report.signals[i, 0]))
        spoilt = replace(
            rover, carrier_phase_cycles=rover.carrier_phase_cycles + row * report.mdb_m[i] / wavelength_m
        )  # fmt: skip
        _, after, _ = rtk.step(state, spoilt, BaseView("b", base, BASE_ECEF_M), SOURCE, off, FACTS)
        moved = ENU @ (after.position_ecef_m - before.position_ecef_m)
        np.testing.assert_allclose(moved, report.external_enu_m[i], atol=5e-5)


def _frequency_hz(signal: int) -> float:
    from plumbline.signals import FREQUENCY_HZ

    return float(FREQUENCY_HZ[signal])


def test_an_outlier_has_its_row_and_a_slip_its_event() -> None:
    state, (rover, base) = _warm(10), PAIRS[10]
    satellite, signal = int(rover.satellite[0]), int(rover.signal[0])
    row = (rover.satellite == satellite) & (rover.signal == signal)
    code = replace(rover, pseudorange_m=rover.pseudorange_m + 20.0 * row)
    _, _, report = _step(state, code, base)
    view = report_view(report)
    (rejected,) = [o for o in view["observations"] if o["rejected"]]
    assert (rejected["kind"], rejected["reason"]) == ("code", "w-test: outlier")
    assert rejected["residual_m"] == pytest.approx(20.0, abs=3.0)
    assert view["tests"]["statistic"] > view["tests"]["critical_value"] > view["tests"]["statistic_after"]
    slipped = replace(rover, carrier_phase_cycles=rover.carrier_phase_cycles + row)
    later, _, report = _step(state, slipped, base)
    assert [Verdict(int(v)).name for v in report.verdict if v] == ["UNDECIDED"]
    rover, base = PAIRS[11]
    again = replace(rover, carrier_phase_cycles=rover.carrier_phase_cycles + row)
    _, solution, report = _step(later, again, base)
    assert len(report.events) == 1
    assert report.events[0].startswith("cycle slip of G")
    assert solution.status is Status.RTK_FIXED
    _, solution, report = _step(later, rover, base)  # it comes back: an outlier, and the ambiguity is still good
    assert report.events == ()
    assert solution.extras["slips"] == 0.0
