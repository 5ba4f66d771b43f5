"""Two stations and a base, simulated, through a pipeline as a worker runs it. What moves is told by the test."""

import random
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

from plumbline.config import StationSettings
from plumbline.epochs.stream import Books
from plumbline.gps_time import NS_PER_S, gps_ns_from_utc
from plumbline.pipeline import Pipeline
from plumbline.quality.reference_feed import ReferenceFeed
from plumbline.records import AlertEvent, AlertState, Motion, Output, Solution, Threshold
from plumbline_dtu.simulate_cli import marker_ecef_m
from plumbline_dtu.simulation.accelerometer import sca3300
from plumbline_dtu.simulation.constellation import Constellation, simulate_corrections
from plumbline_dtu.simulation.motion import Motion as Moving
from plumbline_dtu.simulation.motion import static, steps
from plumbline_dtu.simulation.station import Errors, StationPlan, simulate_station

START = gps_ns_from_utc(datetime(2026, 3, 1, tzinfo=UTC))
LEVEL_M = 0.02
THRESHOLD = Threshold("level", "a", "displacement_horizontal", LEVEL_M, off_delay_s=3.0, dead_band=0.005)
_ERRORS = Errors(phase_m=0.0006, phase_multipath_m=0.0008, code_m=0.1, code_multipath_m=0.1)
_LATENCY_NS = {"corrections": 5_000_000, "base": 40_000_000, "a": 90_000_000, "b": 140_000_000}
SENSOR = sca3300(50, 3)


def jump(second: float, east_m: float = 0.03) -> Moving:
    """A step within half a second."""
    return steps((east_m, 0.0, 0.0), START + round(second * NS_PER_S), rise_s=0.5)


def plan(name: str, moves: Moving | None = None, shows: Moving | None = None, felt: bool = False) -> StationPlan:
    """A station that moves, or whose receiver shows what nothing else does; ``felt``: with an accelerometer."""
    number = {"base": 9, "a": 1, "b": 2}[name]
    return StationPlan(
        name, marker_ecef_m(48.0, 11.0 + 0.0005 * number, 500.0), moves or static(), shows or static(), _ERRORS,
        station_id=number, seed=number, accelerometer=SENSOR if felt else None, accelerometer_rate_hz=50,
    )  # fmt: skip


def settings(name: str, mode: str = "rtk", **more: Any) -> StationSettings:
    """A rover against the base, or a station by itself."""
    values = {"station": name, "mode": mode, "reference_position_ecef_m": plan(name).marker_ecef_m}
    values["positioning"] = {"systems": "GEC", "converged_sigma_m": 0.10}
    values["rtk"] = {"base_stream": "base"}
    values["fusion"] = {"rotation_enu_from_sensor": SENSOR.rotation_enu_from_sensor}
    return StationSettings.model_validate(values | more)


Piece = tuple[int, str, bytes]


def pieces(plans: Sequence[tuple[StationPlan, int]], seconds: int, lost: Sequence[str] = ()) -> list[Piece]:
    """(receive time, stream, bytes) of the corrections, and of stations from a second on, in order."""
    sky, end = Constellation(START), START + seconds * NS_PER_S
    found = [(t, "corrections", data) for t, data in simulate_corrections(sky, START, end)]
    for station, begin in plans:
        sent = simulate_station(station, sky, START + begin * NS_PER_S, end)
        found += [(t, station.name, data) for t, data in sent]
    return sorted((t + _LATENCY_NS[name], name, data) for t, name, data in found if name not in lost)


@dataclass
class Seen:
    """What came out."""

    outputs: list[Output] = field(default_factory=list)

    @property
    def alerts(self) -> list[tuple[str, AlertState, float]]:
        """Threshold, state, second of event time."""
        events = [output for output in self.outputs if isinstance(output, AlertEvent)]
        return [(e.threshold_id, e.state, (e.t_gps_ns - START) / NS_PER_S) for e in events]

    @property
    def texts(self) -> list[str]:
        """Of the alerts."""
        return [output.text for output in self.outputs if isinstance(output, AlertEvent)]

    def flagged(self, kind: type[Solution] | type[Motion]) -> set[int]:
        """Seconds whose record says that it is doubtful."""
        time = {Solution: "t_gps_ns", Motion: "t_first_gps_ns"}[kind]
        records = [o for o in self.outputs if isinstance(o, kind) and "doubtful" in o.reason]
        return {(getattr(record, time) - START) // NS_PER_S for record in records}

    @property
    def rows(self) -> list[str]:
        """Every record that a store keeps, in an order of its own: the batches differ, the rows do not."""
        kept = (o for o in self.outputs if isinstance(o, Solution | Motion | AlertEvent))
        return sorted(repr(record) for record in kept)


def run(
    station: StationSettings,
    stream: Sequence[Piece],
    neighbours: Sequence[StationSettings] = (),
    ticks: random.Random | None = None,
    restart_at: int | None = None,
) -> Seen:
    """A station with its neighbours; ``ticks``: time passes now and then without data; a restart at a piece."""
    books, seen = Books(), Seen()
    feeds = {name: ReferenceFeed(name, books) for name in ("corrections", "base")}
    pipeline = Pipeline(station, (THRESHOLD,), books, neighbours=neighbours)
    before_ns = 0
    for k, (t_ns, name, data) in enumerate(stream):
        if ticks is not None and before_ns and ticks.random() < 0.5:
            seen.outputs += pipeline.advance(ticks.randrange(before_ns, t_ns + 1))
        if k == restart_at:
            pipeline = Pipeline.restore(station, (THRESHOLD,), books, pipeline.snapshot(), neighbours=neighbours)
        if name in feeds:
            feeds[name].receive(data, t_ns)
        elif name == station.station:
            seen.outputs += pipeline.receive(data, t_ns)
        elif name in station.neighbours:
            seen.outputs += pipeline.receive_neighbour(name, data, t_ns)
        before_ns = t_ns
    seen.outputs += pipeline.advance(before_ns + 30 * NS_PER_S)
    return seen
