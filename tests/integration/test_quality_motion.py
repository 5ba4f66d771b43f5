"""A real motion is never eaten, and slips at 1 Hz are found: the simulator's stations through the real pipeline.

Oracle: the same epochs with quality control off, and the motion and slips that were put in.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from plumbline.config import Mode, PositioningSettings, StationSettings
from plumbline.epochs.stream import Books, NavigationFeed
from plumbline.gps_time import NS_PER_S
from plumbline.pipeline import Pipeline
from plumbline.records import Epoch, Floats, Output, QualityReport, Solution
from plumbline_dtu.encoding import ephemeris_frame
from plumbline_dtu.simulation.constellation import Constellation, simulate_corrections
from plumbline_dtu.simulation.motion import Motion, static
from plumbline_dtu.simulation.station import Receiver, StationPlan

from .spoiled import SlipEditor, plan_slips

START = 1_451_260_817 * NS_PER_S
MARKER = (3582104.7628, 532590.1800, 5232755.1333)
_LATENCY_NS = 300_000_000


class Sky:
    """A constellation, and one simulated station's epochs, drawn once for all runs."""

    def __init__(self, seconds: int, motion: Motion) -> None:
        self.constellation = Constellation(START)
        receiver = Receiver(StationPlan("sim", MARKER, motion=motion), self.constellation)
        self.epochs = [receiver.epoch(START + second * NS_PER_S) for second in range(seconds)]
        end = START + seconds * NS_PER_S
        self.corrections = list(simulate_corrections(self.constellation, START - 10 * NS_PER_S, end, 5))

    def run(
        self, edit: Callable[[int, Epoch], Epoch] = lambda _, epoch: epoch, off_from: int | None = None
    ) -> Iterator[list[Output]]:
        """The pipeline's outputs, epoch by epoch; quality control is off from an epoch on."""
        settings = StationSettings(station="sim", mode=Mode.PPP, reference_position_ecef_m=MARKER)
        off = settings.model_copy(update={"positioning": PositioningSettings(quality_control="off")})
        books = Books()
        feed, pipeline = NavigationFeed("corrections", books), Pipeline(settings, (), books)
        waiting = iter([*self.corrections, (2**62, b"")])
        t_ns, data = next(waiting)
        for k, epoch in enumerate(self.epochs):
            if k == off_from:
                pipeline = Pipeline.restore(off, (), books, pipeline.snapshot())
            if k % 60 == 0:
                for ephemeris in self.constellation.broadcast(epoch.t_gps_ns).values():
                    feed.receive(ephemeris_frame(ephemeris), epoch.t_gps_ns)
            while t_ns <= epoch.t_gps_ns:
                feed.receive(data, t_ns)
                t_ns, data = next(waiting)
            yield pipeline.process_epoch(replace(edit(k, epoch), t_receive_ns=epoch.t_gps_ns + _LATENCY_NS))


def displacements(outputs: Iterator[list[Output]]) -> Floats:
    """Of all solutions (n, 3)."""
    found = [o.displacement_enu_m for some in outputs for o in some if isinstance(o, Solution)]
    return np.array([[np.nan] * 3 if d is None else d for d in found])


def moved(motion: Motion, displacement_m: Callable[[Floats], Floats]) -> Motion:
    """A motion with another displacement east, (n,) m at times (n,) s from the start."""

    def at(t_gps_ns: np.ndarray) -> object:
        made = motion(t_gps_ns)
        east = displacement_m((np.asarray(t_gps_ns) - START) / NS_PER_S)
        return replace(made, displacement_m=made.displacement_m + np.outer(east, [1.0, 0.0, 0.0]))

    return at  # type: ignore[return-value]


@pytest.mark.parametrize("what", ["step", "vibration"])
def test_a_real_motion_goes_through_with_control_on_as_with_it_off(what: str) -> None:
    """5 cm at once, or 19 mm at 0.5 Hz as 1 Hz epochs see it (sampled off its zero crossings): its size."""

    def east(t_s: Floats) -> Floats:
        if what == "step":
            return np.where(t_s >= 500.0, 0.05, 0.0)
        return np.where(t_s >= 400.0, 0.019 * np.sin(np.pi * t_s + 1.2), 0.0)

    sky, t_s = Sky(600, moved(static(), east)), np.arange(600.0)
    on, off = displacements(sky.run()), displacements(sky.run(off_from=400))
    assert np.isfinite(on[400:]).all()
    still = displacements(Sky(600, static()).run())  # the same errors without the motion
    seen, truth = size_of(what, t_s, on[:, 0] - still[:, 0]), size_of(what, t_s, east(t_s))
    assert seen == pytest.approx(truth, abs=0.001 if what == "step" else 0.01 * 0.019)
    difference = abs(size_of(what, t_s, on[:, 0]) - size_of(what, t_s, off[:, 0]))
    assert difference < (0.001 if what == "step" else 0.01 * 0.019)


def size_of(what: str, t_s: Floats, east_m: Floats) -> float:
    """A step's height from the ten epochs before and after it, or a vibration's amplitude (its sine's is 19 mm)."""
    if what == "step":
        return float(east_m[500:510].mean() - east_m[490:500].mean())
    within = t_s >= 410.0
    shape = np.sin(np.pi * t_s[within] + 1.2)
    slow = np.vander(t_s[within] - 500.0, 4)
    return float(np.linalg.lstsq(np.column_stack([shape, slow]), east_m[within], rcond=None)[0][0])


def test_single_cycles_are_found_at_one_hertz_and_none_where_there_are_none() -> None:
    sky = Sky(900, static())
    ages: dict[int, dict[int, int]] = {}
    clean_slips = 0
    for k, outputs in enumerate(sky.run()):
        report = next(o for o in outputs if isinstance(o, QualityReport))
        clean_slips += sum(event.startswith("cycle slip") for event in report.events)
        used = report.satellite[report.is_phase & (report.verdict == 0)]
        ages[k] = {int(s): ages.get(k - 1, {}).get(int(s), 0) + 1 for s in used}
    assert clean_slips == 0
    plan = plan_slips({k: ages[k] for k in range(300, 897)}, 2, 300)
    found, put_in = set(), {(k, slip.satellite) for k, slips in plan.items() for slip in slips}
    for k, outputs in enumerate(sky.run(SlipEditor(plan))):
        report = next(o for o in outputs if isinstance(o, QualityReport))
        left_out = report.satellite[report.is_phase & (report.verdict != 0)]
        found |= {(k, int(satellite)) for satellite in left_out}
    assert len(put_in) > 200
    assert len(found & put_in) >= 0.99 * len(put_in)
