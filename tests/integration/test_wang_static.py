"""Wang 2023's static experiment through the simulator, PPP and the fusion. Oracle: the paper's tables 3 and 4.

The simulated receiver's phases scatter from epoch to epoch as those of the recording ``esbc-2020-177`` do
(1.3, 2.0, 3.2 mm in kinematic PPP). The paper's displacement scatter is 4.8, 11.1, 3.1 mm in axes that it does not
relate to east, north and up, so the three of a kinematic antenna are judged together, and each of a structure's, whose
position is known to drift slowly, against the least.
"""

from collections.abc import Iterator
from datetime import UTC, datetime

import numpy as np
import pytest

from plumbline.config import StationSettings
from plumbline.epochs.stream import Books, NavigationFeed
from plumbline.gps_time import NS_PER_S, gps_ns_from_utc
from plumbline.pipeline import Pipeline
from plumbline.records import Motion, Status
from plumbline_dtu.simulate_cli import marker_ecef_m
from plumbline_dtu.simulation.accelerometer import wang_2023
from plumbline_dtu.simulation.constellation import Constellation, simulate_corrections
from plumbline_dtu.simulation.motion import static
from plumbline_dtu.simulation.station import Errors, StationPlan, simulate_station

START = gps_ns_from_utc(datetime(2026, 3, 1, tzinfo=UTC))
CONVERGED_AFTER_S, JUDGED_S = 3600, 1800
MARKER = marker_ecef_m(34.37, 109.22, 450.0)


def stream() -> Iterator[tuple[int, str, bytes]]:
    """Corrections and the station's bytes in time order, corrections first."""
    constellation = Constellation(START)
    errors = Errors(phase_m=0.0006, phase_multipath_m=0.0008)
    plan = StationPlan(
        name="roof", marker_ecef_m=MARKER, motion=static(), errors=errors, accelerometer=wang_2023(),
        accelerometer_rate_hz=50, station_id=1, seed=7,
    )  # fmt: skip
    end = START + (CONVERGED_AFTER_S + JUDGED_S) * NS_PER_S
    corrections = simulate_corrections(constellation, START, end)
    station = simulate_station(plan, constellation, START, end)
    pieces = [(t, 0, "corrections", data) for t, data in corrections] + [(t, 1, "roof", data) for t, data in station]
    for t, _, name, data in sorted(pieces, key=lambda piece: piece[:2]):
        yield t, name, data


KINEMATIC = {"systems": "GEC"}
STRUCTURE = KINEMATIC | {"motion": "static", "static_process_noise_m_sqrt_h": 0.01}  # it drifts by centimetres an hour


def run(positioning: dict[str, object]) -> list[Motion]:
    """The last revision of every second after convergence."""
    settings = StationSettings.model_validate(
        {"station": "roof", "mode": "ppp-accel", "reference_position_ecef_m": MARKER, "positioning": positioning}
    )
    books = Books()
    feed, pipeline = NavigationFeed("corrections", books), Pipeline(settings, (), books)
    blocks: dict[int, Motion] = {}
    for t, name, data in stream():
        if name == "corrections":
            feed.receive(data, t)
            continue
        for output in pipeline.receive(data, t):
            if isinstance(output, Motion) and output.t_first_gps_ns >= START + CONVERGED_AFTER_S * NS_PER_S:
                blocks[output.t_first_gps_ns] = output
    return [blocks[t] for t in sorted(blocks)]


def scatter(judged: list[Motion], name: str) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    return np.std(np.vstack([getattr(block, name) for block in judged]), axis=0) * 1e3


@pytest.mark.slow
@pytest.mark.parametrize("positioning", [KINEMATIC, STRUCTURE], ids=["kinematic", "structure"])
def test_scatter_is_no_worse_than_tables_3_and_4(positioning: dict[str, object]) -> None:
    judged = run(positioning)
    assert len(judged) >= JUDGED_S - 5
    assert {block.status for block in judged} == {Status.PPP_FLOAT}
    displacement = scatter(judged, "displacement_enu_m")
    velocity, acceleration = scatter(judged, "velocity_enu_m_s"), scatter(judged, "acceleration_enu_m_s2")
    print("mm", displacement, "mm/s", velocity, "mm/s²", acceleration)
    assert np.linalg.norm(displacement) < np.linalg.norm((4.823, 11.133, 3.083))
    if positioning is STRUCTURE:
        assert displacement.max() < 3.083  # whichever the paper's axes are
    assert (velocity <= (0.704, 0.515, 0.711)).all()
    assert (acceleration <= (4.807 * 1.01, 3.376 * 1.01, 4.843 * 1.01)).all()
