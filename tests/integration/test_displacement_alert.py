"""A threshold on displacement raises and clears, from simulated bytes. Oracle: the simulated motion's own times."""

from datetime import UTC, datetime

import numpy as np
import pytest

from plumbline.config import StationSettings
from plumbline.epochs.stream import Books, NavigationFeed
from plumbline.gps_time import NS_PER_S, gps_ns_from_utc
from plumbline.pipeline import Pipeline
from plumbline.records import AlertEvent, AlertState, Ints, Severity, Threshold
from plumbline_dtu.simulate_cli import marker_ecef_m
from plumbline_dtu.simulation.accelerometer import sca3300
from plumbline_dtu.simulation.constellation import Constellation, simulate_corrections
from plumbline_dtu.simulation.motion import Motion, State, steps
from plumbline_dtu.simulation.station import Errors, StationPlan, simulate_station

START = gps_ns_from_utc(datetime(2026, 3, 1, tzinfo=UTC))
MARKER = marker_ecef_m(48.0, 11.0, 500.0)
AWAY_S, BACK_S, END_S = 1800, 1860, 1920
STEP_M, LEVEL_M = 0.25, 0.15


def there_and_back() -> Motion:
    away = steps((STEP_M, 0.0, 0.0), START + AWAY_S * NS_PER_S)
    back = steps((-STEP_M, 0.0, 0.0), START + BACK_S * NS_PER_S)

    def motion(t_gps_ns: Ints) -> State:
        a, b = away(t_gps_ns), back(t_gps_ns)
        return State(
            a.displacement_m + b.displacement_m,
            a.velocity_m_s + b.velocity_m_s,
            a.acceleration_m_s2 + b.acceleration_m_s2,
        )

    return motion


@pytest.mark.slow
def test_a_step_raises_and_its_return_clears() -> None:
    plan = StationPlan(
        name="dam", marker_ecef_m=MARKER, motion=there_and_back(), station_id=1, seed=3,
        errors=Errors(phase_m=0.0006, phase_multipath_m=0.0008, code_m=0.1, code_multipath_m=0.1),
        accelerometer=sca3300(50, 3), accelerometer_rate_hz=50,
    )  # fmt: skip
    settings = StationSettings.model_validate(
        {
            "station": "dam",
            "mode": "ppp-accel",
            "reference_position_ecef_m": MARKER,
            "positioning": {"systems": "GEC", "converged_sigma_m": 0.08},
            "fusion": {"rotation_enu_from_sensor": plan.accelerometer.rotation_enu_from_sensor},  # type: ignore[union-attr]
        }
    )
    threshold = Threshold("east", "dam", "displacement_east", LEVEL_M, Severity.ALARM, dead_band=0.02, off_delay_s=3.0)
    constellation, end = Constellation(START), START + END_S * NS_PER_S
    books = Books()
    feed, pipeline = NavigationFeed("corrections", books), Pipeline(settings, (threshold,), books)
    pieces = [(t, 0, data) for t, data in simulate_corrections(constellation, START, end)]
    pieces += [(t, 1, data) for t, data in simulate_station(plan, constellation, START, end)]
    events = list[AlertEvent]()
    for t, kind, data in sorted(pieces, key=lambda piece: piece[:2]):
        if kind == 0:
            feed.receive(data, t)
        else:
            events += [output for output in pipeline.receive(data, t) if isinstance(output, AlertEvent)]
    assert [event.state for event in events] == [AlertState.ACTIVE, AlertState.CLEARED]
    raised, cleared = ((event.t_gps_ns - START) / NS_PER_S for event in events)
    assert AWAY_S < raised < AWAY_S + 3
    assert BACK_S < cleared < BACK_S + 8
    assert events[0].alert_id == events[1].alert_id
    assert np.isclose(events[0].value, STEP_M, atol=0.12)
